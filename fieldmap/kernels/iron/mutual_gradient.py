"""Derivatives of sums a . W b over mean potentials of charged triangles by the corners.

Pairs follow the rules of `fieldmap.kernels.iron.mutual_potential`. For a far pair, nine inverse distances are
differentiated. For a close pair let x be a point of the outer rule, u the potential of the inner triangle there, f_k,
m_k, h and Omega as in `fieldmap.kernels.iron.charged_triangle`, and N_k the function that is 1 at corner k and 0 at the
others. A corner's movement within the plane changes u by the area that its two edges sweep over, a movement along the
normal n by a double layer,

    du/dp_k = sum_e m_e int_e N_k / R dl + n (N_k(x) Omega - h grad N_k . sum_e f_e m_e),      du/dx = -e.
"""

import math

import numpy as np

from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.iron.charged_triangle import edge, solid_angle
from fieldmap.kernels.iron.mutual_potential import inverse_distance, row_beyond, separation

_INVERSE_4PI = 1.0 / (4.0 * math.pi)


@inlined(fastmath=True)
def corner_gradient(x, y, z, p, n, area, field, by_corner):
    """Potential at (x, y, z) of the triangle p (3, 3) with unit normal n (3,) and an area; fills its field (3,) there
    and the potential's derivative by the corners (3, 3)."""
    tx_sum = ty_sum = tz_sum = 0.0
    potential = 0.0
    by_corner[:] = 0.0
    for k in range(3):
        k1 = k + 1 if k < 2 else 0
        u, t, ru, rv, length, m, f = edge(k, x, y, z, p, n)
        potential += (m[0] * u[0] + m[1] * u[1] + m[2] * u[2]) * f
        tx_sum += m[0] * f
        ty_sum += m[1] * f
        tz_sum += m[2] * f
        end = ((rv - ru) - (u[0] * t[0] + u[1] * t[1] + u[2] * t[2]) / length * f) / length
        for a in range(3):
            by_corner[k, a] += m[a] * (f - end)
            by_corner[k1, a] += m[a] * end
    omega = solid_angle(x, y, z, p)
    height = (x - p[0, 0]) * n[0] + (y - p[0, 1]) * n[1] + (z - p[0, 2]) * n[2]
    for k in range(3):
        k1 = k + 1 if k < 2 else 0
        k2 = k1 + 1 if k1 < 2 else 0
        tx, ty, tz = p[k2, 0] - p[k1, 0], p[k2, 1] - p[k1, 1], p[k2, 2] - p[k1, 2]
        gx = 0.5 * (n[1] * tz - n[2] * ty) / area
        gy = 0.5 * (n[2] * tx - n[0] * tz) / area
        gz = 0.5 * (n[0] * ty - n[1] * tx) / area
        shape = 1.0 + gx * (x - p[k, 0]) + gy * (y - p[k, 1]) + gz * (z - p[k, 2])
        normal = shape * omega - height * (gx * tx_sum + gy * ty_sum + gz * tz_sum)
        by_corner[k, 0] += normal * n[0]
        by_corner[k, 1] += normal * n[1]
        by_corner[k, 2] += normal * n[2]
    field[0] = tx_sum + n[0] * omega
    field[1] = ty_sum + n[1] * omega
    field[2] = tz_sum + n[2] * omega
    return potential - height * omega


@inlined(fastmath=True)
def _add_mean(share, points, weights, shapes, inner, by_outer, by_inner, field, by_corner):
    """Add `share` times the derivatives, by the corners (3, 3) of an outer and an inner triangle, of the mean over
    points (q, 3) of the outer one of the inner one's potential at unit charge. shapes (q, 3): barycentric coordinates
    of the points; inner: corners, normal and area."""
    p, n, area = inner
    total = 0.0
    for q in range(weights.size):
        w = share * weights[q] / area
        total += w * corner_gradient(points[q, 0], points[q, 1], points[q, 2], p, n, area, field, by_corner)
        for k in range(3):
            for a in range(3):
                by_inner[k, a] += w * by_corner[k, a]
                by_outer[k, a] -= w * shapes[q, k] * field[a]
    for k in range(3):
        k1 = k + 1 if k < 2 else 0
        k2 = k1 + 1 if k1 < 2 else 0
        tx, ty, tz = p[k2, 0] - p[k1, 0], p[k2, 1] - p[k1, 1], p[k2, 2] - p[k1, 2]
        half = 0.5 * total / area
        by_inner[k, 0] -= half * (n[1] * tz - n[2] * ty)
        by_inner[k, 1] -= half * (n[2] * tx - n[0] * tz)
        by_inner[k, 2] -= half * (n[0] * ty - n[1] * tx)


