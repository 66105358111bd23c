"""Find the tetrahedron, or the closed surface, that contains a point; move points off a surface."""

import math

from fieldmap.kernels.compilation import njit
from fieldmap.kernels.iron.charged_triangle import solid_angle


@njit
def _volume_six(a, b, c, x, y, z):
    """Six times the signed volume of the tetrahedron a, b, c, (x, y, z)."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    wx, wy, wz = x - a[0], y - a[1], z - a[2]
    return (uy * vz - uz * vy) * wx + (uz * vx - ux * vz) * wy + (ux * vy - uy * vx) * wz


@njit
def _contains(p, x, y, z):
    """Whether the positively oriented tetrahedron p (4, 3) contains (x, y, z)."""
    return (
        _volume_six(p[0], p[1], p[2], x, y, z) >= 0.0
        and _volume_six(p[0], p[3], p[1], x, y, z) >= 0.0
        and _volume_six(p[1], p[3], p[2], x, y, z) >= 0.0
        and _volume_six(p[0], p[2], p[3], x, y, z) >= 0.0
    )


@njit(nogil=True)
def find_tetrahedron(begin, end, points, corners, lower, upper, out):
    """Fill out (n,) with the index of the first tetrahedron corners (m, 4, 3) that contains each point (n, 3); entries
    of other points are not changed.

    lower, upper (m, 3): bounding boxes.
    """
    for i in range(begin, end):
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


# A triangle further away than this many radii is one dipole: good to a few percent; the test needs 50 %.
_FAR_RADII = 3.0


@njit(nogil=True, fastmath=True)
def solid_angle_sums(begin, end, points, corners, normals, areas, centres, radii, out):
    """Fill out (n,) with the solid angle over 4 pi of triangles corners (m, 3, 3) seen from points (n, 3): of a closed
    surface with outward normals close to -1 inside, to 0 outside, to two digits."""
    for i in range(begin, end):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        total = 0.0
        for j in range(corners.shape[0]):
            dx, dy, dz = x - centres[j, 0], y - centres[j, 1], z - centres[j, 2]
            distance2 = dx * dx + dy * dy + dz * dz
            if distance2 > (_FAR_RADII * radii[j]) ** 2:
                height = dx * normals[j, 0] + dy * normals[j, 1] + dz * normals[j, 2]
                total += areas[j] * height / (distance2 * math.sqrt(distance2))
            else:
                total += solid_angle(x, y, z, corners[j])
        out[i] = total / (4.0 * math.pi)


@njit
def _on_triangle(p, n, radius, slack, x, y, z):
    """Whether (x, y, z), in the plane of the triangle p (3, 3) with normal n (3,), lies in it or on its border."""
    for k in range(3):
        a, b = p[k], p[k + 1 if k < 2 else 0]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = x - a[0], y - a[1], z - a[2]
        turn = (uy * vz - uz * vy) * n[0] + (uz * vx - ux * vz) * n[1] + (ux * vy - uy * vx) * n[2]
        if turn < -slack * radius * math.sqrt(ux * ux + uy * uy + uz * uz):
            return False
    return True


@njit(nogil=True)
def off_surface(begin, end, points, corners, normals, centres, radii, slack, step, out):
    """Fill out (n, 3) with points (n, 3); points on triangles corners (m, 3, 3) move along the sum of their normals.

    slack: largest distance of a point on a triangle; step: length of the move; both in the triangle's radii.
    """
    for i in range(begin, end):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        sx = sy = sz = size = 0.0
        for j in range(corners.shape[0]):
            dx, dy, dz = x - centres[j, 0], y - centres[j, 1], z - centres[j, 2]
            reach = slack * radii[j]
            if abs(dx * normals[j, 0] + dy * normals[j, 1] + dz * normals[j, 2]) > reach:
                continue
            near = dx * dx + dy * dy + dz * dz <= (radii[j] + reach) ** 2
            if near and _on_triangle(corners[j], normals[j], radii[j], slack, x, y, z):
                sx, sy, sz = sx + normals[j, 0], sy + normals[j, 1], sz + normals[j, 2]
                size = max(size, radii[j])
        length = math.sqrt(sx * sx + sy * sy + sz * sz)
        far = step * size / length if length > 0.0 else 0.0
        out[i, 0], out[i, 1], out[i, 2] = x + far * sx, y + far * sy, z + far * sz
