"""Gauss-Legendre points on [-1, 1] for 1 to 64 points, one table after the other, for use inside kernels."""

import numpy as np

from fieldmap.kernels.compilation import njit

MOST_POINTS = 64
_RULES = [np.polynomial.legendre.leggauss(n) for n in range(1, MOST_POINTS + 1)]
GAUSS_NODES = np.concatenate([nodes for nodes, _ in _RULES])
GAUSS_WEIGHTS = np.concatenate([weights for _, weights in _RULES])


@njit
def gauss_start(n: int) -> int:
    """Index of the first point of the rule with n points in GAUSS_NODES and GAUSS_WEIGHTS."""
    return n * (n - 1) // 2
