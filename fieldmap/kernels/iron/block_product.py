"""Products of a symmetric matrix of dense and low-rank blocks; one triangle is stored, in single precision.

Sums are in double precision. Columns come in groups of four, so that every number of the matrix is loaded once and
used four times: charge and potential are arrays (groups, n, 4).
"""

import numpy as np

from fieldmap.kernels.compilation import inlined, njit


@inlined(fastmath=True)
def _sum_rows(row, x, first):
    """sum_i row[i] x[first + i, :] of x (n, 4)."""
    a = b = c = d = 0.0
    for i in range(row.size):
        v = np.float64(row[i])
        a += v * x[first + i, 0]
        b += v * x[first + i, 1]
        c += v * x[first + i, 2]
        d += v * x[first + i, 3]
    return a, b, c, d


@inlined(fastmath=True)
def _add_rows(row, a, b, c, d, y, first):
    """y[first + i, :] += row[i] (a, b, c, d)."""
    for i in range(row.size):
        v = np.float64(row[i])
        y[first + i, 0] += v * a
        y[first + i, 1] += v * b
        y[first + i, 2] += v * c
        y[first + i, 3] += v * d


@inlined(fastmath=True)
def _low_rank(left, right, r0, c0, x, y):
    for k in range(left.shape[0]):
        a, b, c, d = _sum_rows(right[k], x, c0)
        _add_rows(left[k], a, b, c, d, y, r0)
        a, b, c, d = _sum_rows(left[k], x, r0)
        _add_rows(right[k], a, b, c, d, y, c0)


@inlined(fastmath=True)
def _dense(values, r0, c0, x, y):
    """A block on the diagonal is stored whole and used once."""
    for i in range(values.shape[0]):
        a, b, c, d = _sum_rows(values[i], x, c0)
        y[r0 + i, 0] += a
        y[r0 + i, 1] += b
        y[r0 + i, 2] += c
        y[r0 + i, 3] += d
        if r0 != c0:
            _add_rows(values[i], x[r0 + i, 0], x[r0 + i, 1], x[r0 + i, 2], x[r0 + i, 3], y, c0)


@njit(nogil=True)
def add_far_product(begin, end, blocks, ranks, offset, data, x, y):
    """y[t] += matrix x, for t from begin to end, of the low-rank blocks of
    `fieldmap.kernels.iron.cross_approximation.pack_factors`; x (g, n, 4); y (t, g, n, 4): a part of the sum for each t.
    """
    parts = y.shape[0]
    for t in range(begin, end):
        for k in range(t, blocks.shape[0], parts):
            r0, c0 = blocks[k, 0], blocks[k, 2]
            m, n, r = blocks[k, 1] - r0, blocks[k, 3] - c0, ranks[k]
            left = data[offset[k] : offset[k] + r * m].reshape(r, m)
            right = data[offset[k] + r * m : offset[k] + r * (m + n)].reshape(r, n)
            for g in range(x.shape[0]):
                _low_rank(left, right, r0, c0, x[g], y[t, g])


@njit(nogil=True)
def add_near_product(begin, end, blocks, offset, data, x, y):
    """As `add_far_product`, for dense blocks (rows, columns) from data[offset[k]] on."""
    parts = y.shape[0]
    for t in range(begin, end):
        for k in range(t, blocks.shape[0], parts):
            r0, c0 = blocks[k, 0], blocks[k, 2]
            m, n = blocks[k, 1] - r0, blocks[k, 3] - c0
            values = data[offset[k] : offset[k] + m * n].reshape(m, n)
            for g in range(x.shape[0]):
                _dense(values, r0, c0, x[g], y[t, g])
