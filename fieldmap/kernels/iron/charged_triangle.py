"""Flat triangle with uniform charge density 1: potential, field and field gradient, without the factor 1/(4 pi).

    potential  u(x) = int dS' / |x - x'|,      field  e = -grad u,      gradient  g_ij = d e_i / d x_j

Line-integral forms after Wilton et al., IEEE Trans. Antennas Propag. 32 (1984) 276, eqs. (5) and (17), and
Graglia, IEEE Trans. Antennas Propag. 41 (1993) 1448. With h the height above the plane, m_k the outward in-plane
normal of edge k, p_k the corner at its start, f_k = ln[(r_k + r_k+1 + l_k)/(r_k + r_k+1 - l_k)] and Omega the
signed solid angle,

    u = sum_k f_k m_k . (p_k - x) - h Omega,      e = sum_k f_k m_k + Omega n.

Singular on the edges (f_k and the gradient diverge); finite inside the triangle, where Omega jumps by 4 pi.
"""

import math

import numpy as np

from fieldmap.kernels.compilation import inlined, njit

_TINY = 1e-300


@inlined(fastmath=True)
def solid_angle(x, y, z, p):
    """Solid angle of the triangle p (3, 3) seen from (x, y, z); positive on the side its normal points to.

    van Oosterom and Strackee, IEEE Trans. Biomed. Eng. 30 (1983) 125, eq. (8).
    """
    ax, ay, az = p[0, 0] - x, p[0, 1] - y, p[0, 2] - z
    bx, by, bz = p[1, 0] - x, p[1, 1] - y, p[1, 2] - z
    cx, cy, cz = p[2, 0] - x, p[2, 1] - y, p[2, 2] - z
    a = math.sqrt(ax * ax + ay * ay + az * az)
    b = math.sqrt(bx * bx + by * by + bz * bz)
    c = math.sqrt(cx * cx + cy * cy + cz * cz)
    triple = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    ab = ax * bx + ay * by + az * bz
    ac = ax * cx + ay * cy + az * cz
    bc = bx * cx + by * cy + bz * cz
    return -2.0 * math.atan2(triple, a * b * c + ab * c + ac * b + bc * a)


@inlined(fastmath=True)
def edge(k, x, y, z, p, n):
    """Edge k of the triangle p (3, 3) with unit normal n (3,), seen from (x, y, z): vectors to its start and along it,
    the distances of its ends, its length, the outward in-plane normal m_k and f_k; vectors are tuples."""
    k1 = k + 1 if k < 2 else 0
    ux, uy, uz = p[k, 0] - x, p[k, 1] - y, p[k, 2] - z
    vx, vy, vz = p[k1, 0] - x, p[k1, 1] - y, p[k1, 2] - z
    tx, ty, tz = vx - ux, vy - uy, vz - uz
    length = math.sqrt(tx * tx + ty * ty + tz * tz)
    ru, rv = math.sqrt(ux * ux + uy * uy + uz * uz), math.sqrt(vx * vx + vy * vy + vz * vz)
    mx, my, mz = (
        (ty * n[2] - tz * n[1]) / length,
        (tz * n[0] - tx * n[2]) / length,
        (tx * n[1] - ty * n[0]) / length,
    )
    f = math.log((ru + rv + length) / max(ru + rv - length, 1e-16 * length))
    return (ux, uy, uz), (tx, ty, tz), ru, rv, length, (mx, my, mz), f


@inlined(fastmath=True)
def triangle_potential(x, y, z, p, n):
    """Potential at (x, y, z) of the triangle p (3, 3) with unit normal n (3,). Finite everywhere."""
    potential = 0.0
    for k in range(3):
        u, _, _, _, _, m, f = edge(k, x, y, z, p, n)
        # m . u vanishes on the edge's line, where the logarithm may diverge.
        potential += (m[0] * u[0] + m[1] * u[1] + m[2] * u[2]) * f
    height = (x - p[0, 0]) * n[0] + (y - p[0, 1]) * n[1] + (z - p[0, 2]) * n[2]
    return potential - height * solid_angle(x, y, z, p)


@inlined(fastmath=True)
def edge_sums(x, y, z, p, n):
    """Sum of f_k m_k (three numbers) over the edges of the triangle p (3, 3) with unit normal n (3,)."""
    sx = sy = sz = 0.0
    for k in range(3):
        _, _, _, _, _, m, f = edge(k, x, y, z, p, n)
        sx += f * m[0]
        sy += f * m[1]
        sz += f * m[2]
    return sx, sy, sz


