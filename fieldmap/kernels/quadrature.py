"""How many Gauss-Legendre points a slice quadrature needs, and how near a point is to a winding section.

The integrand along a winding is singular at a complex position whose imaginary part is about the distance of the
point from the section. The substitution t = d sinh(w) moves that to Im w = pi/2, so that the number of points grows
with the logarithm of 1/d only: docs/theory/coils.md (21)-(22).
"""

import math

import numba

from fieldmap.kernels.gauss import MOST_POINTS


@numba.njit(cache=True, error_model="numpy")
def points_for(half_range: float, digits: float) -> int:
    """Points for `digits` correct digits on a range of w of the given half width."""
    rate = math.asinh(0.5 * math.pi / max(half_range, 1e-3))
    return max(2, min(MOST_POINTS, int(1.1513 * digits / rate) + 1))


@numba.njit(cache=True, error_model="numpy")
def section_distance(X: float, r1: float, r2: float, h1: float, h2: float) -> tuple[float, bool]:
    """Distance of a point from the boundary of a section, and whether it lies inside. h1 > h2 as in `slice`."""
    across = max(r1 - X, X - r2)
    along = max(-h1, h2)
    if across < 0.0 and along < 0.0:
        return min(-across, -along), True
    across, along = max(across, 0.0), max(along, 0.0)
    return math.sqrt(across * across + along * along), False
