"""Field and gradient of many charged triangles at many points: closed form near by, three point charges far off.

Two more kernels give the derivatives of weighted sums of these fields over the points: by the charge of each triangle
(the transpose), and by its corners.

Triangles are processed in blocks. A row holds one component per unit density, with an entry for each triangle of the
block. Each loop fills one row. It runs over contiguous arrays and has no branches (a division that may raise is a
branch), so that the compiler turns it into vector code. If a loop filled two rows, the compiler could not tell that
they do not overlap.
"""

import math
from typing import Any

import numpy as np

from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.iron.charged_triangle import triangle_field, triangle_field_and_gradient
from fieldmap.kernels.iron.mutual_potential import inverse_distance

_INVERSE_4PI = 1.0 / (4.0 * math.pi)
# Triangles of a block: its rows stay in the processor's first two caches.
_BLOCK = 512
# Step of the differences of the closed form, as a share of the triangle's size: rounding and the squared step make an
# error of 1e-9.
_STEP = 1e-5
# No reference counts: threads would contend for them.
_PLAIN: dict[str, Any] = {"_nrt": False}
_FAST: dict[str, Any] = {**_PLAIN, "fastmath": True}


@inlined(**_FAST)
def _inverse_distances(x, y, z, px, py, pz, out):
    """1/|x - p| in single precision, which costs a fraction, and one step of Newton's method."""
    for j in range(out.size):
        # At a charge itself the triangle is near: the value is not used.
        out[j] = inverse_distance(x - px[j], y - py[j], z - pz[j])


@inlined(**_FAST)
def _strengths(inverse, third, out):
    for j in range(out.size):
        out[j] = third[j] * inverse[j] * inverse[j] * inverse[j]


@inlined(**_FAST)
def _slopes(inverse, strength, out):
    for j in range(out.size):
        out[j] = 3.0 * strength[j] * inverse[j] * inverse[j]


@inlined(**_FAST)
def _add_field(x, px, strength, out):
    for j in range(out.size):
        out[j] += strength[j] * (x - px[j])


@inlined(**_FAST)
def _add_own_slope(x, px, strength, slope, out):
    for j in range(out.size):
        out[j] += strength[j] - slope[j] * (x - px[j]) * (x - px[j])


@inlined(**_FAST)
def _add_other_slope(x, y, px, py, slope, out):
    for j in range(out.size):
        out[j] -= slope[j] * (x - px[j]) * (y - py[j])


@inlined(**_FAST)
def _squares_beyond(x, y, z, cx, cy, cz, limit, out):
    """Squared distances of the centres minus their limits."""
    for j in range(out.size):
        dx, dy, dz = x - cx[j], y - cy[j], z - cz[j]
        out[j] = dx * dx + dy * dy + dz * dz - limit[j]


@inlined(**_PLAIN)
def _zero(out):
    for j in range(out.size):
        out[j] = 0.0


@inlined(**_PLAIN)
def _fill_rows(x, y, z, far, first, last, gradient, work, rows):
    """rows: ex, ey, ez, gxx, gxy, gxz, gyy, gyz, each (b,), of the triangles `first` to `last` as point charges;
    without the gradient only the first three are filled. far (14, m); work: three scratch arrays (b,)."""
    size = last - first
    inverse, strength, slope = work[0][:size], work[1][:size], work[2][:size]
    third = far[9][first:last]
    ex, ey, ez = rows[0][:size], rows[1][:size], rows[2][:size]
    xx, xy, xz, yy, yz = rows[3][:size], rows[4][:size], rows[5][:size], rows[6][:size], rows[7][:size]
    _zero(ex)
    _zero(ey)
    _zero(ez)
    if gradient:
        _zero(xx)
        _zero(xy)
        _zero(xz)
        _zero(yy)
        _zero(yz)
    for q in range(3):
        # Rows are cut one by one: they are then known to be contiguous.
        px, py, pz = far[3 * q][first:last], far[3 * q + 1][first:last], far[3 * q + 2][first:last]
        _inverse_distances(x, y, z, px, py, pz, inverse)
        _strengths(inverse, third, strength)
        _add_field(x, px, strength, ex)
        _add_field(y, py, strength, ey)
        _add_field(z, pz, strength, ez)
        if gradient:
            _slopes(inverse, strength, slope)
            _add_own_slope(x, px, strength, slope, xx)
            _add_other_slope(x, y, px, py, slope, xy)
            _add_other_slope(x, z, px, pz, slope, xz)
            _add_own_slope(y, py, strength, slope, yy)
            _add_other_slope(y, z, py, pz, slope, yz)


@inlined(**_FAST)
def _add_field_sums(rows, size, density, sums):
    ex, ey, ez = rows[0], rows[1], rows[2]
    a = b = c = 0.0
    for j in range(size):
        s = density[j]
        a += s * ex[j]
        b += s * ey[j]
        c += s * ez[j]
    sums[0] += a
    sums[1] += b
    sums[2] += c


