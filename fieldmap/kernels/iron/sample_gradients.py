"""Gradients of nodal functions at the four points of second-order tetrahedra, all points and functions at once, and
what the magnetisation at the points adds to residuals on these functions."""

import math

import numpy as np
from numba import njit, prange

from fieldmap.kernels.iron.magnetisation_law import flux_density
from fieldmap.kernels.iron.quadratic_potential import _gradient, _shape_gradients


@njit(cache=True, parallel=True)
def sample_gradients(values, nodes, gradients):
    """Gradients (e, 4, 3, r) of nodal functions `values` (n, r) at the points of `quadratic_potential.residual`.

    nodes (e, 10); gradients (e, 4, 3) of the barycentric coordinates.
    """
    count, functions = nodes.shape[0], values.shape[1]
    out = np.empty((count, 4, 3, functions))
    for e in prange(count):
        d = np.empty((10, 3))
        one = np.empty(3)
        for q in range(4):
            _shape_gradients(q, gradients[e], d)
            for j in range(functions):
                _gradient(values[:, j], nodes[e], d, one)
                out[e, q, 0, j], out[e, q, 1, j], out[e, q, 2, j] = one[0], one[1], one[2]
    return out


@njit(cache=True, parallel=True, nogil=True, fastmath=True)
def point_residuals(source, gradients, weights, law, offset, knots, coefficients, amplitude):
    """w (b/h - 1) h . G_j of every point (p, r) at h = source - G a: source (3 p,), G = gradients (3 p, r), w = weights
    (p,), law (p,) and tables of `fieldmap.kernels.iron.magnetisation_law`, a = amplitude (r,)."""
    points, modes = weights.size, amplitude.size
    out = np.empty((points, modes))
    for p in prange(points):
        hx, hy, hz = source[3 * p], source[3 * p + 1], source[3 * p + 2]
        gx, gy, gz = gradients[3 * p], gradients[3 * p + 1], gradients[3 * p + 2]
        x = y = z = 0.0
        for j in range(modes):
            x += gx[j] * amplitude[j]
            y += gy[j] * amplitude[j]
            z += gz[j] * amplitude[j]
        hx, hy, hz = hx - x, hy - y, hz - z
        h = math.sqrt(hx * hx + hy * hy + hz * hz) + 1e-14
        b, _ = flux_density(h, law[p], offset, knots, coefficients)
        m = weights[p] * (b / h - 1.0)
        for j in range(modes):
            out[p, j] = m * (hx * gx[j] + hy * gy[j] + hz * gz[j])
    return out
