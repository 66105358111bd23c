"""Regular solid harmonics and their derivatives, for those who fit polynomials: fieldmap/core/harmonics.h."""

import numpy as np

from fieldmap.core.library import LIBRARY
from fieldmap.typing import Array


def regular_table(degree: int, points: Array) -> Array:
    """(n, (degree + 1)^2): the harmonics at points (n, 3), in the order of the coefficients."""
    return LIBRARY.harmonics(degree, np.ascontiguousarray(points, dtype=np.float64))


def derivative_matrix(degree: int, axis: int) -> Array:
    """Matrix (degree^2, (degree + 1)^2) that takes coefficients to those of the derivative along an axis."""
    return LIBRARY.derivative_matrix(degree, axis)