@inlined(**_FAST)
def _add_gradient_sums(rows, size, density, sums):
    gxx, gxy, gxz, gyy, gyz = rows[3], rows[4], rows[5], rows[6], rows[7]
    a = b = c = d = e = 0.0
    for j in range(size):
        s = density[j]
        a += s * gxx[j]
        b += s * gxy[j]
        c += s * gxz[j]
        d += s * gyy[j]
        e += s * gyz[j]
    sums[3] += a
    sums[4] += b
    sums[5] += c
    sums[6] += d
    sums[7] += e


@inlined(**_PLAIN)
def _replace(x, y, z, corners, normal, gradient, rows, j):
    """Entry j of the rows by the closed form of one triangle."""
    if not gradient:
        rows[0][j], rows[1][j], rows[2][j] = triangle_field(x, y, z, corners, normal)
        return
    g = triangle_field_and_gradient(x, y, z, corners, normal)
    rows[0][j], rows[1][j], rows[2][j] = g[0], g[1], g[2]
    rows[3][j], rows[4][j], rows[5][j], rows[6][j], rows[7][j] = g[3], g[4], g[5], g[6], g[7]


@njit
def _rows():
    """Eight rows of a block and three for scratch: arrays of their own, which do not overlap."""
    a, b, c, d = np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK)
    e, f, g, h = np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK)
    return (a, b, c, d, e, f, g, h), (np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK))


@inlined(**_PLAIN)
def _add_sums(x, y, z, corners, normals, far, density, gradient, work, rows, sums):
    """Add to sums (c, 8) the components of `_fill_rows` of all triangles times the densities (c, m), near by in closed
    form. work, rows: scratch."""
    m = normals.shape[0]
    for first in range(0, m, _BLOCK):
        last = min(first + _BLOCK, m)
        _fill_rows(x, y, z, far, first, last, gradient, work, rows)
        beyond = work[0][: last - first]
        cx, cy, cz = far[10][first:last], far[11][first:last], far[12][first:last]
        _squares_beyond(x, y, z, cx, cy, cz, far[13][first:last], beyond)
        for j in range(last - first):
            if beyond[j] < 0.0:
                _replace(x, y, z, corners[first + j], normals[first + j], gradient, rows, j)
        for k in range(sums.shape[0]):
            of_block = density[k][first:last]
            _add_field_sums(rows, last - first, of_block, sums[k])
            if gradient:
                _add_gradient_sums(rows, last - first, of_block, sums[k])


@njit(nogil=True)
def surface_field(begin, end, points, corners, normals, far, density, field, gradient):
    """Fill field (c, n, 3) and, unless it is (c, 0, 3, 3), gradient (c, n, 3, 3), symmetric and free of trace, at
    points (n, 3), of triangles corners (m, 3, 3), normals (m, 3), for c densities (c, m).

    far (14, m): x, y and z of the three points of the degree-2 rule, a third of the area, the centre, and the squared
    distance from it within which the closed form is used. The factor 1/(4 pi) is included, so a density in tesla gives
    a flux density in tesla.
    """
    c, both = density.shape[0], gradient.shape[1] > 0
    rows, work = _rows()
    for i in range(begin, end):
        sums = np.zeros((c, 8))
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        _add_sums(x, y, z, corners, normals, far, density, both, work, rows, sums)
        for k in range(c):
            s = sums[k]
            for a in range(8):
                s[a] *= _INVERSE_4PI
            field[k, i, 0], field[k, i, 1], field[k, i, 2] = s[0], s[1], s[2]
            if both:
                gradient[k, i, 0, 0], gradient[k, i, 1, 1], gradient[k, i, 2, 2] = s[3], s[6], -s[3] - s[6]
                gradient[k, i, 0, 1] = gradient[k, i, 1, 0] = s[4]
                gradient[k, i, 0, 2] = gradient[k, i, 2, 0] = s[5]
                gradient[k, i, 1, 2] = gradient[k, i, 2, 1] = s[7]


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
    """Add to out (k, m) k sums over points (n, 3) for a unit density on each triangle alone: sums of weights (k, n, 8)
    times Bx, By, Bz, dBx/dx, dBx/dy, dBx/dz, dBy/dy, dBy/dz. The other arguments are as for `surface_field`."""
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
    """Add to out (3, 3) the derivatives by the corners of the sum of weights w (8,) times the field and gradient, at a
    point, of three charges, a third of `strength` each. shapes (3, 3): shares of the corners in the charges' places."""
    for q in range(3):
        dx, dy, dz = x - far[3 * q, j], y - far[3 * q + 1, j], z - far[3 * q + 2, j]
        square = 1.0 / (dx * dx + dy * dy + dz * dz)
        cube = square * math.sqrt(square) * strength / 3.0
        # M d, half of the gradient of d . M d. M: the weights w[3:] as a symmetric matrix. It may have a trace,
        # although the gradient of the field has none.
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
    over points (n, 3) with weights (k, n, 8), as in `surface_weights`, for charges (m,).

    far (14, m): as for `surface_field`; shapes (3, 3): shares of the corners in its three points. Where the closed form
    is used, its derivatives are central differences.
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
