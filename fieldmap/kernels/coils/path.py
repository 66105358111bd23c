"""Flux density and gradient of a closed plane winding of rectangular section: arcs and bars, per ampere-turn.

Frame: winding in |z| <= height/2, axis along z. arcs (n, 8) and bars (n, 5): rows are `Arc` and `Bar` of
`fieldmap.kernels.coils.pieces`. `thickness` is the width of the winding in its plane, the same for all pieces. The
current density is uniform. The gradient uses curl B = mu0 J, so that it holds for closed paths only.
"""

import math

import numpy as np

from fieldmap.constants import MU0_OVER_4PI
from fieldmap.kernels.coils.arc import MOST_AZIMUTHS, arc_azimuths, arc_integrals, even_azimuths
from fieldmap.kernels.coils.bar import bar_integrals
from fieldmap.kernels.coils.fields import flux_density, flux_density_and_gradient
from fieldmap.kernels.coils.filament import far_distance
from fieldmap.kernels.coils.pieces import Arc, Bar
from fieldmap.kernels.coils.quadrature import rule_limits
from fieldmap.kernels.compilation import inlined, njit
from fieldmap.typing import Array

_WORK = 400.0  # of one point: some microseconds
_SEAM = 1e-9  # overlap of the pieces, so that no point inside the winding falls between two of them


@njit(inline="always")
def _arc(rows: Array, k: int) -> Arc:
    return Arc(rows[k, 0], rows[k, 1], rows[k, 2], rows[k, 3], rows[k, 4], rows[k, 5], rows[k, 6], rows[k, 7])


@njit(inline="always")
def _bar(rows: Array, k: int) -> Bar:
    return Bar(rows[k, 0], rows[k, 1], rows[k, 2], rows[k, 3], rows[k, 4])


@inlined
def add_in_plane_gradient(
    G: Array, ax: float, ay: float, g00: float, g01: float, g02: float, g10: float, g11: float, g12: float
) -> None:
    """Add d(in-plane field)/d(a, b, z), a = (ax, ay), b = (-ay, ax), to the first two rows of G (3, 3)."""
    # rows to x, y
    x0, x1, x2 = ax * g00 - ay * g10, ax * g01 - ay * g11, ax * g02 - ay * g12
    y0, y1, y2 = ay * g00 + ax * g10, ay * g01 + ax * g11, ay * g02 + ax * g12
    G[0, 0] += x0 * ax - x1 * ay
    G[0, 1] += x0 * ay + x1 * ax
    G[0, 2] += x2
    G[1, 0] += y0 * ax - y1 * ay
    G[1, 1] += y0 * ay + y1 * ax
    G[1, 2] += y2


@inlined
def add_arc(
    B: Array,
    G: Array,
    arc: Arc,
    x: float,
    y: float,
    heights: tuple[float, float],
    even: Array,
    limits: Array,
    azimuths: Array,
    gap: float,
    digits: float,
) -> None:
    """Add one arc's field integral to B (3,) and the gradient of its in-plane part to G[:2]; gap of `arc_integrals`."""
    px, py = x - arc.x, y - arc.y
    mx, my = arc.middle_x, arc.middle_y
    px, py = px * mx + py * my, py * mx - px * my
    section = (arc.inner, arc.outer, *heights)
    n = arc_azimuths(px, py, section, even, limits, azimuths)
    r = arc_integrals(azimuths, n, px, py, section, gap, digits)
    s = arc.sense
    B[0] += s * (mx * r[0] - my * r[1])
    B[1] += s * (my * r[0] + mx * r[1])
    B[2] += s * r[2]
    add_in_plane_gradient(G, mx, my, s * r[3], s * r[4], s * r[5], s * r[6], s * r[7], s * r[8])


@inlined
def add_bar(
    B: Array,
    G: Array,
    bar: Bar,
    half_thickness: float,
    x: float,
    y: float,
    heights: tuple[float, float],
    limits: Array,
    gap: float,
    digits: float,
) -> None:
    """Add one bar's field integral to B (3,) and the gradient of its in-plane part to G[:2]; gap of `arc_integrals`."""
    tx, ty, half = bar.along_x, bar.along_y, bar.half_length
    px, py = x - bar.x, y - bar.y
    v, X = px * tx + py * ty, px * ty - py * tx
    section = (-half_thickness, half_thickness, *heights)
    r = bar_integrals(v - half, v + half, X, section, limits, gap, digits)
    B[0] += ty * r[0]
    B[1] -= tx * r[0]
    B[2] += r[1]
    add_in_plane_gradient(G, ty, -tx, r[2], r[3], r[4], 0.0, 0.0, 0.0)


