"""Tricubic Hermite interpolation of several channels on one regular grid.

Tensor-product cubic Hermite form (de Boor, "Bicubic spline interpolation", J. Math. Phys. 41, 1962, in three
variables): with the one-dimensional basis

    h_00(t) = (1 + 2 t)(1 - t)^2   h_10(t) = t (1 - t)^2   h_01(t) = t^2 (3 - 2 t)   h_11(t) = t^2 (t - 1)

the interpolant in a cell is the sum over its 8 corners of value, first derivatives and mixed derivatives
f_yz, f_xz, f_xy, f_xyz times the products of these. It is once continuously differentiable and reproduces
every polynomial of degree <= 3 in each variable. Error O(h^4) in f, O(h^3) in its gradient.

Layout: coefficients (nx, ny, nz, n_channels, 8); index 4 a + 2 b + c of the last axis is the derivative of
order a, b, c (0 or 1) in x, y, z times spacing_x^a spacing_y^b spacing_z^c. Arrays float64, C-contiguous.
Arguments are not checked here; a checked function stands in front.
"""

import numpy as np

from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.map.map_block import (
    INLINED,
    INLINED_EARLY,
    LOCAL,
    WHOLE,
    InterpolantKernels,
    node_number,
    superpose,
)

# Of a 0 in the call itself numba makes another type than of a number, and compiles what is called once for each.
_ZERO = np.int64(0)
NODE = 24  # numbers of one set at a node: three components of eight


@njit(**INLINED_EARLY)
def basis(t):
    """h_00, h_10, h_01, h_11 at t."""
    s = 1.0 - t
    return (1.0 + 2.0 * t) * s * s, t * s * s, t * t * (3.0 - 2.0 * t), -t * t * s


@njit(**INLINED_EARLY)
def basis_slope(t, spacing):
    """First derivatives of the basis by position."""
    s = 1.0 - t
    i = 1.0 / spacing
    return -6.0 * t * s * i, s * (1.0 - 3.0 * t) * i, 6.0 * t * s * i, t * (3.0 * t - 2.0) * i


@njit(**INLINED_EARLY)
def _dot(w, near, far, m):
    """Combination along z of both ends of one cell edge; m: index of the derivative order in x and y."""
    n = m + np.uint64(1)
    return w[0] * near[m] + w[1] * near[n] + w[2] * far[m] + w[3] * far[n]


@njit(**INLINED_EARLY)
def value_and_slopes(coefficients, i, j, k, c, wx, wy, wz, dx, dy, dz):
    """f, f_x, f_y, f_z of channel c: sums over z, then y, then x, each partial sum used for all it enters."""
    f, fx, fy, fz = 0.0, 0.0, 0.0, 0.0
    for a in range(2):
        for d in range(2):
            s, sy, sz = 0.0, 0.0, 0.0
            for b in range(2):
                near = coefficients[np.uint64(i + a), np.uint64(j + b), np.uint64(k), np.uint64(c)]
                far = coefficients[np.uint64(i + a), np.uint64(j + b), np.uint64(k + 1), np.uint64(c)]
                for e in range(2):
                    m = np.uint64(4 * d + 2 * e)
                    v = _dot(wz, near, far, m)
                    s += wy[2 * b + e] * v
                    sy += dy[2 * b + e] * v
                    sz += wy[2 * b + e] * _dot(dz, near, far, m)
            f += wx[2 * a + d] * s
            fx += dx[2 * a + d] * s
            fy += wx[2 * a + d] * sy
            fz += wx[2 * a + d] * sz
    return f, fx, fy, fz


@inlined(**INLINED)
def of_nodes(block, nodes, i, j, k, first, tx, ty, tz):
    """Hermite form: channels first, first + 1, first + 2 of the nodes' coefficients (nx, ny, nz, channels, 8)."""
    wx, wy, wz = basis(tx), basis(ty), basis(tz)
    dx = basis_slope(tx, block[LOCAL])
    dy = basis_slope(ty, block[LOCAL + 1])
    dz = basis_slope(tz, block[LOCAL + 2])
    bx, xx, xy, xz = value_and_slopes(nodes, i, j, k, first, wx, wy, wz, dx, dy, dz)
    by, yx, yy, yz = value_and_slopes(nodes, i, j, k, first + 1, wx, wy, wz, dx, dy, dz)
    bz, zx, zy, zz = value_and_slopes(nodes, i, j, k, first + 2, wx, wy, wz, dx, dy, dz)
    return bx, by, bz, xx, xy, xz, yx, yy, yz, zx, zy, zz


@inlined(**INLINED)
def _cell_size(block):
    return 8 * NODE


@njit(**WHOLE)
def _gather(block, weights, i, j, k, out):
    for corner in range(8):
        node = node_number(block, i + corner // 4, j + corner // 2 % 2, k + corner % 2)
        superpose(block, node, NODE, weights, out[corner * NODE : (corner + 1) * NODE])


@inlined(**INLINED)
def _gathered(block, numbers, tx, ty, tz):
    return of_nodes(block, numbers.reshape((2, 2, 2, 3, 8)), _ZERO, _ZERO, _ZERO, _ZERO, tx, ty, tz)


KERNELS = InterpolantKernels(
    _cell_size,
    _gather,
    _gathered,
    set_size=lambda degree: NODE,
)
