"""Products of a matrix and a vector for matrices of the size of a cache, always on one thread.

A BLAS library shares even these among its threads, and waits for them: a hundred times the product itself where another
program has the second core.
"""

import numpy as np

from fieldmap.kernels.compilation import njit


@njit(fastmath=True, forceinline=True)
def times(matrix, vector):
    """matrix (n, m) @ vector (m,)."""
    out = np.empty(matrix.shape[0], matrix.dtype)
    for i in range(out.size):
        row = matrix[i]
        total = matrix.dtype.type(0.0)
        for j in range(vector.size):
            total += row[j] * vector[j]
        out[i] = total
    return out


@njit(fastmath=True, forceinline=True)
def times_transposed(vector, matrix):
    """vector (n,) @ matrix (n, m)."""
    out = np.zeros(matrix.shape[1], matrix.dtype)
    for i in range(vector.size):
        row, share = matrix[i], vector[i]
        for j in range(out.size):
            out[j] += share * row[j]
    return out
