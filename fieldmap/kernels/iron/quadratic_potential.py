"""Element loops of the second-order potential form: fields, residual and tangent on ten-node tetrahedra.

Nodes of an element: four corners, then the midpoints of the edges (0,1), (0,2), (0,3), (1,2), (1,3), (2,3). With
barycentric coordinates l and their gradients g (4, 3), the shape functions have the gradients (4 l_i - 1) g_i and
4 (l_a g_b + l_b g_a). Four points per element integrate products of two gradients exactly (Stroud T3:2-1).
"""

import math

import numpy as np
from numba import njit, prange

from fieldmap.kernels.iron.magnetisation_law import flux_density

_B = (5.0 - math.sqrt(5.0)) / 20.0
_A = 1.0 - 3.0 * _B
_FIRST = np.array([0, 0, 0, 1, 1, 2])
_SECOND = np.array([1, 2, 3, 2, 3, 3])


@njit(cache=True, inline="always")
def _shape_gradients(q, g, d):
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


@njit(cache=True, inline="always")
def _gradient(values, nodes, d, out):
    """out (3,) = gradient of the nodal values (n,) for shape gradients d."""
    out[0] = out[1] = out[2] = 0.0
    for i in range(10):
        p = values[nodes[i]]
        out[0] += p * d[i, 0]
        out[1] += p * d[i, 1]
        out[2] += p * d[i, 2]


@njit(cache=True, parallel=True)
def residual(
    potential, source, bubble, nodes, gradients, volume, law, remanence, offset, knots, coefficients
):
    """Element vectors (e, 10) of int (b(h) + br - t) . grad N_i, with h = t - grad potential, t = source + grad bubble.

    potential, bubble (n,); source (e, 3) and remanence (e, 3), constant per element; nodes (e, 10);
    gradients (e, 4, 3) of the barycentric coordinates; volume (e,); law (e,) and the tables of
    `fieldmap.kernels.iron.magnetisation_law`.
    """
    count = nodes.shape[0]
    out = np.zeros((count, 10))
    for e in prange(count):
        d = np.empty((10, 3))
        up, ub = np.empty(3), np.empty(3)
        for q in range(4):
            _shape_gradients(q, gradients[e], d)
            _gradient(potential, nodes[e], d, up)
            _gradient(bubble, nodes[e], d, ub)
            tx, ty, tz = source[e, 0] + ub[0], source[e, 1] + ub[1], source[e, 2] + ub[2]
            hx, hy, hz = tx - up[0], ty - up[1], tz - up[2]
            h = math.sqrt(hx * hx + hy * hy + hz * hz)
            b, slope = flux_density(h, law[e], offset, knots, coefficients)
            m = b / h if h > 1e-30 else slope
            w = 0.25 * volume[e]
            rx = w * (m * hx + remanence[e, 0] - tx)
            ry = w * (m * hy + remanence[e, 1] - ty)
            rz = w * (m * hz + remanence[e, 2] - tz)
            for i in range(10):
                out[e, i] += d[i, 0] * rx + d[i, 1] * ry + d[i, 2] * rz
    return out


@njit(cache=True, parallel=True)
def tangent(potential, source, bubble, nodes, gradients, volume, law, offset, knots, coefficients):
    """Element matrices (e, 10, 10) of int grad N_i . (db/dh) grad N_j; arguments as for `residual`.

    db/dh = (b/h) 1 + (b' - b/h) h h^T / h^2: symmetric and positive definite where b' > 0.
    """
    count = nodes.shape[0]
    out = np.zeros((count, 10, 10))
    for e in prange(count):
        d = np.empty((10, 3))
        along = np.empty(10)
        up, ub = np.empty(3), np.empty(3)
        for q in range(4):
            _shape_gradients(q, gradients[e], d)
            _gradient(potential, nodes[e], d, up)
            _gradient(bubble, nodes[e], d, ub)
            hx, hy, hz = (
                source[e, 0] + ub[0] - up[0],
                source[e, 1] + ub[1] - up[1],
                source[e, 2] + ub[2] - up[2],
            )
            h = math.sqrt(hx * hx + hy * hy + hz * hz)
            b, slope = flux_density(h, law[e], offset, knots, coefficients)
            m = b / h if h > 1e-30 else slope
            w = 0.25 * volume[e]
            extra = w * (slope - m) / (h * h) if h > 1e-30 else 0.0
            for i in range(10):
                along[i] = d[i, 0] * hx + d[i, 1] * hy + d[i, 2] * hz
            for i in range(10):
                for j in range(i + 1):
                    dot = d[i, 0] * d[j, 0] + d[i, 1] * d[j, 1] + d[i, 2] * d[j, 2]
                    out[e, i, j] += w * m * dot + extra * along[i] * along[j]
        for i in range(10):
            for j in range(i):
                out[e, j, i] = out[e, i, j]
    return out


