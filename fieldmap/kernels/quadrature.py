"""How many Gauss-Legendre points the sum over the slices of a winding needs.

The integrand along a winding is singular at complex positions +- i d, d being about the distance of the field point
from the section. Either the points are spread evenly, or the substitution t = d sinh(w) moves the singularity to
Im w = pi/2, so that the number of points grows with log(1/d) only: docs/theory/coils.md (21)-(23).
"""

import math

import numba

from fieldmap.kernels.gauss import MOST_POINTS


@numba.njit(cache=True, error_model="numpy")
def points_even(offset: float, depth: float, half: float, digits: float) -> float:
    """Points for `digits` digits on |t| <= half with singularities at offset +- i depth: Bernstein's ellipse."""
    a = 0.5 * (math.hypot(offset + half, depth) + math.hypot(offset - half, depth)) / half
    return 1.1513 * digits / math.log(a + math.sqrt(max(a * a - 1.0, 1e-12)))


@numba.njit(cache=True, error_model="numpy")
def points_sinh(half: float, digits: float) -> float:
    """Points for `digits` digits on |w| <= half with singularities on the lines Im w = +- pi/2."""
    return 1.1513 * digits / math.asinh(0.5 * math.pi / max(half, 1e-3))


@numba.njit(cache=True, error_model="numpy")
def whole_points(n: float) -> int:
    """The rule to use for a wanted number of points."""
    return max(2, min(MOST_POINTS, int(n) + 1))


@numba.njit(cache=True, error_model="numpy")
def section_distance(X: float, r1: float, r2: float, h1: float, h2: float) -> tuple[float, bool]:
    """Distance of a point from the boundary of a section, and whether it lies inside. h1 > h2 as in `slice`."""
    across = max(r1 - X, X - r2)
    along = max(-h1, h2)
    if across < 0.0 and along < 0.0:
        return min(-across, -along), True
    across, along = max(across, 0.0), max(along, 0.0)
    return math.sqrt(across * across + along * along), False
