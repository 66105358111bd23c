"""B(H) of isotropic materials as piecewise cubics: evaluated, never fitted, inside the solvers.

All laws of a device stand one after the other in tables (offset, knots, coefficients): law k has the knots
offset[k]..offset[k + 1] - 1, and on the piece that starts at knot j, b = c0 t^3 + c1 t^2 + c2 t + c3 with
t = h - knot[j]. From the last knot on b continues with the slope of its third coefficient. h and b are both in tesla
(h = mu0 H).
"""

import math

import numpy as np

from fieldmap.kernels.compilation import njit


@njit(inline="always")
def flux_density(h, law, tables):
    """b and db/dh at h >= 0 for one law."""
    offset, knots, coefficients = tables
    low, high = offset[law], offset[law + 1] - 1
    if h >= knots[high]:
        slope = coefficients[high, 2]
        return coefficients[high, 3] + slope * (h - knots[high]), slope
    while high - low > 1:
        middle = (low + high) // 2
        if knots[middle] <= h:
            low = middle
        else:
            high = middle
    t = h - knots[low]
    c0, c1, c2, c3 = coefficients[low, 0], coefficients[low, 1], coefficients[low, 2], coefficients[low, 3]
    return ((c0 * t + c1) * t + c2) * t + c3, (3.0 * c0 * t + 2.0 * c1) * t + c2


@njit
def flux_densities(h, law, tables):
    """b and db/dh (n,) at h (n,) >= 0, each by its own law (n,)."""
    b, slope = np.empty(h.size), np.empty(h.size)
    for i in range(h.size):
        b[i], slope[i] = flux_density(h[i], law[i], tables)
    return b, slope


@njit(nogil=True)
def magnetise(begin, end, h, weights, law, tables):
    """h (3 p, s), mu0 H of s states at p points, becomes w (b/h - 1) h: mu0 M times the weights (p,) of the points.

    law (p,): of each point. 1e-14 T is added to |h|, so that nothing is divided by zero.
    """
    for p in range(begin, end):
        for k in range(h.shape[1]):
            x, y, z = h[3 * p, k], h[3 * p + 1, k], h[3 * p + 2, k]
            size = math.sqrt(x * x + y * y + z * z) + 1e-14
            b, _ = flux_density(size, law[p], tables)
            m = weights[p] * (b / size - 1.0)
            h[3 * p, k], h[3 * p + 1, k], h[3 * p + 2, k] = m * x, m * y, m * z


@njit(nogil=True)
def susceptibility(begin, end, h, law, tables, out):
    """Fill out (p, 6) with db/dh - 1 at mu0 H = h (p, 3): xx, xy, xz, yy, yz, zz; law (p,).

    db/dh = (b/h) 1 + (b' - b/h) h h^T / h^2: symmetric and positive definite where b' > 0.
    """
    for p in range(begin, end):
        x, y, z = h[p, 0], h[p, 1], h[p, 2]
        size = math.sqrt(x * x + y * y + z * z) + 1e-14
        b, slope = flux_density(size, law[p], tables)
        across = b / size - 1.0
        along = (slope - 1.0 - across) / (size * size)
        out[p, 0], out[p, 1], out[p, 2] = across + along * x * x, along * x * y, along * x * z
        out[p, 3], out[p, 4], out[p, 5] = across + along * y * y, along * y * z, across + along * z * z


@njit(nogil=True)
def root_of_susceptibility(h, weights, law, tables, rows):
    """Multiply rows (p, 3, r) of each point by the square root of w (db/dh - 1), a symmetric matrix (3, 3) with h
    (3 p,) as one axis."""
    for p in range(weights.size):
        x, y, z = h[3 * p], h[3 * p + 1], h[3 * p + 2]
        size = math.sqrt(x * x + y * y + z * z) + 1e-14
        b, slope = flux_density(size, law[p], tables)
        across = math.sqrt(weights[p] * max(b / size - 1.0, 0.0))
        along = math.sqrt(weights[p] * max(slope - 1.0, 0.0)) - across
        x, y, z = x / size, y / size, z / size
        for j in range(rows.shape[2]):
            part = along * (x * rows[p, 0, j] + y * rows[p, 1, j] + z * rows[p, 2, j])
            rows[p, 0, j] = across * rows[p, 0, j] + x * part
            rows[p, 1, j] = across * rows[p, 1, j] + y * part
            rows[p, 2, j] = across * rows[p, 2, j] + z * part