@inlined(fastmath=True)
def triangle_field(x, y, z, p, n):
    """Field (three numbers) at (x, y, z) of the triangle p (3, 3) with unit normal n (3,)."""
    ex, ey, ez = edge_sums(x, y, z, p, n)
    omega = solid_angle(x, y, z, p)
    return ex + n[0] * omega, ey + n[1] * omega, ez + n[2] * omega


@inlined(fastmath=True)
def triangle_field_and_gradient(x, y, z, p, n):
    """Field and gradient at (x, y, z): ex, ey, ez, gxx, gxy, gxz, gyy, gyz, gzz (symmetric, trace-free).

    The gradient of f_k follows from two distances; the gradient of Omega is the Biot-Savart field of the triangle's
    border. Their sum is symmetric, so that only six entries are computed.
    """
    ex = ey = ez = 0.0
    gxx = gxy = gxz = gyy = gyz = gzz = 0.0
    for k in range(3):
        k1 = k + 1 if k < 2 else 0
        ux, uy, uz = x - p[k, 0], y - p[k, 1], z - p[k, 2]
        vx, vy, vz = x - p[k1, 0], y - p[k1, 1], z - p[k1, 2]
        tx, ty, tz = ux - vx, uy - vy, uz - vz
        length = math.sqrt(tx * tx + ty * ty + tz * tz)
        ru = math.sqrt(ux * ux + uy * uy + uz * uz)
        rv = math.sqrt(vx * vx + vy * vy + vz * vz)
        radii = ru + rv
        mx = (ty * n[2] - tz * n[1]) / length
        my = (tz * n[0] - tx * n[2]) / length
        mz = (tx * n[1] - ty * n[0]) / length
        # (radii - length) and (ru rv + u.v) both cancel near the edge; they are one quantity, formed once.
        uv = ru * rv + ux * vx + uy * vy + uz * vz
        f = math.log((radii + length) * (radii + length) / max(2.0 * uv, _TINY))
        ex += mx * f
        ey += my * f
        ez += mz * f
        slope = -length / max(uv, _TINY)
        fx = slope * (ux / ru + vx / rv)
        fy = slope * (uy / ru + vy / rv)
        fz = slope * (uz / ru + vz / rv)
        turn = radii / (ru * rv * max(uv, _TINY))
        ox = turn * (uy * vz - uz * vy)
        oy = turn * (uz * vx - ux * vz)
        oz = turn * (ux * vy - uy * vx)
        gxx += mx * fx - n[0] * ox
        gyy += my * fy - n[1] * oy
        gzz += mz * fz - n[2] * oz
        gxy += mx * fy - n[0] * oy
        gxz += mx * fz - n[0] * oz
        gyz += my * fz - n[1] * oz
    omega = solid_angle(x, y, z, p)
    return ex + n[0] * omega, ey + n[1] * omega, ez + n[2] * omega, gxx, gxy, gxz, gyy, gyz, gzz


@njit
def _add_fields(points, corners, normals, density, field, gradient):
    """Add to field (n, 3) and, unless it has no rows, to gradient (n, 3, 3)."""
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        for j in range(corners.shape[0]):
            s = density[j]
            if gradient.shape[0] == 0:
                ex, ey, ez = triangle_field(x, y, z, corners[j], normals[j])
            else:
                ex, ey, ez, gxx, gxy, gxz, gyy, gyz, gzz = triangle_field_and_gradient(
                    x, y, z, corners[j], normals[j]
                )
                gradient[i, 0, 0] += s * gxx
                gradient[i, 0, 1] += s * gxy
                gradient[i, 0, 2] += s * gxz
                gradient[i, 1, 1] += s * gyy
                gradient[i, 1, 2] += s * gyz
                gradient[i, 2, 2] += s * gzz
            field[i, 0] += s * ex
            field[i, 1] += s * ey
            field[i, 2] += s * ez
    for i in range(gradient.shape[0]):
        gradient[i, 1, 0] = gradient[i, 0, 1]
        gradient[i, 2, 0] = gradient[i, 0, 2]
        gradient[i, 2, 1] = gradient[i, 1, 2]


def triangles_field(points, corners, normals, density):
    """Field (n, 3) at points (n, 3) of triangles corners (m, 3, 3) with normals (m, 3) and density (m,)."""
    field = np.zeros((len(points), 3))
    _add_fields(points, corners, normals, density, field, np.zeros((0, 3, 3)))
    return field


def triangles_field_and_gradient(points, corners, normals, density):
    """Field (n, 3) and gradient (n, 3, 3) at points (n, 3); arguments as for `triangles_field`."""
    field, gradient = np.zeros((len(points), 3)), np.zeros((len(points), 3, 3))
    _add_fields(points, corners, normals, density, field, gradient)
    return field, gradient
