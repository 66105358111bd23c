"""Find the tetrahedron that contains a point."""

import numpy as np
from numba import njit, prange


@njit(cache=True)
def _volume_six(a, b, c, x, y, z):
    """Six times the signed volume of the tetrahedron a, b, c, (x, y, z)."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    wx, wy, wz = x - a[0], y - a[1], z - a[2]
    return (uy * vz - uz * vy) * wx + (uz * vx - ux * vz) * wy + (ux * vy - uy * vx) * wz


@njit(cache=True)
def _contains(p, x, y, z):
    """Whether the positively oriented tetrahedron p (4, 3) contains (x, y, z)."""
    return (
        _volume_six(p[0], p[1], p[2], x, y, z) >= 0.0
        and _volume_six(p[0], p[3], p[1], x, y, z) >= 0.0
        and _volume_six(p[1], p[3], p[2], x, y, z) >= 0.0
        and _volume_six(p[0], p[2], p[3], x, y, z) >= 0.0
    )


@njit(cache=True, parallel=True)
def find_tetrahedron(points, corners, lower, upper):
    """Index (n,) of the first tetrahedron corners (m, 4, 3) that contains each point (n, 3), or -1.

    lower, upper (m, 3): bounding boxes.
    """
    out = np.full(points.shape[0], -1, np.int64)
    for i in prange(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        for e in range(corners.shape[0]):
            if (
                lower[e, 2] <= z <= upper[e, 2]
                and lower[e, 0] <= x <= upper[e, 0]
                and lower[e, 1] <= y <= upper[e, 1]
                and _contains(corners[e], x, y, z)
            ):
                out[i] = e
                break
    return out
