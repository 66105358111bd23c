"""Mean potentials on triangles of double layers that are linear on triangles: the second matrix of the surface form.

The double layer of unit normal dipole density has the potential of the solid angle; a density that is linear on the
flat triangle adds a line integral along its edges. With h the height of x above the plane, lambda_k the barycentric
coordinate continued over the plane, m_j the outward in-plane normal of edge j, f_j as in
`fieldmap.kernels.iron.charged_triangle` and Omega the solid angle, positive on the side of the normal,

    int lambda_k(y) n . (x - y) / |x - y|^3 dS  =  lambda_k(x) Omega - h grad lambda_k . sum_j f_j m_j

(from the surface gradient of 1/R; Graglia, IEEE Trans. Antennas Propag. 41 (1993) 1448, eq. (12) has the same terms).
In the plane of the triangle it is zero, half way between the values on its two sides.
"""

import math

import numpy as np

from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.iron.charged_triangle import edge_sums, solid_angle
from fieldmap.kernels.iron.mutual_potential import inverse_distance, separation

_INVERSE_4PI = 1.0 / (4.0 * math.pi)
# Heights below this many radii lie in the plane.
_IN_PLANE = 1e-12


@njit(fastmath=True, inline="always")
def linear_double_layer(x, y, z, p, n, area):
    """Three numbers: 4 pi times the potentials at (x, y, z) of the densities lambda_0, lambda_1, lambda_2 on the
    triangle p (3, 3) with unit normal n (3,)."""
    height = (x - p[0, 0]) * n[0] + (y - p[0, 1]) * n[1] + (z - p[0, 2]) * n[2]
    sx, sy, sz = edge_sums(x, y, z, p, n)
    omega = solid_angle(x, y, z, p)
    a = _share(0, x, y, z, sx, sy, sz, p, n, area, height, omega)
    b = _share(1, x, y, z, sx, sy, sz, p, n, area, height, omega)
    return a, b, omega - a - b


@njit(fastmath=True, inline="always")
def _share(k, x, y, z, sx, sy, sz, p, n, area, height, omega):
    a, b = (k + 1) % 3, (k + 2) % 3
    ex, ey, ez = p[b, 0] - p[a, 0], p[b, 1] - p[a, 1], p[b, 2] - p[a, 2]
    gx = (n[1] * ez - n[2] * ey) / (2.0 * area)
    gy = (n[2] * ex - n[0] * ez) / (2.0 * area)
    gz = (n[0] * ey - n[1] * ex) / (2.0 * area)
    here = gx * (x - p[a, 0]) + gy * (y - p[a, 1]) + gz * (z - p[a, 2])
    return here * omega - height * (gx * sx + gy * sy + gz * sz)


@inlined(fastmath=True)
def _close(points, weights, corners, normal, area, radius, out):
    """out (3,): weighted means over points (q, 3) of `linear_double_layer`."""
    out[:] = 0.0
    for q in range(weights.size):
        x, y, z = points[q, 0], points[q, 1], points[q, 2]
        height = (
            (x - corners[0, 0]) * normal[0]
            + (y - corners[0, 1]) * normal[1]
            + (z - corners[0, 2]) * normal[2]
        )
        if abs(height) < _IN_PLANE * radius:
            continue
        a, b, c = linear_double_layer(x, y, z, corners, normal, area)
        out[0] += weights[q] * a
        out[1] += weights[q] * b
        out[2] += weights[q] * c


@inlined(fastmath=True)
def _far_row(i, far, normals, sums):
    """sums (3 n,): of n . (x - y) / |x - y|^3 over the three points x of triangle i, for the points y of all; normals
    (3, 3 n): of the points' triangles. No branches (a division that may raise is one): it becomes vector code."""
    x, y, z, nx, ny, nz = far[0], far[1], far[2], normals[0], normals[1], normals[2]
    sums[:] = 0.0
    for p in range(3 * i, 3 * i + 3):
        px, py, pz = x[p], y[p], z[p]
        for q in range(sums.size):
            dx, dy, dz = px - x[q], py - y[q], pz - z[q]
            inverse = inverse_distance(dx, dy, dz)
            sums[q] += (dx * nx[q] + dy * ny[q] + dz * nz[q]) * inverse * inverse * inverse


@njit(nogil=True, fastmath=True)
def double_layer(begin, end, faces, nodes, far, of_points, reach, out):
    """Add to rows begin to end of out (n, v), without unit: row i is the mean over triangle i of the potential of the
    double layer that is 1 at node k and linear on the triangles around it,
    1/(4 pi A_i) int_i dS int dS' lambda_k n' . (x - x') / |x - x'|^3.

    faces: as in `fieldmap.kernels.iron.mutual_potential`; nodes (n, 3): numbers of the triangles' corners; far (3, 3 n)
    as there; of_points (3, 3 n): normals of the points' triangles. The sum of a row is -1/2 for a closed surface with
    outward normals, up to the quadrature.
    """
    corners, normals, areas, _, radii, near, near_weights, touch, touch_weights = faces
    sums, here = np.empty(3 * areas.size), np.empty(3)
    for i in range(begin, end):
        _far_row(i, far, of_points, sums)
        for j in range(areas.size):
            if i == j:
                continue
            distance2, size = separation(i, j, faces, faces)
            if distance2 > (reach * size) ** 2:
                a, b, c = sums[3 * j], sums[3 * j + 1], sums[3 * j + 2]
                total = a + b + c
                # The points of the degree-2 rule have the barycentric coordinates 1/6, 1/6, 2/3.
                scale = areas[j] / 9.0
                here[0] = scale * (total / 6.0 + 0.5 * a)
                here[1] = scale * (total / 6.0 + 0.5 * b)
                here[2] = scale * (total / 6.0 + 0.5 * c)
            elif distance2 > size * size:
                _close(near[i], near_weights, corners[j], normals[j], areas[j], radii[j], here)
            else:
                _close(touch[i], touch_weights, corners[j], normals[j], areas[j], radii[j], here)
            for k in range(3):
                out[i, nodes[j, k]] += here[k] * _INVERSE_4PI
