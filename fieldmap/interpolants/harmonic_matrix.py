"""What a harmonic polynomial gives at points, as a matrix on its coefficients."""

import numpy as np

from fieldmap.kernels.map.solid_harmonics import derivative_matrix, regular_table
from fieldmap.typing import Array


def field_matrix(degree: int, points: Array) -> Array:
    """(n, 3, (degree + 1)^2): first derivatives at local points (n, 3)."""
    table = regular_table(degree - 1, np.ascontiguousarray(points))
    return np.stack([table @ derivative_matrix(degree, i) for i in range(3)], axis=1)


def gradient_matrix(degree: int, points: Array) -> Array:
    """(n, 3, 3, (degree + 1)^2): second derivatives at local points (n, 3)."""
    table = regular_table(degree - 2, np.ascontiguousarray(points))
    rows = [
        table @ derivative_matrix(degree - 1, j) @ derivative_matrix(degree, i)
        for i in range(3)
        for j in range(3)
    ]
    return np.stack(rows, axis=1).reshape(len(points), 3, 3, (degree + 1) ** 2)
