"""B(H) of isotropic materials as piecewise cubics: evaluated, never fitted, inside the solvers.

All laws of a device stand one after the other: law k has the knots offset[k]..offset[k + 1] - 1, and on the piece
that starts at knot j, b = c0 t^3 + c1 t^2 + c2 t + c3 with t = h - knot[j]. From the last knot on b continues with
the slope of its third coefficient. h and b are both in tesla (h = mu0 H).
"""

import numpy as np

from fieldmap.kernels.compilation import njit


@njit(inline="always")
def flux_density(h, law, offset, knots, coefficients):
    """b and db/dh at h >= 0 for one law."""
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
def flux_densities(h, law, offset, knots, coefficients):
    """b (n,) at h (n,) >= 0, each by its own law (n,)."""
    out = np.empty(h.size)
    for i in range(h.size):
        out[i], _ = flux_density(h[i], law[i], offset, knots, coefficients)
    return out
