"""Adaptive cross approximation of far blocks of the matrix of mutual potentials.

A block of faces that are far from each other is nearly of low rank: it is built from a few of its own rows and
columns (Bebendorf, Numer. Math. 86 (2000) 565; partial pivoting after Bebendorf and Rjasanow, Computing 70 (2003) 1),
and then cut down to the rank that the tolerance needs by a singular value decomposition of the small core.
"""

import math

import numpy as np

from fieldmap.kernels.compilation import inlined, njit

_INVERSE_36PI = 1.0 / (36.0 * math.pi)


@inlined(fastmath=True)
def far_values(i, first, last, x, y, z, out):
    """out[j - first] = W_ij for faces j from `first` to `last`, all far from face i; x, y, z (3, n): points of the
    degree-2 rule. Loops over contiguous arrays without branches, for the compiler to turn into vector code."""
    out[:] = 0.0
    for p in range(3):
        px, py, pz = x[p, i], y[p, i], z[p, i]
        for q in range(3):
            for j in range(first, last):
                dx, dy, dz = px - x[q, j], py - y[q, j], pz - z[q, j]
                out[j - first] += 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
    for j in range(out.size):
        out[j] *= _INVERSE_36PI


@inlined(fastmath=True)
def _subtract(known, weights, rank, out):
    """out -= sum of the first `rank` rows of known (r, m), each times its weight."""
    for k in range(rank):
        w = weights[k]
        for i in range(out.size):
            out[i] -= w * known[k, i]


@inlined(fastmath=True)
def _largest(values, used):
    """Index of the largest magnitude among those not used; -1 if all are."""
    best, place = -1.0, -1
    for i in range(values.size):
        if not used[i] and abs(values[i]) > best:
            best, place = abs(values[i]), i
    return place


@inlined(fastmath=True)
def _dot(a, b):
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i]
    return total


@njit(forceinline=True)
def cross(block, x, y, z, tolerance, left, right):
    """Fill left (cap, m) and right (cap, n) with factors: block = left^T right; returns the rank, or -1 if `cap`
    terms do not reach the tolerance (of the Frobenius norm). block (4,): first and last + 1 of rows and columns."""
    r0, r1, c0, c1 = block[0], block[1], block[2], block[3]
    cap, m, n = left.shape[0], r1 - r0, c1 - c0
    used_rows, used_columns = np.zeros(m, np.bool_), np.zeros(n, np.bool_)
    norm2 = 0.0
    row = 0
    for rank in range(cap):
        used_rows[row] = True
        u, v = left[rank], right[rank]
        far_values(r0 + row, c0, c1, x, y, z, v)
        _subtract(right, left[:rank, row].copy(), rank, v)
        column = _largest(v, used_columns)
        pivot = v[column]
        if pivot == 0.0:
            return rank
        used_columns[column] = True
        far_values(c0 + column, r0, r1, x, y, z, u)
        _subtract(left, right[:rank, column].copy(), rank, u)
        for i in range(m):
            u[i] /= pivot
        size2 = _dot(u, u) * _dot(v, v)
        overlap = 0.0
        for k in range(rank):
            overlap += _dot(left[k], u) * _dot(right[k], v)
        norm2 += 2.0 * overlap + size2
        if size2 <= tolerance * tolerance * norm2 or rank + 1 == min(m, n):
            return rank + 1
        row = _largest(u, used_rows)
    return -1


# Not inlined: QR and singular values take seconds to compile, and inlining would compile them again in the caller.
@njit
def recompress(left, right, rank, tolerance):
    """Lower the rank of left^T right as far as the tolerance allows, in place; returns the new rank."""
    rows, a = np.linalg.qr(left[:rank].T)
    columns, b = np.linalg.qr(right[:rank].T)
    p, s, qt = np.linalg.svd(np.ascontiguousarray(a) @ np.ascontiguousarray(b).T)
    tail, total = 0.0, np.sum(s * s)
    kept = s.size
    while kept > 1 and tail + s[kept - 1] ** 2 <= tolerance * tolerance * total:
        tail += s[kept - 1] ** 2
        kept -= 1
    u = np.ascontiguousarray(p.T)[:kept] @ np.ascontiguousarray(rows.T)
    v = np.ascontiguousarray(qt)[:kept] @ np.ascontiguousarray(columns.T)
    for k in range(kept):
        root = math.sqrt(s[k])
        for i in range(u.shape[1]):
            left[k, i] = root * u[k, i]
        for i in range(v.shape[1]):
            right[k, i] = root * v[k, i]
    return kept


@njit(nogil=True)
def approximate_far_blocks(begin, end, blocks, place, cap, x, y, z, tolerance, slots, scratch, ranks):
    """Fill ranks (b,) of far blocks (b, 4), -1 where more than `cap` terms are needed; factors of block k as two arrays
    (rank, rows) and (rank, columns) from scratch[place[k]] on, cap (rows + columns) numbers apart.

    Large blocks come first. Slot s has blocks s, s + slots, s + 2 slots, ...; slots from begin to end are done.
    """
    for slot in range(begin, end):
        for k in range(slot, blocks.shape[0], slots):
            m, n = blocks[k, 1] - blocks[k, 0], blocks[k, 3] - blocks[k, 2]
            start = place[k]
            left = scratch[start : start + cap * m].reshape(cap, m)
            right = scratch[start + cap * m : start + cap * (m + n)].reshape(cap, n)
            # A third of the error for the crosses, the rest for the recompression.
            rank = cross(blocks[k], x, y, z, tolerance / 3.0, left, right)
            if rank > 0:
                rank = recompress(left, right, rank, tolerance * (2.0 / 3.0))
            ranks[k] = rank


@njit(nogil=True)
def pack_factors(begin, end, blocks, place, cap, ranks, offset, scratch, data):
    """Copy the factors that `approximate_far_blocks` left in scratch to data (single precision), block k from
    offset[k] on: left (rank, rows), then right (rank, columns)."""
    for k in range(begin, end):
        m, n = blocks[k, 1] - blocks[k, 0], blocks[k, 3] - blocks[k, 2]
        rank = ranks[k]
        for i in range(rank * m):
            data[offset[k] + i] = scratch[place[k] + i]
        for i in range(rank * n):
            data[offset[k] + rank * m + i] = scratch[place[k] + cap * m + i]
