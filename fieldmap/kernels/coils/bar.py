"""Field integrals of a straight bar of rectangular section: slices far away, closed form near and inside.

Frame of the bar as seen from the field point: v runs from v1 to v2, v being the point's distance ahead of a slice
along the current; section r1 <= r <= r2 outward (to the right of the current), heights h1 > h2 as in `slice`; X is the
point's outward coordinate. Density 1. Results are along (outward, current, z) and lack the factor mu0/(4 pi)
times the density. A bar alone is no closed current: its field is of use only in the sum over a closed path.
"""

import math
from collections.abc import Callable
from typing import Any

from fieldmap.kernels.coils.elementary import log
from fieldmap.kernels.coils.filament import filament, filament_slice, section_points
from fieldmap.kernels.coils.quadrature import Section, even_points, section_distance
from fieldmap.kernels.coils.slice import angle_difference, bar_slice, log_ratio
from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.gauss import GAUSS_NODES, GAUSS_WEIGHTS, gauss_start
from fieldmap.typing import Array

BarIntegrals = tuple[float, float, float, float, float]

_MOST_SLICES = 24  # points along a bar; the closed form costs about as much
_MOST_FAR = 32


@inlined
def _bar_points(v1: float, v2: float, X: float, section: Section, limits: Array) -> int:
    """Points along the bar, or 0 for closed form."""
    distance, inside = section_distance(X, section)
    if inside:
        return 0
    ends = math.sqrt(v1 * v1 + distance * distance) + math.sqrt(v2 * v2 + distance * distance)
    return even_points(ends / (v2 - v1), limits, _MOST_SLICES)


@inlined
def _plane(a: float, b1: float, b2: float, c1: float, c2: float) -> tuple[float, float, float]:
    """Sums over the corners (b, c) of the plane at distance a, high minus low in b and in c: of ln(b + R),
    of ln(c + R), and of atan(b c / (|a| R))."""
    a2 = a * a
    x1, x2, y1, y2 = b1 * b1 + a2, b2 * b2 + a2, c1 * c1 + a2, c2 * c2 + a2
    R11, R12 = math.sqrt(x1 + c1 * c1), math.sqrt(x1 + c2 * c2)
    R21, R22 = math.sqrt(x2 + c1 * c1), math.sqrt(x2 + c2 * c2)
    of_b = log(log_ratio(b1, R12, b2, R22, y2) / log_ratio(b1, R11, b2, R21, y1))
    of_c = log(log_ratio(c1, R21, c2, R22, x2) / log_ratio(c1, R11, c2, R12, x1))
    d = abs(a)
    angle = angle_difference(b2 * c1, d * R21, b2 * c2, d * R22) - angle_difference(
        b1 * c1, d * R11, b1 * c2, d * R12
    )
    return of_b, of_c, angle


@njit
def bar_closed_form(v1: float, v2: float, u1: float, u2: float, h1: float, h2: float) -> BarIntegrals:
    """(outward, axial) of a whole bar and d(outward)/dX, /dv, /dz, eqs. (24)-(26); u = r - X, h1 > h2."""
    v_at_h1, _, angle_h1 = _plane(h1, v1, v2, u1, u2)
    v_at_h2, _, angle_h2 = _plane(h2, v1, v2, u1, u2)
    u_at_v1, h_at_v1, _ = _plane(v1, u1, u2, h2, h1)
    u_at_v2, h_at_v2, _ = _plane(v2, u1, u2, h2, h1)
    v_at_u1, _, angle_u1 = _plane(u1, v1, v2, h2, h1)
    v_at_u2, _, angle_u2 = _plane(u2, v1, v2, h2, h1)
    outward = -(
        v2 * u_at_v2 - v1 * u_at_v1 + u2 * v_at_u2 - u1 * v_at_u1 - abs(h1) * angle_h1 + abs(h2) * angle_h2
    )
    axial = -(
        v2 * h_at_v2 - v1 * h_at_v1 + h1 * v_at_h1 - h2 * v_at_h2 - abs(u2) * angle_u2 + abs(u1) * angle_u1
    )
    dz = math.copysign(1.0, h1) * angle_h1 - math.copysign(1.0, h2) * angle_h2
    return outward, axial, v_at_u2 - v_at_u1, u_at_v1 - u_at_v2, dz


@inlined(fastmath={"reassoc"})
def _bar_sum(
    slice_of: Callable[..., Any],
    total: BarIntegrals,
    factor: float,
    n: int,
    v1: float,
    v2: float,
    X: float,
    section: tuple[float, ...],
) -> BarIntegrals:
    """total and `factor` times the sum over n points along the bar of slice_of(X, v, *section)."""
    outward, axial, dX, dv, dz = total
    half, middle = 0.5 * (v2 - v1), 0.5 * (v1 + v2)
    start = gauss_start(n)
    for k in range(start, start + n):
        weight = factor * half * GAUSS_WEIGHTS[k]
        a, b, c, d, e = slice_of(X, middle + half * GAUSS_NODES[k], *section)
        outward += weight * a
        axial += weight * b
        dX += weight * c
        dv += weight * d
        dz += weight * e
    return outward, axial, dX, dv, dz


@inlined
def bar_integrals(
    v1: float, v2: float, X: float, section: Section, limits: Array, gap: float, digits: float
) -> BarIntegrals:
    """(outward, axial) and d(outward)/d(outward, current, z) of a bar; gap as in `arc.arc_integrals`."""
    n = _bar_points(v1, v2, X, section, limits)
    total = (0.0, 0.0, 0.0, 0.0, 0.0)
    if gap == 0.0:
        if n == 0:
            r1, r2, h1, h2 = section
            return bar_closed_form(v1, v2, r1 - X, r2 - X, h1, h2)
        return _bar_sum(bar_slice, total, 1.0, n, v1, v2, X, section)
    n = _MOST_FAR if n == 0 else n
    nr, nz = section_points(section, gap, digits)
    for i in range(nr):
        for j in range(nz):
            r, h, area = filament(nr, i, nz, j, section)
            total = _bar_sum(filament_slice, total, area, n, v1, v2, X, (r, h))
    return total
