"""Vectors and matrices at the four points of second-order tetrahedra, tested with the gradients of the shape functions.

Points, nodes and shape functions are those of `fieldmap.kernels.quadratic_potential`.
"""

import numpy as np
from numba import njit, prange

from fieldmap.kernels.quadratic_potential import _shape_gradients


@njit(cache=True, parallel=True)
def tested_vectors(values, gradients, volume):
    """Element vectors (e, 10) of int v . grad N_i for v = `values` (e, 4, 3) at the points.

    gradients (e, 4, 3) of the barycentric coordinates; volume (e,).
    """
    out = np.zeros((len(values), 10))
    for e in prange(len(values)):
        d = np.empty((10, 3))
        for q in range(4):
            _shape_gradients(q, gradients[e], d)
            w = 0.25 * volume[e]
            x, y, z = w * values[e, q, 0], w * values[e, q, 1], w * values[e, q, 2]
            for i in range(10):
                out[e, i] += d[i, 0] * x + d[i, 1] * y + d[i, 2] * z
    return out


@njit(cache=True, parallel=True)
def tested_matrices(values, gradients, volume):
    """Element matrices (e, 10, 10) of int grad N_i . D grad N_j for symmetric D = `values` (e, 4, 6) at the points.

    The six numbers are xx, xy, xz, yy, yz, zz; otherwise as `tested_vectors`.
    """
    out = np.zeros((len(values), 10, 10))
    for e in prange(len(values)):
        d, image = np.empty((10, 3)), np.empty((10, 3))
        for q in range(4):
            _shape_gradients(q, gradients[e], d)
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
    return out
