"""Dense blocks of the matrix of mutual potentials, by the same rule for pairs as the whole matrix."""

import math

from numba import njit, prange

from fieldmap.kernels.mutual_potential import close_pair, separation

_INVERSE_4PI = 1.0 / (4.0 * math.pi)
_INVERSE_36PI = _INVERSE_4PI / 9.0


@njit(cache=True, fastmath=True)
def _far_pair(i, j, x, y, z):
    """Sum of 1/|p - q| over the three points of each triangle; x, y, z (3, n)."""
    total = 0.0
    for p in range(3):
        for q in range(3):
            dx, dy, dz = x[p, i] - x[q, j], y[p, i] - y[q, j], z[p, i] - z[q, j]
            total += 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
    return total


@njit(cache=True, parallel=True, fastmath=True)
def fill_near_blocks(blocks, offset, number, faces, x, y, z, reach, data):
    """data[offset[k] + ...] = block k (rows, columns) of W in 1/m. blocks (b, 4): first and last + 1 of rows and
    columns; number (n,): of the faces in the whole matrix, which then has the same entries; x, y, z (3, n): points of
    the degree-2 rule; faces: a set of triangles as in `mutual_potential`, and reach."""
    for k in prange(blocks.shape[0]):
        place = offset[k]
        for i in range(blocks[k, 0], blocks[k, 1]):
            for j in range(blocks[k, 2], blocks[k, 3]):
                distance2, size = separation(i, j, faces, faces)
                if distance2 > (reach * size) ** 2:
                    value = _INVERSE_36PI * _far_pair(i, j, x, y, z)
                else:
                    # Of two triangles of one size the number decides which gets the outer rule.
                    a, b = (i, j) if number[i] > number[j] else (j, i)
                    value = _INVERSE_4PI * close_pair(a, b, distance2 > size * size, faces, faces)
                data[place] = value
                place += 1


@njit(cache=True, fastmath=True)
def entry(i, j, leaf, start, block_of_leaves, offset, data, x, y, z):
    """W_ij from the stored near blocks, by the far rule where there is none.

    leaf (n,): leaf of every face; start (l + 1,): first face of every leaf; block_of_leaves (l, l): number of the near
    block of two leaves, the later one first, or -1.
    """
    a, b = max(i, j), min(i, j)
    k = block_of_leaves[leaf[a], leaf[b]]
    if k < 0:
        return _INVERSE_36PI * _far_pair(a, b, x, y, z)
    columns = start[leaf[b] + 1] - start[leaf[b]]
    return float(data[offset[k] + (a - start[leaf[a]]) * columns + b - start[leaf[b]]])
