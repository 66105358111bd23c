"""Number of Gauss-Legendre points for the sum over the slices of a winding.

The integrand along a winding is singular at complex positions offset +- i depth, where depth is about the distance
of the field point from the winding section. Points spread evenly converge like Bernstein's ellipse through that
position. The substitution t = depth sinh(w) moves it to Im w = pi/2, so that the number of points grows with the
logarithm of 1/depth only: docs/theory/coils.md (21)-(23). Rules have a multiple of STEP points, which fill the
vector registers.
"""

import math

import numpy as np

from fieldmap.kernels.compilation import inlined, njit
from fieldmap.typing import Array

Section = tuple[float, float, float, float]
"""r1, r2, h1, h2: a winding's section as a field point sees it, see `fieldmap.kernels.coils.slice`."""
STEP = 8
RULES = 8  # 8, 16, ... 64 points
MARGIN = 1.5  # further decimal digits, lost by cancellation between opposite sides of a coil


@njit
def rule_limits(digits: float) -> Array:
    """limits (2, RULES): the smallest (|z-1| + |z+1|)/2 of the singularity (row 0) and the largest half width of w
    (row 1) for which 8, 16, ... points give `digits` correct decimal digits."""
    limits = np.empty((2, RULES))
    for k in range(RULES):
        rate = 0.5 * math.log(10.0) * (digits + MARGIN) / (STEP * (k + 1))
        limits[0, k] = math.cosh(rate)
        limits[1, k] = 0.5 * math.pi / math.sinh(rate)
    return limits


@inlined
def even_points(ellipse: float, limits: Array, most: int) -> int:
    """Evenly spread points for a singularity at (|z-1| + |z+1|)/2 = ellipse, or 0 if more than `most`."""
    for k in range(most // STEP):
        if ellipse >= limits[0, k]:
            return STEP * (k + 1)
    return 0


@inlined
def graded_points(half: float, limits: Array) -> int:
    """Points for the sinh substitution on |w| <= half."""
    for k in range(RULES):
        if half <= limits[1, k]:
            return STEP * (k + 1)
    return STEP * RULES


@inlined
def section_distance(X: float, section: Section) -> tuple[float, bool]:
    """Distance of a point from the boundary of a section and whether it is inside."""
    r1, r2, h1, h2 = section
    across = max(r1 - X, X - r2)
    along = max(-h1, h2)
    if across < 0.0 and along < 0.0:
        return min(-across, -along), True
    across, along = max(across, 0.0), max(along, 0.0)
    return math.sqrt(across * across + along * along), False
