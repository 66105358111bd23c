"""Newton's method for saturating iron on a small basis: the state at given currents in a fraction of a millisecond.

The potential of the iron is a combination of r modes with amplitudes a. At p sample points with positive weights w,
the field strength is h = s - G a, where s is the coils' field there. With b(h) the material's law, m = b/h - 1 and
the air's and the vacuum's part A (r, r), symmetric and positive,

    R(a) = G^T (w m h) + r0 - A a = 0,      K = G^T w (db/dh - 1) G + A,

is the residual and tangent of a convex functional: w > 0 and db/dh >= 1 make K positive. Vectors of the sample
points are stored with their three components one after the other: G is (3 p, r).
"""

import math

import numpy as np
from numba import njit

from fieldmap.kernels.magnetisation_law import flux_density

_TINY = 1e-14


@njit(cache=True)
def _magnetisation(h, weights, law, offset, knots, coefficients, out):
    """out (3 p,) = w m h."""
    for p in range(weights.size):
        x, y, z = h[3 * p], h[3 * p + 1], h[3 * p + 2]
        size = math.sqrt(x * x + y * y + z * z) + _TINY
        b, _ = flux_density(size, law[p], offset, knots, coefficients)
        m = weights[p] * (b / size - 1.0)
        out[3 * p], out[3 * p + 1], out[3 * p + 2] = m * x, m * y, m * z


@njit(cache=True)
def _tangent_rows(h, gradients, weights, law, offset, knots, coefficients, out):
    """out (3 p, r) = w (db/dh - 1) G."""
    modes = gradients.shape[1]
    for p in range(weights.size):
        x, y, z = h[3 * p], h[3 * p + 1], h[3 * p + 2]
        size = math.sqrt(x * x + y * y + z * z) + _TINY
        b, slope = flux_density(size, law[p], offset, knots, coefficients)
        m = weights[p] * (b / size - 1.0)
        extra = weights[p] * (slope - b / size) / (size * size)
        for j in range(modes):
            gx, gy, gz = gradients[3 * p, j], gradients[3 * p + 1, j], gradients[3 * p + 2, j]
            along = extra * (x * gx + y * gy + z * gz)
            out[3 * p, j] = m * gx + along * x
            out[3 * p + 1, j] = m * gy + along * y
            out[3 * p + 2, j] = m * gz + along * z


@njit(cache=True)
def _step_length(h, along, air_slope, air_curvature, start, weights, law, offset, knots, coefficients):
    """Where the functional is least along a step: h - t `along`, for t in (0, 1]; `start`: its slope at 0."""
    low, high, low_value, high_value, t = 0.0, 1.0, start, 0.0, 1.0
    for trial in range(12):
        value = -air_slope - t * air_curvature
        for p in range(weights.size):
            dx, dy, dz = along[3 * p], along[3 * p + 1], along[3 * p + 2]
            x, y, z = h[3 * p] - t * dx, h[3 * p + 1] - t * dy, h[3 * p + 2] - t * dz
            size = math.sqrt(x * x + y * y + z * z) + _TINY
            b, _ = flux_density(size, law[p], offset, knots, coefficients)
            value += weights[p] * (b / size - 1.0) * (x * dx + y * dy + z * dz)
        if trial == 0:
            if value > 0.0 or abs(value) <= 0.3 * abs(start):
                return 1.0
            high_value = value
        elif abs(value) < 0.1 * abs(start):
            return t
        elif value < 0.0:
            high, high_value = t, value
        else:
            low, low_value = t, value
        t = low + (high - low) * min(max(low_value / (low_value - high_value), 0.1), 0.9)
    return t


@njit(cache=True)
def newton(
    source, gradients, weights, law, offset, knots, coefficients, air, constant, start, tolerance, limit
):
    """Amplitudes (r,) for the coils' field `source` (3 p,) at the sample points, from `start` (r,).

    gradients (3 p, r), weights and law (p,), tables of `fieldmap.kernels.magnetisation_law`, air (r, r), constant
    (r,) = r0. Stops when the Newton decrement is below `tolerance` times the energy norm of the amplitudes. Returns
    the amplitudes, the number of steps, and the last relative decrement (larger than `tolerance` if `limit` steps
    were not enough).
    """
    a = start.copy()
    vector, rows = np.empty(source.size), np.empty(gradients.shape)
    decrement = np.inf
    for step in range(limit):
        h = source - gradients @ a
        _magnetisation(h, weights, law, offset, knots, coefficients, vector)
        air_a = air @ a
        residual = vector @ gradients + constant - air_a
        _tangent_rows(h, gradients, weights, law, offset, knots, coefficients, rows)
        tangent = gradients.T @ rows + air
        change = np.linalg.solve(tangent, residual)
        slope = residual @ change
        decrement = math.sqrt(max(slope, 0.0) / max(a @ (tangent @ a), 1e-300))
        if decrement < tolerance:
            return a + change, step + 1, decrement
        t = _step_length(
            h,
            gradients @ change,
            (air_a - constant) @ change,
            (air @ change) @ change,
            slope,
            weights,
            law,
            offset,
            knots,
            coefficients,
        )
        a += t * change
    return a, limit, decrement
