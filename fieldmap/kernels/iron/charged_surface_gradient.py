"""How weighted sums of field and gradient at points follow the corners of the charged triangles that make them."""

import math

import numpy as np

from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.iron.charged_triangle import triangle_field_and_gradient

_INVERSE_4PI = 1.0 / (4.0 * math.pi)
# Of the differences of the closed form, as a share of the triangle's size: rounding and the step squared are 1e-9.
_STEP = 1e-5


@inlined
def _closed_form(x, y, z, p, out):
    """out (8,): ex, ey, ez, gxx, gxy, gxz, gyy, gyz at a point, of a triangle p (3, 3) with unit charge."""
    ax, ay, az = p[1, 0] - p[0, 0], p[1, 1] - p[0, 1], p[1, 2] - p[0, 2]
    bx, by, bz = p[2, 0] - p[0, 0], p[2, 1] - p[0, 1], p[2, 2] - p[0, 2]
    n = np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
    twice = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    for a in range(3):
        n[a] /= twice
    g = triangle_field_and_gradient(x, y, z, p, n)
    out[0], out[1], out[2] = g[0], g[1], g[2]
    out[3], out[4], out[5], out[6], out[7] = g[3], g[4], g[5], g[6], g[7]
    for a in range(8):
        out[a] *= 2.0 / twice


@njit
def _add_far(x, y, z, w, far, j, shapes, strength, out):
    """Add to out (3, 3) what three charges, a third of `strength` each, make of weights w (8,) at a point, by the
    corners; shapes (3, 3) of these at the charges."""
    for q in range(3):
        dx, dy, dz = x - far[3 * q, j], y - far[3 * q + 1, j], z - far[3 * q + 2, j]
        square = 1.0 / (dx * dx + dy * dy + dz * dz)
        cube = square * math.sqrt(square) * strength / 3.0
        # Half of the gradient of d . M d, with M symmetric; the field's gradient is free of trace, M need not be.
        mx = w[3] * dx + 0.5 * (w[4] * dy + w[5] * dz)
        my = 0.5 * w[4] * dx + w[6] * dy + 0.5 * w[7] * dz
        mz = 0.5 * (w[5] * dx + w[7] * dy)
        along = w[0] * dx + w[1] * dy + w[2] * dz
        twice = mx * dx + my * dy + mz * dz
        straight = (-3.0 * (along + w[3] + w[6]) + 15.0 * twice * square) * square
        gx = cube * (w[0] - 6.0 * mx * square + straight * dx)
        gy = cube * (w[1] - 6.0 * my * square + straight * dy)
        gz = cube * (w[2] - 6.0 * mz * square + straight * dz)
        for c in range(3):
            out[c, 0] -= shapes[q, c] * gx
            out[c, 1] -= shapes[q, c] * gy
            out[c, 2] -= shapes[q, c] * gz


@njit(nogil=True)
def surface_gradient(begin, end, points, corners, far, shapes, charge, moving, weights, out):
    """Add to out (m, k, 3, 3) the derivatives by the corners (m, 3, 3) of the triangles that are moving (m,), of k sums
    over points (n, 3) with weights (k, n, 8), as in `fieldmap.kernels.iron.charged_surface_weights`, for charges (m,).

    far (14, m): as there; shapes (3, 3): of the corners at its three points. Where the closed form is used, its central
    differences.
    """
    count, rows = points.shape[0], weights.shape[0]
    ahead, behind, moved = np.empty(8), np.empty(8), np.empty((3, 3))
    for j in range(begin, end):
        if not moving[j]:
            continue
        step = _STEP * math.sqrt(far[9, j])
        for i in range(count):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            dx, dy, dz = x - far[10, j], y - far[11, j], z - far[12, j]
            if dx * dx + dy * dy + dz * dz >= far[13, j]:
                for k in range(rows):
                    _add_far(x, y, z, weights[k, i], far, j, shapes, _INVERSE_4PI * charge[j], out[j, k])
                continue
            for c in range(3):
                for a in range(3):
                    moved[c, a] = corners[j, c, a]
            for c in range(3):
                for a in range(3):
                    moved[c, a] = corners[j, c, a] + step
                    _closed_form(x, y, z, moved, ahead)
                    moved[c, a] = corners[j, c, a] - step
                    _closed_form(x, y, z, moved, behind)
                    moved[c, a] = corners[j, c, a]
                    for k in range(rows):
                        total = 0.0
                        for b in range(8):
                            total += weights[k, i, b] * (ahead[b] - behind[b])
                        out[j, k, c, a] += _INVERSE_4PI * charge[j] * total / (2.0 * step)
