"""Mean potentials between two sets of triangles: a block of the matrix of `fieldmap.kernels.mutual_potential`."""

import math

import numpy as np
from numba import njit, prange

from fieldmap.kernels.mutual_potential import _mean_potential

_INVERSE_4PI = 1.0 / (4.0 * math.pi)


@njit(cache=True, fastmath=True)
def _far_row(i, stop, far, other_far, sums):
    """Fill sums (3 stop,) with the sum of 1/|p - q| over the three points p of triangle i, for the points q of the
    other set's triangles below `stop`. No branches over contiguous arrays: the compiler turns it into vector code."""
    for q in range(3 * stop):
        sums[q] = 0.0
    x, y, z = other_far[0], other_far[1], other_far[2]
    for p in range(3 * i, 3 * i + 3):
        px, py, pz = far[0, p], far[1, p], far[2, p]
        for q in range(3 * stop):
            dx, dy, dz = px - x[q], py - y[q], pz - z[q]
            # A triangle that is its own image would meet itself; its pair is near, the sum is not used.
            sums[q] += 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz + 1e-60)


@njit(cache=True, fastmath=True)
def _near_pair(i, j, distance2, one, other):
    """Pair of close triangles in closed form: one integral where they are apart, both orders where they touch."""
    corners, normals, areas, _, radii, near, near_weights, touch, touch_weights = one
    other_corners, other_normals, other_areas, _, other_radii, other_near, _, other_touch, _ = other
    if distance2 > (radii[i] + other_radii[j]) ** 2:
        # The outer rule belongs to the smaller triangle, over which the other's potential varies less.
        if areas[i] < other_areas[j]:
            return _mean_potential(near[i], near_weights, other_corners[j], other_normals[j]) / other_areas[j]
        return _mean_potential(other_near[j], near_weights, corners[i], normals[i]) / areas[i]
    return 0.5 * (
        _mean_potential(touch[i], touch_weights, other_corners[j], other_normals[j]) / other_areas[j]
        + _mean_potential(other_touch[j], touch_weights, corners[i], normals[i]) / areas[i]
    )


@njit(cache=True, fastmath=True)
def _fill_row(i, stop, one, other, reach, sums, w):
    """w[i, j] for j < stop, from the point sums of `_far_row` and closed forms near by."""
    centres, radii, other_centres, other_radii = one[3], one[4], other[3], other[4]
    for j in range(stop):
        x = centres[i, 0] - other_centres[j, 0]
        y = centres[i, 1] - other_centres[j, 1]
        z = centres[i, 2] - other_centres[j, 2]
        distance2 = x * x + y * y + z * z
        if distance2 > (reach * (radii[i] + other_radii[j])) ** 2:
            value = (sums[3 * j] + sums[3 * j + 1] + sums[3 * j + 2]) / 9.0
        else:
            value = _near_pair(i, j, distance2, one, other)
        w[i, j] = value * _INVERSE_4PI


@njit(cache=True, parallel=True, fastmath=True)
def mutual_potential_block(one, one_far, other, other_far, reach, symmetric):
    """Block (n, n) in 1/m: mean potential on triangle i of the one set of unit charge on triangle j of the other.

    one, other: (corners (n, 3, 3), normals (n, 3), areas (n,), centres (n, 3), radii (n,), points of the near rule
    (n, q, 3) and weights, points of the touch rule (n, t, 3) and weights), as in `mutual_potential`; far: x, y and z
    (3, 3 n) of the points of the degree-2 rule. symmetric: the lower triangle is computed and copied.
    """
    n = one[2].size
    w = np.empty((n, n))
    # Rows k and n - 1 - k together cost the same for every k, so the threads share a triangle evenly.
    for k in prange((n + 1) // 2):
        sums = np.empty(3 * n)
        # The loop's own index is unsigned; its difference from n would be a float.
        low = np.int64(k)
        for i in (low, n - 1 - low):
            stop = i + 1 if symmetric else n
            _far_row(i, stop, one_far, other_far, sums)
            _fill_row(i, stop, one, other, reach, sums, w)
    if symmetric:
        for i in prange(n):
            for j in range(i + 1, n):
                w[i, j] = w[j, i]
    return w