@njit
def current_direction(
    arcs: Array, bars: Array, half_thickness: float, x: float, y: float
) -> tuple[float, float]:
    """Unit vector of the current at a point of the winding's plane region, or (0, 0) outside the winding."""
    for k in range(len(bars)):
        bar = _bar(bars, k)
        tx, ty = bar.along_x, bar.along_y
        px, py = x - bar.x, y - bar.y
        if abs(px * tx + py * ty) <= bar.half_length and abs(px * ty - py * tx) < half_thickness:
            return tx, ty
    for k in range(len(arcs)):
        arc = _arc(arcs, k)
        px, py = x - arc.x, y - arc.y
        rho = math.sqrt(px * px + py * py)
        within = px * arc.middle_x + py * arc.middle_y >= rho * (math.cos(arc.half_angle) - _SEAM)
        if within and arc.inner < rho < arc.outer:
            return -arc.sense * py / rho, arc.sense * px / rho
    return 0.0, 0.0


@njit
def extent(arcs: Array, bars: Array, thickness: float, height: float) -> tuple[float, float, float, float]:
    """Middle x, y, half diagonal and a quarter of the in-plane area of the bounding box of the path's pieces."""
    low_x, high_x, low_y, high_y = math.inf, -math.inf, math.inf, -math.inf
    for k in range(len(arcs)):
        arc = _arc(arcs, k)
        low_x, high_x = min(low_x, arc.x - arc.outer), max(high_x, arc.x + arc.outer)
        low_y, high_y = min(low_y, arc.y - arc.outer), max(high_y, arc.y + arc.outer)
    for k in range(len(bars)):
        bar = _bar(bars, k)
        across = abs(bar.half_length * bar.along_x) + 0.5 * thickness
        along = abs(bar.half_length * bar.along_y) + 0.5 * thickness
        low_x, high_x = min(low_x, bar.x - across), max(high_x, bar.x + across)
        low_y, high_y = min(low_y, bar.y - along), max(high_y, bar.y + along)
    width, depth = high_x - low_x, high_y - low_y
    size = 0.5 * math.sqrt(width * width + depth * depth + height * height)
    return 0.5 * (low_x + high_x), 0.5 * (low_y + high_y), size, 0.25 * width * depth


@njit
def _even_tables(arcs: Array) -> Array:
    tables = np.empty((len(arcs), 3, 25))
    for k in range(len(arcs)):
        even_azimuths(arcs[k, 4], tables[k])
    return tables


@njit
def _close_gradient(
    G: Array, arcs: Array, bars: Array, half_thickness: float, x: float, y: float, within: bool
) -> None:
    """Fill the last row of G from div B = 0 and curl B = mu0 J, in units of mu0/(4 pi) times the density; within: the
    height of the winding."""
    jx, jy = 0.0, 0.0
    if within:
        jx, jy = current_direction(arcs, bars, half_thickness, x, y)
    G[2, 0] = G[0, 2] - 4.0 * math.pi * jy
    G[2, 1] = G[1, 2] + 4.0 * math.pi * jx
    G[2, 2] = -G[0, 0] - G[1, 1]


# `vector *= factor` takes two seconds to compile, because numba compiles an error message about shapes with it.
@njit(inline="always")
def _scale(vector: Array, factor: float) -> None:
    for k in range(3):
        vector[k] *= factor


@njit(nogil=True)
def _path_rows(begin, end, points, arcs, bars, thickness, height, digits, field, gradient):
    factor = MU0_OVER_4PI / (thickness * height)
    limits, even = rule_limits(digits), _even_tables(arcs)
    mid_x, mid_y, size, quarter = extent(arcs, bars, thickness, height)
    far = far_distance(size, thickness * height * quarter, digits)
    azimuths = np.empty((3, MOST_AZIMUTHS))
    both, unwanted = len(gradient) > 0, np.zeros((3, 3))
    for i in range(begin, end):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        heights = (z + 0.5 * height, z - 0.5 * height)
        distance = math.sqrt((x - mid_x) ** 2 + (y - mid_y) ** 2 + z * z)
        B, G = field[i], gradient[i] if both else unwanted
        gap = distance - size if distance > far else 0.0
        for k in range(len(arcs)):
            add_arc(B, G, _arc(arcs, k), x, y, heights, even[k], limits, azimuths, gap, digits)
        for k in range(len(bars)):
            add_bar(B, G, _bar(bars, k), 0.5 * thickness, x, y, heights, limits, gap, digits)
        _scale(B, factor)
        if both:
            _close_gradient(G, arcs, bars, 0.5 * thickness, x, y, 2.0 * abs(z) < height)
            for row in range(3):
                _scale(G[row], factor)


def path_flux_density(
    points: Array, arcs: Array, bars: Array, thickness: float, height: float, digits: float
) -> Array:
    """B (n, 3) in T per ampere-turn at points (n, 3) in m, to about `digits` digits."""
    return flux_density(_path_rows, points, arcs, bars, thickness, height, digits, work=_WORK)


def path_flux_density_and_gradient(
    points: Array, arcs: Array, bars: Array, thickness: float, height: float, digits: float
) -> tuple[Array, Array]:
    """B (n, 3) in T and its gradient (n, 3, 3) in T/m per ampere-turn."""
    return flux_density_and_gradient(_path_rows, points, arcs, bars, thickness, height, digits, work=_WORK)
