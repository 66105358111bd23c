"""Gradients of nodal functions at the four points of second-order tetrahedra, all points and functions at once."""

import numpy as np
from numba import njit, prange

from fieldmap.kernels.iron.quadratic_potential import _gradient, _shape_gradients


@njit(cache=True, parallel=True)
def sample_gradients(values, nodes, gradients):
    """Gradients (e, 4, 3, r) of nodal functions `values` (n, r) at the points of `quadratic_potential.residual`.

    nodes (e, 10); gradients (e, 4, 3) of the barycentric coordinates.
    """
    count, functions = nodes.shape[0], values.shape[1]
    out = np.empty((count, 4, 3, functions))
    for e in prange(count):
        d = np.empty((10, 3))
        one = np.empty(3)
        for q in range(4):
            _shape_gradients(q, gradients[e], d)
            for j in range(functions):
                _gradient(values[:, j], nodes[e], d, one)
                out[e, q, 0, j], out[e, q, 1, j], out[e, q, 2, j] = one[0], one[1], one[2]
    return out
