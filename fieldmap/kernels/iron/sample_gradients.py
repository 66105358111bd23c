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


@njit(nogil=True)
def magnetise_states(h, weights, law, offset, knots, coefficients):
    """h (3 p, s) of s states becomes w (b/h - 1) h, as in `point_moments`."""
    for p in range(weights.size):
        for k in range(h.shape[1]):
            x, y, z = h[3 * p, k], h[3 * p + 1, k], h[3 * p + 2, k]
            size = math.sqrt(x * x + y * y + z * z) + 1e-14
            b, _ = flux_density(size, law[p], offset, knots, coefficients)
            m = weights[p] * (b / size - 1.0)
            h[3 * p, k], h[3 * p + 1, k], h[3 * p + 2, k] = m * x, m * y, m * z


@njit(nogil=True)
def root_of_susceptibility(h, weights, law, offset, knots, coefficients, rows):
    """rows (p, 3, r) of each point are multiplied by the square root of w (db/dh - 1), a symmetric matrix (3, 3) whose
    one axis is h (3 p,)."""
    for p in range(weights.size):
        x, y, z = h[3 * p], h[3 * p + 1], h[3 * p + 2]
        size = math.sqrt(x * x + y * y + z * z) + 1e-14
        b, slope = flux_density(size, law[p], offset, knots, coefficients)
        across = math.sqrt(weights[p] * max(b / size - 1.0, 0.0))
        along = math.sqrt(weights[p] * max(slope - 1.0, 0.0)) - across
        x, y, z = x / size, y / size, z / size
        for j in range(rows.shape[2]):
            part = along * (x * rows[p, 0, j] + y * rows[p, 1, j] + z * rows[p, 2, j])
            rows[p, 0, j] = across * rows[p, 0, j] + x * part
            rows[p, 1, j] = across * rows[p, 1, j] + y * part
            rows[p, 2, j] = across * rows[p, 2, j] + z * part