@inlined(fastmath=True)
def _close_pair(i, j, apart, faces, shapes, by_one, by_other, field, by_corner):
    """Derivative of `fieldmap.kernels.iron.mutual_potential.close_pair` by the corners (3, 3) of both triangles."""
    corners, normals, areas, _, _, near, near_weights, touch, touch_weights = faces
    near_shapes, touch_shapes = shapes
    one, other = (corners[i], normals[i], areas[i]), (corners[j], normals[j], areas[j])
    by_one[:] = 0.0
    by_other[:] = 0.0
    if not apart:
        _add_mean(0.5, touch[i], touch_weights, touch_shapes, other, by_one, by_other, field, by_corner)
        _add_mean(0.5, touch[j], touch_weights, touch_shapes, one, by_other, by_one, field, by_corner)
    elif areas[i] < areas[j]:
        _add_mean(1.0, near[i], near_weights, near_shapes, other, by_one, by_other, field, by_corner)
    else:
        _add_mean(1.0, near[j], near_weights, near_shapes, one, by_other, by_one, field, by_corner)


@inlined(fastmath=True)
def _add_turned(share, matrix, by_corner, corners, places, out):
    """Add to out (p, k, 3) shares (k,) of a derivative by corners (3, 3), turned by a matrix, at their places."""
    for c in range(3):
        x, y, z = by_corner[c, 0], by_corner[c, 1], by_corner[c, 2]
        at = places[corners[c]]
        for a in range(3):
            turned = matrix[a, 0] * x + matrix[a, 1] * y + matrix[a, 2] * z
            for k in range(share.size):
                out[at, k, a] += share[k] * turned


@njit(nogil=True, fastmath=True)
def close_gradient(
    begin, end, faces, shapes, spheres, reach, nodes, first, moving, charge, others, places, matrices, parts
):
    """Add to parts (t, p, k, 3), t from begin to end, the derivatives of others (k, n) . W charge (n,) by p nodes, for
    close pairs with a moving (n,) triangle. The result is the sum over t.

    faces, spheres (4, n) and reach: as in `mutual_potential`; shapes: barycentric coordinates of the points of the
    outer rules, (q, 3) for pairs apart and (t, 3) for pairs whose circles overlap; nodes (n, 3): numbers of the
    corners. Only pairs with a triangle in one chamber are computed; g operations with matrices (g, 3, 3) give the
    others. first (n,): the image of each triangle that lies in the chamber; places (g, p): images of the nodes; charge
    (g, n) and others (g, k, n): of each triangle's images.
    """
    n, shares, rows = nodes.shape[0], parts.shape[0], others.shape[1]
    by_one, by_other = np.empty((3, 3)), np.empty((3, 3))
    field, by_corner = np.empty(3), np.empty((3, 3))
    beyond, share = np.empty(n), np.empty(rows)
    for t in range(begin, end):
        for i in range(t, n, shares):
            if first[i] != i:
                continue
            row_beyond(i, spheres, spheres, reach, beyond)
            for j in range(n):
                # Pairs of two orbits are computed for the later orbit; pairs within one are met twice, at half weight.
                if beyond[j] > 0.0 or first[j] > i or not (moving[i] or moving[j]):
                    continue
                distance2, size = separation(i, j, faces, faces)
                apart = distance2 > size * size
                _close_pair(i, j, apart, faces, shapes, by_one, by_other, field, by_corner)
                weight = _INVERSE_4PI if first[j] < i else 0.5 * _INVERSE_4PI
                for a in range(matrices.shape[0]):
                    for k in range(rows):
                        share[k] = weight * (others[a, k, i] * charge[a, j] + others[a, k, j] * charge[a, i])
                    _add_turned(share, matrices[a], by_one, nodes[i], places[a], parts[t])
                    _add_turned(share, matrices[a], by_other, nodes[j], places[a], parts[t])


@inlined(fastmath=True)
def _pulls(px, py, pz, x, y, z, beyond, gx, gy, gz):
    """Sums (n,) of (q - p)/|q - p|^3 over the points q of each triangle, x, y, z (3, n), for one point p; 0 where
    beyond (n,) <= 0. No branches: the compiler turns it into vector code."""
    for j in range(gx.size):
        sx = sy = sz = 0.0
        for q in range(3):
            dx, dy, dz = x[q, j] - px, y[q, j] - py, z[q, j] - pz
            inverse = inverse_distance(dx, dy, dz)
            cube = inverse * inverse * inverse
            sx += cube * dx
            sy += cube * dy
            sz += cube * dz
        far = 1.0 if beyond[j] > 0.0 else 0.0
        gx[j], gy[j], gz[j] = far * sx, far * sy, far * sz


@njit(nogil=True, fastmath=True)
def far_pulls(begin, end, chosen, far, spheres, reach, out):
    """Fill out (c, 3, 3, n) with the sums of (q - p)/|q - p|^3 over the three points q of each of n triangles, for the
    three points p of c chosen ones, and x, y and z; 0 for close pairs. far (3, 3, n): x, y and z of the points;
    spheres (4, n): centres and radii."""
    n = spheres.shape[1]
    beyond = np.empty(n)
    for r in range(begin, end):
        i = chosen[r]
        row_beyond(i, spheres, spheres, reach, beyond)
        for p in range(3):
            at = out[r, p]
            x, y, z = far[0, p, i], far[1, p, i], far[2, p, i]
            _pulls(x, y, z, far[0], far[1], far[2], beyond, at[0], at[1], at[2])
