"""Mean potential of one charged triangle on another: the dense matrix of the iron solver."""

import math

import numpy as np
from numba import njit, prange

from fieldmap.kernels.charged_triangle import triangle_potential

_INVERSE_4PI = 1.0 / (4.0 * math.pi)


@njit(cache=True, fastmath=True, inline="always")
def _mean_potential(points, weights, corners, normal):
    """Weighted mean over points (q, 3) of the potential of one triangle, by closed form."""
    total = 0.0
    for q in range(weights.size):
        total += weights[q] * triangle_potential(points[q, 0], points[q, 1], points[q, 2], corners, normal)
    return total


@njit(cache=True, fastmath=True)
def _far_row(i, x, y, z, sums):
    """Fill sums (3 (i + 1),) with the sum of 1/|p - q| over the three points p of triangle i, for the points q of the
    triangles up to i. A loop without branches over contiguous arrays: the compiler turns it into vector code."""
    for q in range(3 * (i + 1)):
        sums[q] = 0.0
    for p in range(3 * i, 3 * i + 3):
        px, py, pz = x[p], y[p], z[p]
        # Triangle i itself is left out: its own points coincide.
        for q in range(3 * i):
            dx, dy, dz = px - x[q], py - y[q], pz - z[q]
            sums[q] += 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)


@njit(cache=True, fastmath=True)
def close_pair(i, j, apart, corners, normals, areas, near, near_weights, touch, touch_weights):
    """Mean potential between close triangles, times 4 pi. `apart`: their circles do not overlap, and the outer rule
    belongs to the smaller one, over which the potential of the other varies less."""
    if not apart:
        return 0.5 * (
            _mean_potential(touch[i], touch_weights, corners[j], normals[j]) / areas[j]
            + _mean_potential(touch[j], touch_weights, corners[i], normals[i]) / areas[i]
        )
    if areas[i] < areas[j]:
        return _mean_potential(near[i], near_weights, corners[j], normals[j]) / areas[j]
    return _mean_potential(near[j], near_weights, corners[i], normals[i]) / areas[i]


@njit(cache=True, fastmath=True)
def _fill_row(
    i, corners, normals, areas, centres, radii, near, near_weights, touch, touch_weights, reach, sums, w
):
    """Row i of the lower triangle of w, from the point sums of `_far_row` and closed forms near by."""
    for j in range(i + 1):
        x, y, z = (
            centres[i, 0] - centres[j, 0],
            centres[i, 1] - centres[j, 1],
            centres[i, 2] - centres[j, 2],
        )
        distance2 = x * x + y * y + z * z
        size = radii[i] + radii[j]
        if distance2 > (reach * size) ** 2:
            value = (sums[3 * j] + sums[3 * j + 1] + sums[3 * j + 2]) / 9.0
        else:
            apart = distance2 > size * size
            value = close_pair(i, j, apart, corners, normals, areas, near, near_weights, touch, touch_weights)
        w[i, j] = value * _INVERSE_4PI


@njit(cache=True, parallel=True, fastmath=True)
def mutual_potential(
    corners, normals, areas, centres, radii, far, near, near_weights, touch, touch_weights, reach
):
    """W (n, n) in 1/m: W_ij = 1/(4 pi A_i A_j) int_i int_j dS dS' / R, symmetric, positive definite.

    corners (n, 3, 3), normals (n, 3), areas (n,), centres (n, 3), radii (n,): farthest corner from the centre.
    far (3, 3 n): x, y and z of the points of the degree-2 rule, triangle by triangle; near (n, q, 3), touch
    (n, t, 3): points of higher rules for the outer integral of pairs whose inner integral is done in closed form.
    Pairs closer than `reach` times the sum of their radii are near; pairs whose circles overlap use the `touch`
    rule, whose outer integrand has a kink.
    """
    n = areas.size
    w = np.empty((n, n))
    # Rows k and n - 1 - k together cost the same for every k, so the threads share the triangle evenly.
    for k in prange((n + 1) // 2):
        sums = np.empty(3 * n)
        # The loop's own index is unsigned; its difference from n would be a float.
        low = np.int64(k)
        for i in (low, n - 1 - low):
            _far_row(i, far[0], far[1], far[2], sums)
            _fill_row(
                i,
                corners,
                normals,
                areas,
                centres,
                radii,
                near,
                near_weights,
                touch,
                touch_weights,
                reach,
                sums,
                w,
            )
    for i in prange(n):
        for j in range(i + 1, n):
            w[i, j] = w[j, i]
    return w
