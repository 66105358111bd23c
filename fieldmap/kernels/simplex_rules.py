"""Quadrature rules on triangles and tetrahedra, in barycentric coordinates; weights sum to 1. Plain numpy tables."""

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import roots_jacobi

Rule = tuple[NDArray[np.float64], NDArray[np.float64]]


def triangle_rule(degree: int) -> Rule:
    """Points (q, 3) and weights (q,) exact for polynomials of the given degree.

    Degrees 1, 2, 4: symmetric rules of 1, 3, 6 points (Dunavant, Int. J. Numer. Meth. Eng. 21 (1985) 1129,
    table II); others: conical Gauss-Jacobi product (Stroud 1971).
    """
    if degree == 1:
        return np.full((1, 3), 1 / 3), np.ones(1)
    if degree == 2:
        return np.full((3, 3), 1 / 6) + 0.5 * np.eye(3), np.full(3, 1 / 3)
    if degree in (3, 4):
        inner, outer = 0.445948490915965, 0.091576213509771
        points = np.vstack([np.full((3, 3), a) + (1 - 3 * a) * np.eye(3) for a in (inner, outer)])
        return points, np.repeat([0.223381589678011, 0.109951743655322], 3)
    n = degree // 2 + 1
    (u, wu), (v, wv) = _gauss_jacobi(n, 1), _gauss_jacobi(n, 0)
    a = np.repeat(u, n)
    b = np.tile(v, n) * (1 - a)
    return np.column_stack([1 - a - b, a, b]), np.outer(wu, wv).ravel()


def tetrahedron_rule(degree: int) -> Rule:
    """Points (q, 4) and weights (q,) exact for the given degree.

    Degree 2: the symmetric rule of 4 points (Stroud T3:2-1); others: conical Gauss-Jacobi product of
    ceil((degree + 1)/2)^3 points.
    """
    if degree <= 2:
        b = (5 - np.sqrt(5)) / 20
        return np.full((4, 4), b) + (1 - 4 * b) * np.eye(4), np.full(4, 0.25)
    n = degree // 2 + 1
    (u, wu), (v, wv), (w, ww) = (_gauss_jacobi(n, k) for k in (2, 1, 0))
    a, b, c = (grid.ravel() for grid in np.meshgrid(u, v, w, indexing="ij"))
    b = b * (1 - a)
    c = c * (1 - a - b)
    weights = wu[:, None, None] * wv[None, :, None] * ww[None, None, :]
    return np.column_stack([1 - a - b - c, a, b, c]), weights.ravel()


@cache
def _gauss_jacobi(n: int, exponent: int) -> Rule:
    """Nodes on (0, 1) and weights, sum 1, for the weight (1 - x)^exponent."""
    x, w = roots_jacobi(n, exponent, 0)
    return (x + 1) / 2, w / w.sum()
