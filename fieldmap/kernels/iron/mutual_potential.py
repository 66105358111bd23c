"""Mean potentials between two sets of charged triangles: the matrix of the iron solver, whole or a block of it."""

import math

import numpy as np

from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.iron.charged_triangle import triangle_potential

_INVERSE_4PI = 1.0 / (4.0 * math.pi)
_INVERSE_36PI = _INVERSE_4PI / 9.0


@inlined(fastmath=True)
def _mean_potential(points, weights, corners, normal):
    """Weighted mean over points (q, 3) of the potential of one triangle, by closed form."""
    total = 0.0
    for q in range(weights.size):
        total += weights[q] * triangle_potential(points[q, 0], points[q, 1], points[q, 2], corners, normal)
    return total


@inlined(fastmath=True)
def inverse_distance(dx, dy, dz):
    """1/sqrt of a sum of squares: in single precision, which costs a fraction, and one step of Newton's method."""
    # 1e-30: a triangle may meet itself, or be its own image. Such a pair is near, and the sum is not used.
    square = dx * dx + dy * dy + dz * dz + 1e-30
    guess = np.float64(np.float32(1.0) / np.sqrt(np.float32(square)))
    return guess * (1.5 - 0.5 * square * guess * guess)


@inlined(fastmath=True)
def _far_row(i, far, other_far, sums):
    """Fill sums (m,) with the sum of 1/|p - q| over the three points p of triangle i, for the first m points q of the
    other set's triangles. No branches (a division that may raise is one) over contiguous arrays: the compiler turns it
    into vector code."""
    x, y, z = other_far[0], other_far[1], other_far[2]
    a, b, c = 3 * i, 3 * i + 1, 3 * i + 2
    ax, ay, az = far[0, a], far[1, a], far[2, a]
    bx, by, bz = far[0, b], far[1, b], far[2, b]
    cx, cy, cz = far[0, c], far[1, c], far[2, c]
    for q in range(sums.size):
        sums[q] = (
            inverse_distance(ax - x[q], ay - y[q], az - z[q])
            + inverse_distance(bx - x[q], by - y[q], bz - z[q])
            + inverse_distance(cx - x[q], cy - y[q], cz - z[q])
        )


@inlined(fastmath=True)
def row_beyond(i, one, other, reach, beyond):
    """Fill beyond (m,) with the squared distances of triangle i from the first m of the other set, less the square of
    `reach` times the sum of both radii; one, other (4, n): centres and radii."""
    x, y, z, r = other[0], other[1], other[2], other[3]
    a, b, c, radius = one[0, i], one[1, i], one[2, i], one[3, i]
    for j in range(beyond.size):
        dx, dy, dz, size = a - x[j], b - y[j], c - z[j], reach * (radius + r[j])
        beyond[j] = dx * dx + dy * dy + dz * dz - size * size


@inlined(fastmath=True)
def separation(i, j, one, other):
    """Squared distance of the centres of two triangles, and the sum of their radii."""
    centres, radii, other_centres, other_radii = one[3], one[4], other[3], other[4]
    x = centres[i, 0] - other_centres[j, 0]
    y = centres[i, 1] - other_centres[j, 1]
    z = centres[i, 2] - other_centres[j, 2]
    return x * x + y * y + z * z, radii[i] + other_radii[j]


@inlined(fastmath=True)
def close_pair(i, j, apart, one, other):
    """Mean potential between close triangles, times 4 pi. `apart`: their circles do not overlap, and the outer rule
    belongs to the smaller one, over which the potential of the other varies less."""
    corners, normals, areas, _, _, near, near_weights, touch, touch_weights = one
    other_corners, other_normals, other_areas, _, _, other_near, _, other_touch, _ = other
    if not apart:
        return 0.5 * (
            _mean_potential(touch[i], touch_weights, other_corners[j], other_normals[j]) / other_areas[j]
            + _mean_potential(other_touch[j], touch_weights, corners[i], normals[i]) / areas[i]
        )
    if areas[i] < other_areas[j]:
        return _mean_potential(near[i], near_weights, other_corners[j], other_normals[j]) / other_areas[j]
    return _mean_potential(other_near[j], near_weights, corners[i], normals[i]) / areas[i]


@inlined(fastmath=True)
def _fill_row(i, one, other, sums, beyond, row):
    """row (m,) of W from the point sums of `_far_row`, and closed forms where beyond (m,) < 0."""
    for j in range(row.size):
        row[j] = (sums[3 * j] + sums[3 * j + 1] + sums[3 * j + 2]) * _INVERSE_36PI
    for j in range(row.size):
        if beyond[j] <= 0.0:
            distance2, size = separation(i, j, one, other)
            row[j] = close_pair(i, j, distance2 > size * size, one, other) * _INVERSE_4PI


@njit(nogil=True, fastmath=True)
def mutual_potential(begin, end, one, far, other, other_far, reach, symmetric, w):
    """Fill rows k and n - 1 - k of w (n, n), 1/m, for k from begin to end, at most (n + 1)/2, with
    W_ij = 1/(4 pi A_i A_j) int_i int_j dS dS' / R, the mean potential on triangle i of the one set of unit charge on
    triangle j of the other; for one set symmetric, positive definite.

    one, other: corners (n, 3, 3), normals (n, 3), areas (n,), centres (n, 3), radii (n,): farthest corner from the
    centre; near (n, q, 3) and weights, touch (n, t, 3) and weights: points of higher rules for the outer integral of
    pairs whose inner integral is done in closed form. far, other_far: x, y and z (3, 3 n) of the points of the degree-2
    rule, triangle by triangle, and the centres with the radii (4, n). Pairs closer than `reach` times the sum of their
    radii are near; pairs whose circles overlap use the `touch` rule, because their outer integrand has a kink.
    symmetric: only the lower triangle, which costs the same for every such pair of rows; `copy_lower` fills the rest.
    """
    n = one[2].size
    sums, beyond = np.empty(3 * n), np.empty(n)
    for k in range(begin, end):
        for i in (k, n - 1 - k):
            stop = i + 1 if symmetric else n
            _far_row(i, far[0], other_far[0], sums[: 3 * stop])
            row_beyond(i, far[1], other_far[1], reach, beyond[:stop])
            _fill_row(i, one, other, sums, beyond, w[i, :stop])


@njit(nogil=True)
def copy_lower(begin, end, w):
    """Copy the lower triangle of w (n, n) to the upper one, in the rows from begin to end."""
    for i in range(begin, end):
        for j in range(i + 1, w.shape[0]):
            w[i, j] = w[j, i]


@inlined(fastmath=True)
def _far_pair(i, j, x, y, z):
    """Sum of 1/|p - q| over the three points of each triangle; x, y, z (3, n)."""
    total = 0.0
    for p in range(3):
        for q in range(3):
            dx, dy, dz = x[p, i] - x[q, j], y[p, i] - y[q, j], z[p, i] - z[q, j]
            total += 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
    return total


@njit(nogil=True, fastmath=True)
def fill_near_blocks(begin, end, blocks, offset, number, faces, x, y, z, reach, data):
    """data[offset[k] + ...] = block k (rows, columns) of W in 1/m. blocks (b, 4): first and last + 1 of rows and
    columns; number (n,): of the faces in the whole matrix, so that both have the same entries; x, y, z (3, n): points
    of the degree-2 rule; faces: a set of triangles as in `mutual_potential`, and reach."""
    for k in range(begin, end):
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


@inlined(fastmath=True)
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
