"""Product of a symmetric matrix with a few columns: half the matrix is read once for all of them.

BLAS reads the whole matrix for several columns, or half of it for each, and its wrappers keep the interpreter's lock.
"""

from fieldmap.kernels.compilation import inlined, njit

# Rows that are summed in one pass over the columns.
_ROWS = 4


@inlined(nogil=True, fastmath={"nsz", "arcp", "contract", "afn", "reassoc"})
def _beyond(a, b, c, d, x, y, own):
    """The four sums over j of the rows a, b, c, d times x, and y[j] += a[j] own[0] + ... + d[j] own[3]."""
    p, q, r, s = own[0], own[1], own[2], own[3]
    e = f = g = h = x[0] * 0
    for j in range(x.size):
        v = x[j]
        e += a[j] * v
        f += b[j] * v
        g += c[j] * v
        h += d[j] * v
        y[j] += a[j] * p + b[j] * q + c[j] * r + d[j] * s
    return e, f, g, h


@njit(nogil=True)
def symmetric_product(matrix, right, out):
    """Fill out (c, n) with matrix (n, n) times the rows of right (c, n); only the matrix's upper triangle is read."""
    n, columns = right.shape[1], right.shape[0]
    out[:] = 0
    for first in range(0, n, _ROWS):
        last = min(first + _ROWS, n)
        for k in range(columns):
            x, y = right[k], out[k]
            for i in range(first, last):
                y[i] += matrix[i, i] * x[i]
                for j in range(i + 1, last):
                    y[i] += matrix[i, j] * x[j]
                    y[j] += matrix[i, j] * x[i]
            if last == n:
                continue
            a, b, c, d = matrix[first], matrix[first + 1], matrix[first + 2], matrix[first + 3]
            sums = _beyond(a[last:], b[last:], c[last:], d[last:], x[last:], y[last:], x[first:last])
            for i in range(_ROWS):
                y[first + i] += sums[i]
