"""Gradients of nodal functions at the four points of second-order tetrahedra, all points and functions at once, and
the magnetisation there."""

import math

import numpy as np

from fieldmap.kernels.compilation import njit
from fieldmap.kernels.iron.magnetisation_law import flux_density
from fieldmap.kernels.iron.quadratic_potential import potential_gradient, shape_gradients


@njit(nogil=True)
def sample_gradients(begin, end, values, nodes, gradients, out):
    """Fill out (e, 4, 3, r) with the gradients of nodal functions `values` (n, r) at the points of
    `quadratic_potential.residual`.

    nodes (e, 10); gradients (e, 4, 3) of the barycentric coordinates.
    """
    functions = values.shape[1]
    d = np.empty((10, 3))
    one = np.empty(3)
    for e in range(begin, end):
        for q in range(4):
            shape_gradients(q, gradients[e], d)
            for j in range(functions):
                potential_gradient(values[:, j], nodes[e], d, one)
                out[e, q, 0, j], out[e, q, 1, j], out[e, q, 2, j] = one[0], one[1], one[2]


@njit(nogil=True, fastmath=True)
def point_moments(begin, end, source, gradients, weights, law, offset, knots, coefficients, amplitude, out):
    """Fill out (p, 3) with w (b/h - 1) h of every point, T m^3: mu0 times the magnetic moment that it stands for, at
    h = source - G a: source (3 p,), G = gradients (3 p, r), w = weights (p,), law (p,) and tables of
    `fieldmap.kernels.iron.magnetisation_law`, a = amplitude (r,)."""
    modes = amplitude.size
    for p in range(begin, end):
        gx, gy, gz = gradients[3 * p], gradients[3 * p + 1], gradients[3 * p + 2]
        x = y = z = 0.0
        for j in range(modes):
            x += gx[j] * amplitude[j]
            y += gy[j] * amplitude[j]
            z += gz[j] * amplitude[j]
        x, y, z = source[3 * p] - x, source[3 * p + 1] - y, source[3 * p + 2] - z
        h = math.sqrt(x * x + y * y + z * z) + 1e-14
        b, _ = flux_density(h, law[p], offset, knots, coefficients)
        m = weights[p] * (b / h - 1.0)
        out[p, 0], out[p, 1], out[p, 2] = m * x, m * y, m * z
