"""Flux density and gradient of a closed plane winding of rectangular section: arcs and bars, per ampere-turn.

Frame: winding in |z| <= height/2, axis along z. arcs (n, 8): centre x, y, unit vector to the middle of the arc x, y,
half angle, inner and outer radius, +1 for counter-clockwise current or -1. bars (n, 5): middle x, y, unit vector of
the current x, y, half length. `thickness` is the width of the winding in its plane, the same for all pieces.
The current density is uniform. The gradient uses curl B = mu0 J, so that it holds for closed paths only.
"""

import math

import numba
import numpy as np
from numpy.typing import NDArray

from fieldmap.kernels.arc import arc_integrals, arc_integrals_gradient
from fieldmap.kernels.bar import bar_integrals, bar_integrals_gradient
from fieldmap.kernels.constants import MU0_OVER_4PI

Array = NDArray[np.float64]


@numba.njit(cache=True, error_model="numpy")
def _seen_from(arc: Array, x: float, y: float) -> tuple[float, float, float, float]:
    """Distance of the point from the arc's centre, its direction there, and the arc's middle azimuth from it."""
    px, py = x - arc[0], y - arc[1]
    rho = math.sqrt(px * px + py * py)
    cx, cy = arc[2], arc[3]
    if rho > 0.0:
        cx, cy = px / rho, py / rho
    return rho, cx, cy, math.atan2(cx * arc[3] - cy * arc[2], cx * arc[2] + cy * arc[3])


@numba.njit(cache=True, error_model="numpy")
def add_arc(B: Array, arc: Array, x: float, y: float, h1: float, h2: float, digits: float) -> None:
    """Add one arc's field integral to B (3,)."""
    rho, cx, cy, middle = _seen_from(arc, x, y)
    radial, around, axial = arc_integrals(rho, middle, arc[4], arc[5], arc[6], h1, h2, digits)
    B[0] += arc[7] * (cx * radial - cy * around)
    B[1] += arc[7] * (cy * radial + cx * around)
    B[2] += arc[7] * axial


@numba.njit(cache=True, error_model="numpy")
def add_bar(
    B: Array, bar: Array, half_thickness: float, x: float, y: float, h1: float, h2: float, digits: float
) -> None:
    """Add one bar's field integral to B (3,)."""
    tx, ty = bar[2], bar[3]
    px, py = x - bar[0], y - bar[1]
    v = px * tx + py * ty
    X = px * ty - py * tx
    outward, axial = bar_integrals(v - bar[4], v + bar[4], X, -half_thickness, half_thickness, h1, h2, digits)
    B[0] += ty * outward
    B[1] -= tx * outward
    B[2] += axial


@numba.njit(cache=True, error_model="numpy")
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


@numba.njit(cache=True, error_model="numpy")
def add_arc_gradient(
    B: Array, G: Array, arc: Array, x: float, y: float, h1: float, h2: float, digits: float
) -> None:
    """Add one arc's field integral to B (3,) and the gradient of its in-plane part to G[:2]."""
    rho, cx, cy, middle = _seen_from(arc, x, y)
    r = arc_integrals_gradient(rho, middle, arc[4], arc[5], arc[6], h1, h2, digits)
    s = arc[7]
    B[0] += s * (cx * r[0] - cy * r[1])
    B[1] += s * (cy * r[0] + cx * r[1])
    B[2] += s * r[2]
    add_in_plane_gradient(G, cx, cy, s * r[3], s * r[4], s * r[5], s * r[6], s * r[7], s * r[8])


@numba.njit(cache=True, error_model="numpy")
def add_bar_gradient(
    B: Array,
    G: Array,
    bar: Array,
    half_thickness: float,
    x: float,
    y: float,
    h1: float,
    h2: float,
    digits: float,
) -> None:
    """Add one bar's field integral to B (3,) and the gradient of its in-plane part to G[:2]."""
    tx, ty = bar[2], bar[3]
    px, py = x - bar[0], y - bar[1]
    v = px * tx + py * ty
    X = px * ty - py * tx
    r = bar_integrals_gradient(v - bar[4], v + bar[4], X, -half_thickness, half_thickness, h1, h2, digits)
    B[0] += ty * r[0]
    B[1] -= tx * r[0]
    B[2] += r[1]
    add_in_plane_gradient(G, ty, -tx, r[2], r[3], r[4], 0.0, 0.0, 0.0)


@numba.njit(cache=True, error_model="numpy")
def current_direction(
    arcs: Array, bars: Array, half_thickness: float, x: float, y: float
) -> tuple[float, float]:
    """Unit vector of the current at a point of the winding's plane region, or (0, 0) outside the winding."""
    for k in range(len(bars)):
        tx, ty = bars[k, 2], bars[k, 3]
        px, py = x - bars[k, 0], y - bars[k, 1]
        if abs(px * tx + py * ty) <= bars[k, 4] and abs(px * ty - py * tx) < half_thickness:
            return tx, ty
    for k in range(len(arcs)):
        rho, cx, cy, middle = _seen_from(arcs[k], x, y)
        if abs(middle) <= arcs[k, 4] and arcs[k, 5] < rho < arcs[k, 6]:
            return -arcs[k, 7] * cy, arcs[k, 7] * cx
    return 0.0, 0.0


@numba.njit(cache=True, parallel=True, error_model="numpy")
def path_flux_density(
    points: Array, arcs: Array, bars: Array, thickness: float, height: float, digits: float
) -> Array:
    """B (n, 3) in T per ampere-turn at points (n, 3) in m, to about `digits` digits."""
    field = np.zeros((len(points), 3))
    factor = MU0_OVER_4PI / (thickness * height)
    for i in numba.prange(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        h1, h2 = z + 0.5 * height, z - 0.5 * height
        for k in range(len(arcs)):
            add_arc(field[i], arcs[k], x, y, h1, h2, digits)
        for k in range(len(bars)):
            add_bar(field[i], bars[k], 0.5 * thickness, x, y, h1, h2, digits)
        field[i] *= factor
    return field


@numba.njit(cache=True, parallel=True, error_model="numpy")
def path_flux_density_and_gradient(
    points: Array, arcs: Array, bars: Array, thickness: float, height: float, digits: float
) -> tuple[Array, Array]:
    """B (n, 3) in T and its gradient (n, 3, 3) in T/m per ampere-turn."""
    field = np.zeros((len(points), 3))
    gradient = np.zeros((len(points), 3, 3))
    factor = MU0_OVER_4PI / (thickness * height)
    for i in numba.prange(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        h1, h2 = z + 0.5 * height, z - 0.5 * height
        B, G = field[i], gradient[i]
        for k in range(len(arcs)):
            add_arc_gradient(B, G, arcs[k], x, y, h1, h2, digits)
        for k in range(len(bars)):
            add_bar_gradient(B, G, bars[k], 0.5 * thickness, x, y, h1, h2, digits)
        jx, jy = 0.0, 0.0
        if h1 > 0.0 and h2 < 0.0:
            jx, jy = current_direction(arcs, bars, 0.5 * thickness, x, y)
        four_pi = 4.0 * math.pi
        G[2, 0] = G[0, 2] - four_pi * jy
        G[2, 1] = G[1, 2] + four_pi * jx
        G[2, 2] = -G[0, 0] - G[1, 1]
        field[i] *= factor
        gradient[i] *= factor
    return field, gradient
