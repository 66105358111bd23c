"""Element loops of the second-order potential form: gradients on ten-node tetrahedra, and integrals tested with them.

Nodes of an element: four corners, then the midpoints of the edges (0,1), (0,2), (0,3), (1,2), (1,3), (2,3). With
barycentric coordinates l and their gradients g (4, 3), the shape functions have the gradients (4 l_i - 1) g_i and
4 (l_a g_b + l_b g_a). Four points per element integrate products of two gradients exactly (Stroud T3:2-1).
"""

import math

import numpy as np

from fieldmap.kernels.compilation import njit

_B = (5.0 - math.sqrt(5.0)) / 20.0
_A = 1.0 - 3.0 * _B
_FIRST = np.array([0, 0, 0, 1, 1, 2])
_SECOND = np.array([1, 2, 3, 2, 3, 3])


@njit(inline="always")
def shape_gradients(q, g, d):
    """Fill d (10, 3) with the gradients of the shape functions at point q (the one near corner q)."""
    for i in range(4):
        factor = 4.0 * (_A if i == q else _B) - 1.0
        for k in range(3):
            d[i, k] = factor * g[i, k]
    for m in range(6):
        a, b = _FIRST[m], _SECOND[m]
        la = _A if a == q else _B
        lb = _A if b == q else _B
        for k in range(3):
            d[4 + m, k] = 4.0 * (la * g[b, k] + lb * g[a, k])


@njit(nogil=True)
def sample_gradients(begin, end, values, nodes, gradients, out):
    """Fill out (e, 4, 3, r) with the gradients of nodal functions `values` (n, r) at the points of every element.

    nodes (e, 10); gradients (e, 4, 3) of the barycentric coordinates.
    """
    d = np.empty((10, 3))
    for e in range(begin, end):
        for q in range(4):
            shape_gradients(q, gradients[e], d)
            for j in range(values.shape[1]):
                x = y = z = 0.0
                for i in range(10):
                    p = values[nodes[e, i], j]
                    x += p * d[i, 0]
                    y += p * d[i, 1]
                    z += p * d[i, 2]
                out[e, q, 0, j], out[e, q, 1, j], out[e, q, 2, j] = x, y, z


@njit(nogil=True)
def tested_vectors(begin, end, values, gradients, volume, out):
    """Add to out (e, 10) the element vectors of int v . grad N_i for v = `values` (e, 4, 3) at the points.

    gradients (e, 4, 3) of the barycentric coordinates; volume (e,).
    """
    d = np.empty((10, 3))
    for e in range(begin, end):
        for q in range(4):
            shape_gradients(q, gradients[e], d)
            w = 0.25 * volume[e]
            x, y, z = w * values[e, q, 0], w * values[e, q, 1], w * values[e, q, 2]
            for i in range(10):
                out[e, i] += d[i, 0] * x + d[i, 1] * y + d[i, 2] * z


@njit(nogil=True)
def tested_matrices(begin, end, values, gradients, volume, out):
    """Add to out (e, 10, 10) the element matrices of int grad N_i . D grad N_j for symmetric D = `values` (e, 4, 6) at
    the points.

    The six numbers are xx, xy, xz, yy, yz, zz; otherwise as `tested_vectors`.
    """
    d, image = np.empty((10, 3)), np.empty((10, 3))
    for e in range(begin, end):
        for q in range(4):
            shape_gradients(q, gradients[e], d)
            w = 0.25 * volume[e]
            xx, xy, xz = w * values[e, q, 0], w * values[e, q, 1], w * values[e, q, 2]
            yy, yz, zz = w * values[e, q, 3], w * values[e, q, 4], w * values[e, q, 5]
            for i in range(10):
                image[i, 0] = xx * d[i, 0] + xy * d[i, 1] + xz * d[i, 2]
                image[i, 1] = xy * d[i, 0] + yy * d[i, 1] + yz * d[i, 2]
                image[i, 2] = xz * d[i, 0] + yz * d[i, 1] + zz * d[i, 2]
            for i in range(10):
                for j in range(i + 1):
                    out[e, i, j] += image[i, 0] * d[j, 0] + image[i, 1] * d[j, 1] + image[i, 2] * d[j, 2]
        for i in range(10):
            for j in range(i):
                out[e, j, i] = out[e, i, j]