@njit(cache=True, parallel=True)
def source_response(
    potential,
    source,
    bubble,
    nodes,
    gradients,
    volume,
    law,
    offset,
    knots,
    coefficients,
    by_source,
    by_bubble,
):
    """Element vectors (e, 10) of int (db/dh - 1) t' . grad N_i: how the residual follows a change of the coils' field,
    t' = by_source + grad by_bubble; the other arguments as for `residual`."""
    count = nodes.shape[0]
    out = np.zeros((count, 10))
    for e in prange(count):
        d = np.empty((10, 3))
        up, ub, uc = np.empty(3), np.empty(3), np.empty(3)
        for q in range(4):
            _shape_gradients(q, gradients[e], d)
            _gradient(potential, nodes[e], d, up)
            _gradient(bubble, nodes[e], d, ub)
            _gradient(by_bubble, nodes[e], d, uc)
            hx, hy, hz = (
                source[e, 0] + ub[0] - up[0],
                source[e, 1] + ub[1] - up[1],
                source[e, 2] + ub[2] - up[2],
            )
            tx, ty, tz = by_source[e, 0] + uc[0], by_source[e, 1] + uc[1], by_source[e, 2] + uc[2]
            h = math.sqrt(hx * hx + hy * hy + hz * hz)
            b, slope = flux_density(h, law[e], offset, knots, coefficients)
            m = b / h if h > 1e-30 else slope
            w = 0.25 * volume[e]
            along = w * (slope - m) * (hx * tx + hy * ty + hz * tz) / (h * h) if h > 1e-30 else 0.0
            across = w * (m - 1.0)
            rx, ry, rz = across * tx + along * hx, across * ty + along * hy, across * tz + along * hz
            for i in range(10):
                out[e, i] += d[i, 0] * rx + d[i, 1] * ry + d[i, 2] * rz
    return out


@njit(cache=True, parallel=True)
def mean_fields(potential, source, bubble, nodes, gradients, law, remanence, offset, knots, coefficients):
    """Mean flux density (e, 3) of every element and the largest mu0 H (e,) at its points."""
    count = nodes.shape[0]
    mean = np.zeros((count, 3))
    largest = np.zeros(count)
    for e in prange(count):
        d = np.empty((10, 3))
        up, ub = np.empty(3), np.empty(3)
        for q in range(4):
            _shape_gradients(q, gradients[e], d)
            _gradient(potential, nodes[e], d, up)
            _gradient(bubble, nodes[e], d, ub)
            hx, hy, hz = (
                source[e, 0] + ub[0] - up[0],
                source[e, 1] + ub[1] - up[1],
                source[e, 2] + ub[2] - up[2],
            )
            h = math.sqrt(hx * hx + hy * hy + hz * hz)
            b, slope = flux_density(h, law[e], offset, knots, coefficients)
            m = b / h if h > 1e-30 else slope
            largest[e] = max(largest[e], h)
            mean[e, 0] += 0.25 * (m * hx + remanence[e, 0])
            mean[e, 1] += 0.25 * (m * hy + remanence[e, 1])
            mean[e, 2] += 0.25 * (m * hz + remanence[e, 2])
    return mean, largest
