"""Element loops of the second-order potential form: fields, residual and tangent on ten-node tetrahedra.

Nodes of an element: four corners, then the midpoints of the edges (0,1), (0,2), (0,3), (1,2), (1,3), (2,3). With
barycentric coordinates l and their gradients g (4, 3), the shape functions have the gradients (4 l_i - 1) g_i and
4 (l_a g_b + l_b g_a). Four points per element integrate products of two gradients exactly (Stroud T3:2-1).
"""

import math

import numpy as np

from fieldmap.kernels.compilation import njit
from fieldmap.kernels.iron.magnetisation_law import flux_density

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


@njit(inline="always")
def potential_gradient(values, nodes, d, out):
    """out (3,) = gradient of the nodal values (n,) for shape gradients d."""
    out[0] = out[1] = out[2] = 0.0
    for i in range(10):
        p = values[nodes[i]]
        out[0] += p * d[i, 0]
        out[1] += p * d[i, 1]
        out[2] += p * d[i, 2]


@njit(inline="always")
def _strength(potential, bubble, nodes, source, d, h):
    """h (3,) = source (3,) + grad bubble - grad potential, for shape gradients d; returns its size."""
    h[0], h[1], h[2] = source[0], source[1], source[2]
    for i in range(10):
        p = bubble[nodes[i]] - potential[nodes[i]]
        h[0] += p * d[i, 0]
        h[1] += p * d[i, 1]
        h[2] += p * d[i, 2]
    return math.sqrt(h[0] * h[0] + h[1] * h[1] + h[2] * h[2])


@njit(nogil=True)
def residual(
    begin,
    end,
    potential,
    source,
    bubble,
    nodes,
    gradients,
    volume,
    law,
    remanence,
    offset,
    knots,
    coefficients,
    out,
):
    """Add to out (e, 10) the element vectors of int (b(h) + br - t) . grad N_i, with h = t - grad potential and
    t = source + grad bubble.

    potential, bubble (n,); source (e, 3) and remanence (e, 3), constant per element; nodes (e, 10);
    gradients (e, 4, 3) of the barycentric coordinates; volume (e,); law (e,) and the tables of
    `fieldmap.kernels.iron.magnetisation_law`.
    """
    d = np.empty((10, 3))
    h, g = np.empty(3), np.empty(3)
    for e in range(begin, end):
        for q in range(4):
            shape_gradients(q, gradients[e], d)
            size = _strength(potential, bubble, nodes[e], source[e], d, h)
            potential_gradient(potential, nodes[e], d, g)
            b, slope = flux_density(size, law[e], offset, knots, coefficients)
            # b(h) - t = (b / |h| - 1) h - grad potential
            m = (b / size if size > 1e-30 else slope) - 1.0
            w = 0.25 * volume[e]
            rx = w * (m * h[0] + remanence[e, 0] - g[0])
            ry = w * (m * h[1] + remanence[e, 1] - g[1])
            rz = w * (m * h[2] + remanence[e, 2] - g[2])
            for i in range(10):
                out[e, i] += d[i, 0] * rx + d[i, 1] * ry + d[i, 2] * rz


@njit(nogil=True)
def tangent(
    begin, end, potential, source, bubble, nodes, gradients, volume, law, offset, knots, coefficients, out
):
    """Add to out (e, 10, 10) the element matrices of int grad N_i . (db/dh) grad N_j; arguments as for `residual`.

    db/dh = (b/h) 1 + (b' - b/h) h h^T / h^2: symmetric and positive definite where b' > 0.
    """
    d = np.empty((10, 3))
    along = np.empty(10)
    h = np.empty(3)
    for e in range(begin, end):
        for q in range(4):
            shape_gradients(q, gradients[e], d)
            size = _strength(potential, bubble, nodes[e], source[e], d, h)
            b, slope = flux_density(size, law[e], offset, knots, coefficients)
            m = b / size if size > 1e-30 else slope
            w = 0.25 * volume[e]
            extra = w * (slope - m) / (size * size) if size > 1e-30 else 0.0
            for i in range(10):
                along[i] = d[i, 0] * h[0] + d[i, 1] * h[1] + d[i, 2] * h[2]
            for i in range(10):
                for j in range(i + 1):
                    dot = d[i, 0] * d[j, 0] + d[i, 1] * d[j, 1] + d[i, 2] * d[j, 2]
                    out[e, i, j] += w * m * dot + extra * along[i] * along[j]
        for i in range(10):
            for j in range(i):
                out[e, j, i] = out[e, i, j]


@njit(nogil=True)
def source_response(
    begin,
    end,
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
    out,
):
    """Add to out (e, 10) the element vectors of int (db/dh - 1) t' . grad N_i: how the residual follows a change of the
    coils' field, t' = by_source + grad by_bubble; the other arguments as for `residual`."""
    d = np.empty((10, 3))
    h, t = np.empty(3), np.empty(3)
    for e in range(begin, end):
        for q in range(4):
            shape_gradients(q, gradients[e], d)
            size = _strength(potential, bubble, nodes[e], source[e], d, h)
            b, slope = flux_density(size, law[e], offset, knots, coefficients)
            m = b / size if size > 1e-30 else slope
            potential_gradient(by_bubble, nodes[e], d, t)
            for k in range(3):
                t[k] += by_source[e, k]
            w = 0.25 * volume[e]
            along = w * (slope - m) / (size * size) if size > 1e-30 else 0.0
            along *= h[0] * t[0] + h[1] * t[1] + h[2] * t[2]
            across = w * (m - 1.0)
            rx, ry, rz = (
                across * t[0] + along * h[0],
                across * t[1] + along * h[1],
                across * t[2] + along * h[2],
            )
            for i in range(10):
                out[e, i] += d[i, 0] * rx + d[i, 1] * ry + d[i, 2] * rz


@njit(nogil=True)
def mean_fields(
    begin,
    end,
    potential,
    source,
    bubble,
    nodes,
    gradients,
    law,
    remanence,
    offset,
    knots,
    coefficients,
    mean,
    largest,
):
    """Add to mean (e, 3) the mean flux density of every element, and to largest (e,) the largest mu0 H at its points;
    both are zeros before."""
    d = np.empty((10, 3))
    h = np.empty(3)
    for e in range(begin, end):
        for q in range(4):
            shape_gradients(q, gradients[e], d)
            size = _strength(potential, bubble, nodes[e], source[e], d, h)
            b, slope = flux_density(size, law[e], offset, knots, coefficients)
            m = b / size if size > 1e-30 else slope
            largest[e] = max(largest[e], size)
            for k in range(3):
                mean[e, k] += 0.25 * (m * h[k] + remanence[e, k])
