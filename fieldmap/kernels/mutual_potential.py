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


@njit(cache=True, fastmath=True, inline="always")
def _mean_inverse_distance(a, b):
    """Mean of 1/|x - y| over three points x and three points y with equal weights."""
    total = 0.0
    for p in range(3):
        for q in range(3):
            x = a[p, 0] - b[q, 0]
            y = a[p, 1] - b[q, 1]
            z = a[p, 2] - b[q, 2]
            total += 1.0 / math.sqrt(x * x + y * y + z * z)
    return total / 9.0


@njit(cache=True, parallel=True, fastmath=True)
def mutual_potential(corners, normals, areas, radii, far, near, near_weights, touch, touch_weights, reach):
    """W (n, n) in 1/m: W_ij = 1/(4 pi A_i A_j) int_i int_j dS dS' / R, symmetric, positive definite.

    corners (n, 3, 3), normals (n, 3), areas (n,), radii (n,): farthest corner from the centre. far (n, 3, 3): points
    of the degree-2 rule; near (n, q, 3), touch (n, t, 3): points of higher rules for the outer integral of pairs
    whose inner integral is done in closed form. Pairs closer than `reach` times the sum of their radii are near;
    pairs whose circles overlap use the `touch` rule, whose outer integrand has a kink.
    """
    n = areas.size
    w = np.empty((n, n))
    for i in prange(n):
        centre_x = (corners[i, 0, 0] + corners[i, 1, 0] + corners[i, 2, 0]) / 3.0
        centre_y = (corners[i, 0, 1] + corners[i, 1, 1] + corners[i, 2, 1]) / 3.0
        centre_z = (corners[i, 0, 2] + corners[i, 1, 2] + corners[i, 2, 2]) / 3.0
        for j in range(i + 1):
            x = centre_x - (corners[j, 0, 0] + corners[j, 1, 0] + corners[j, 2, 0]) / 3.0
            y = centre_y - (corners[j, 0, 1] + corners[j, 1, 1] + corners[j, 2, 1]) / 3.0
            z = centre_z - (corners[j, 0, 2] + corners[j, 1, 2] + corners[j, 2, 2]) / 3.0
            distance2 = x * x + y * y + z * z
            size = radii[i] + radii[j]
            if distance2 > (reach * size) ** 2:
                value = _mean_inverse_distance(far[i], far[j])
            elif distance2 > size * size:
                # The outer rule belongs to the smaller triangle, over which the potential varies less.
                if areas[i] < areas[j]:
                    value = _mean_potential(near[i], near_weights, corners[j], normals[j]) / areas[j]
                else:
                    value = _mean_potential(near[j], near_weights, corners[i], normals[i]) / areas[i]
            else:
                value = 0.5 * (
                    _mean_potential(touch[i], touch_weights, corners[j], normals[j]) / areas[j]
                    + _mean_potential(touch[j], touch_weights, corners[i], normals[i]) / areas[i]
                )
            w[i, j] = value * _INVERSE_4PI
    for i in prange(n):
        for j in range(i + 1, n):
            w[i, j] = w[j, i]
    return w


@njit(cache=True, parallel=True, fastmath=True)
def mean_potential_of_others(points, weights, corners, normals, areas):
    """P (n, m) in 1/m: mean over triangle i of the potential of unit total charge on triangle j, over 4 pi.

    points (n, q, 3): rule points on the n observing triangles; corners (m, 3, 3) etc.: the charged triangles.
    """
    n, m = points.shape[0], areas.size
    p = np.empty((n, m))
    for i in prange(n):
        for j in range(m):
            p[i, j] = _mean_potential(points[i], weights, corners[j], normals[j]) * _INVERSE_4PI / areas[j]
    return p
