"""Neumann's double integral over two windings as a sum over their current elements."""

import math

from fieldmap.kernels.compilation import njit
from fieldmap.typing import Array


@njit(nogil=True, fastmath={"reassoc", "contract"})
def neumann_sum(points: Array, vectors: Array, others: Array, of_others: Array) -> float:
    """Double sum of v . w / |p - q| over elements v at points p (3, n) and w at q (3, m), in m for vectors in m.

    Elements of both must not lie at one point. Nothing of size n times m is stored.
    """
    total = 0.0
    for i in range(points.shape[1]):
        px, py, pz = points[0, i], points[1, i], points[2, i]
        x = y = z = 0.0
        for j in range(others.shape[1]):
            dx, dy, dz = others[0, j] - px, others[1, j] - py, others[2, j] - pz
            inverse = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
            x += of_others[0, j] * inverse
            y += of_others[1, j] * inverse
            z += of_others[2, j] * inverse
        total += vectors[0, i] * x + vectors[1, i] * y + vectors[2, i] * z
    return total
