"""A sparse factor of the inverse of the matrix of mutual potentials: W^-1 is about G^T G.

Row i of G has entries for face i and its nearest faces among those before it in an order from coarse to fine. With
these entries G W G^T comes closest to the unit matrix (Schaefer, Katzfuss, Owhadi, SIAM J. Sci. Comput. 43 (2021)
A2019, eq. (3)):

    g_i = W_ss^-1 e_i / sqrt(e_i^T W_ss^-1 e_i),     s: the faces of the row.

Charges on the coarse faces near by screen a fine face from all that is further away. G^T G is positive definite for any
choice of the entries.
"""

import math

import numpy as np

from fieldmap.kernels.compilation import njit
from fieldmap.kernels.iron.mutual_potential import entry


@njit
def _exchange(values, a, b):
    values[a], values[b] = values[b], values[a]


@njit(fastmath=True)
def farthest_first(x, y, z):
    """An order (n,) from coarse to fine: every point is the one farthest from all before it; the first is point 0.
    x, y, z (n,) are rearranged in that order. Work n^2 / 2, in a loop that the compiler turns into vector code."""
    n = x.size
    order = np.arange(n)
    distance2 = np.full(n, np.float32(np.inf))
    for k in range(n):
        best, place = distance2[k], k
        for j in range(k + 1, n):
            if distance2[j] > best:
                best, place = distance2[j], j
        _exchange(order, k, place)
        _exchange(distance2, k, place)
        _exchange(x, k, place)
        _exchange(y, k, place)
        _exchange(z, k, place)
        px, py, pz = x[k], y[k], z[k]
        for j in range(k + 1, n):
            d2 = (x[j] - px) ** 2 + (y[j] - py) ** 2 + (z[j] - pz) ** 2
            distance2[j] = min(distance2[j], d2)
    return order


@njit
def solve_for_last(matrix, count):
    """Fill row `count` of matrix (>= count + 1, count) with W^-1 e / sqrt(e W^-1 e) for the last unit vector e. The
    rows before it hold the lower triangle of W, which is overwritten by its Cholesky factor L. L^-1 e has one entry
    only, so that only L^-T is applied."""
    for j in range(count):
        for k in range(j):
            factor = matrix[j, k]
            total = 0.0
            for q in range(k):
                total += matrix[j, q] * matrix[k, q]
            matrix[j, k] = (factor - total) / matrix[k, k]
        total = matrix[j, j]
        for q in range(j):
            total -= matrix[j, q] * matrix[j, q]
        matrix[j, j] = math.sqrt(total)
    out = matrix[count]
    for i in range(count):
        out[i] = 0.0
    # e^T W^-1 e = 1 / L_ll^2 for the last row l, so that the scaled L^-1 e is e itself.
    out[count - 1] = 1.0
    for i in range(count - 1, -1, -1):
        out[i] /= matrix[i, i]
        for q in range(i):
            out[q] -= matrix[i, q] * out[i]


@njit(nogil=True)
def inverse_rows(begin, end, columns, filled, leaf, start, block_of_leaves, offset, data, x, y, z, values):
    """Fill values (n, k), single precision, with the rows of G. columns (n, k): the faces of every row in its first
    filled[i] places, the row's own face last; the other arrays as in `fieldmap.kernels.iron.mutual_potential.entry`."""
    width = columns.shape[1]
    matrix = np.empty((width + 1, width))
    for i in range(begin, end):
        count = filled[i]
        for p in range(count):
            for q in range(p + 1):
                matrix[p, q] = entry(
                    columns[i, p], columns[i, q], leaf, start, block_of_leaves, offset, data, x, y, z
                )
        solve_for_last(matrix, count)
        for p in range(count):
            values[i, p] = matrix[count, p]
