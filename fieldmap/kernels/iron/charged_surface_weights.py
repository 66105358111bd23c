"""What every charged triangle counts in weighted sums of field and gradient at points: the transpose of
`fieldmap.kernels.iron.charged_surface`, with the same three point charges far off and closed form near by."""

import math

import numpy as np

from fieldmap.kernels.compilation import njit
from fieldmap.kernels.iron.charged_triangle import triangle_field_and_gradient

_INVERSE_4PI = 1.0 / (4.0 * math.pi)


@njit(fastmath=True, inline="always")
def _far(x, y, z, far, j, out):
    """out (8,): ex, ey, ez, gxx, gxy, gxz, gyy, gyz at a point, of triangle j as three charges."""
    out[:] = 0.0
    third = far[9, j]
    for q in range(3):
        dx, dy, dz = x - far[3 * q, j], y - far[3 * q + 1, j], z - far[3 * q + 2, j]
        square = 1.0 / (dx * dx + dy * dy + dz * dz)
        strength = third * square * math.sqrt(square)
        slope = 3.0 * strength * square
        out[0] += strength * dx
        out[1] += strength * dy
        out[2] += strength * dz
        out[3] += strength - slope * dx * dx
        out[4] -= slope * dx * dy
        out[5] -= slope * dx * dz
        out[6] += strength - slope * dy * dy
        out[7] -= slope * dy * dz


@njit(nogil=True)
def surface_weights(begin, end, points, corners, normals, far, weights, out):
    """Add to out (k, m) the share of a unit density on every triangle in k sums over points (n, 3): sum of weights
    (k, n, 8) times Bx, By, Bz, dBx/dx, dBx/dy, dBx/dz, dBy/dy, dBy/dz. The other arguments as for
    `fieldmap.kernels.iron.charged_surface.surface_field`."""
    count, rows = points.shape[0], weights.shape[0]
    one = np.empty(8)
    for j in range(begin, end):
        for i in range(count):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            dx, dy, dz = x - far[10, j], y - far[11, j], z - far[12, j]
            if dx * dx + dy * dy + dz * dz < far[13, j]:
                g = triangle_field_and_gradient(x, y, z, corners[j], normals[j])
                one[0], one[1], one[2] = g[0], g[1], g[2]
                one[3], one[4], one[5], one[6], one[7] = g[3], g[4], g[5], g[6], g[7]
            else:
                _far(x, y, z, far, j, one)
            for k in range(rows):
                total = 0.0
                for a in range(8):
                    total += weights[k, i, a] * one[a]
                out[k, j] += _INVERSE_4PI * total
