"""Regular solid harmonics and their derivatives, for fits of polynomials: fieldmap/core/harmonics.h."""

import numpy as np

from fieldmap.core.library import LIBRARY
from fieldmap.typing import Array


def regular_table(degree: int, points: Array) -> Array:
    """Return the harmonics (n, (degree + 1)^2) at points (n, 3), in the order of the coefficients."""
    return LIBRARY.harmonics(degree, np.ascontiguousarray(points, dtype=np.float64))


def derivative_matrix(degree: int, axis: int) -> Array:
    """Return the matrix (degree^2, (degree + 1)^2) from coefficients to those of the derivative along an axis."""
    return LIBRARY.derivative_matrix(degree, axis)
