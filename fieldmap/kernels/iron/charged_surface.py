"""Field and gradient of many charged triangles at many points: closed form near by, three point charges far off."""

import math

import numpy as np
from numba import njit, prange

from fieldmap.kernels.iron.charged_triangle import triangle_field, triangle_field_and_gradient

_INVERSE_4PI = 1.0 / (4.0 * math.pi)


@njit(cache=True, fastmath=True, inline="always")
def _is_near(x, y, z, centre, limit2):
    dx, dy, dz = x - centre[0], y - centre[1], z - centre[2]
    return dx * dx + dy * dy + dz * dz < limit2


@njit(cache=True, parallel=True, fastmath=True)
def surface_field(points, corners, normals, centres, limits2, charges, density):
    """Field (c, n, 3) at points (n, 3) of triangles corners (m, 3, 3), normals (m, 3), for c densities (c, m).

    centres (m, 3); limits2 (m,): squared distance within which the closed form is used; charges (m, 3, 3): points of
    the degree-2 rule. The factor 1/(4 pi) is included, so a density in tesla gives a flux density in tesla.
    """
    n, m, c = points.shape[0], corners.shape[0], density.shape[0]
    out = np.zeros((c, n, 3))
    third = _area_thirds(corners)
    for i in prange(n):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        for j in range(m):
            if _is_near(x, y, z, centres[j], limits2[j]):
                ex, ey, ez = triangle_field(x, y, z, corners[j], normals[j])
            else:
                ex = ey = ez = 0.0
                for q in range(3):
                    dx, dy, dz = x - charges[j, q, 0], y - charges[j, q, 1], z - charges[j, q, 2]
                    r2 = dx * dx + dy * dy + dz * dz
                    g = third[j] / (r2 * math.sqrt(r2))
                    ex += g * dx
                    ey += g * dy
                    ez += g * dz
            for k in range(c):
                s = density[k, j] * _INVERSE_4PI
                out[k, i, 0] += s * ex
                out[k, i, 1] += s * ey
                out[k, i, 2] += s * ez
    return out


@njit(cache=True, fastmath=True)
def _area_thirds(corners):
    """A third of each triangle's area (m,)."""
    out = np.empty(corners.shape[0])
    for j in range(corners.shape[0]):
        a, b, c = corners[j, 0], corners[j, 1], corners[j, 2]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        out[j] = math.sqrt(nx * nx + ny * ny + nz * nz) / 6.0
    return out


@njit(cache=True, fastmath=True, inline="always")
def _three_charges(x, y, z, charges, third):
    """Field and five independent gradient entries of three equal point charges."""
    ex = ey = ez = gxx = gxy = gxz = gyy = gyz = gzz = 0.0
    for q in range(3):
        dx, dy, dz = x - charges[q, 0], y - charges[q, 1], z - charges[q, 2]
        inverse2 = 1.0 / (dx * dx + dy * dy + dz * dz)
        g = third * inverse2 * math.sqrt(inverse2)
        h = 3.0 * g * inverse2
        ex += g * dx
        ey += g * dy
        ez += g * dz
        gxx += g - h * dx * dx
        gyy += g - h * dy * dy
        gzz += g - h * dz * dz
        gxy -= h * dx * dy
        gxz -= h * dx * dz
        gyz -= h * dy * dz
    return ex, ey, ez, gxx, gxy, gxz, gyy, gyz, gzz


@njit(cache=True, parallel=True, fastmath=True)
def surface_field_and_gradient(points, corners, normals, centres, limits2, charges, density):
    """Field (c, n, 3) and gradient (c, n, 3, 3), exactly symmetric; arguments as for `surface_field`."""
    n, m, c = points.shape[0], corners.shape[0], density.shape[0]
    field = np.zeros((c, n, 3))
    gradient = np.zeros((c, n, 3, 3))
    third = _area_thirds(corners)
    for i in prange(n):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        for j in range(m):
            if _is_near(x, y, z, centres[j], limits2[j]):
                value = triangle_field_and_gradient(x, y, z, corners[j], normals[j])
            else:
                value = _three_charges(x, y, z, charges[j], third[j])
            ex, ey, ez, gxx, gxy, gxz, gyy, gyz, gzz = value
            for k in range(c):
                s = density[k, j] * _INVERSE_4PI
                field[k, i, 0] += s * ex
                field[k, i, 1] += s * ey
                field[k, i, 2] += s * ez
                gradient[k, i, 0, 0] += s * gxx
                gradient[k, i, 0, 1] += s * gxy
                gradient[k, i, 0, 2] += s * gxz
                gradient[k, i, 1, 1] += s * gyy
                gradient[k, i, 1, 2] += s * gyz
                gradient[k, i, 2, 2] += s * gzz
        for k in range(c):
            gradient[k, i, 1, 0] = gradient[k, i, 0, 1]
            gradient[k, i, 2, 0] = gradient[k, i, 0, 2]
            gradient[k, i, 2, 1] = gradient[k, i, 1, 2]
    return field, gradient
