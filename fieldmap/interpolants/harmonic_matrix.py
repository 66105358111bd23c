"""What a harmonic polynomial gives at points, as a matrix on its coefficients."""

from functools import cache
from itertools import combinations_with_replacement
from math import factorial

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, eye_array

from fieldmap.core.harmonics import derivative_matrix, regular_table
from fieldmap.typing import Array


def field_matrix(degree: int, points: Array) -> Array:
    """(n, 3, (degree + 1)^2): first derivatives at local points (n, 3)."""
    table = regular_table(degree - 1, np.ascontiguousarray(points))
    return np.stack([table @ _first(degree, i) for i in range(3)], axis=1)


def gradient_matrix(degree: int, points: Array) -> Array:
    """(n, 3, 3, (degree + 1)^2): second derivatives at local points (n, 3)."""
    table = regular_table(degree - 2, np.ascontiguousarray(points))
    rows = np.empty((len(points), 3, 3, (degree + 1) ** 2))
    for i, j in combinations_with_replacement(range(3), 2):
        rows[:, i, j] = table @ _second(degree, i, j)
        rows[:, j, i] = rows[:, i, j]
    return rows


# A derivative of a harmonic is a sum of two others at most: of a column nearly all is zero.
@cache
def _first(degree: int, i: int) -> csr_array:
    return csr_array(derivative_matrix(degree, i))


@cache
def _second(degree: int, i: int, j: int) -> csr_array:
    return _first(degree - 1, j) @ _first(degree, i)


@cache
def _unit_shift(degree: int, axis: int) -> tuple[csr_array, NDArray[np.intp]]:
    """Matrix of coefficients ((degree + 1)^2,) to those about an origin 1 further along an axis, and of each of its
    entries by which power of the shift it grows.

    Taylor's series, which ends: p(x + s) = sum_k (s d/dx)^k p(x) / k!. All degrees that the polynomials have are kept.
    """
    terms = (degree + 1) ** 2
    derivative = _first(degree, axis).copy()
    derivative.resize((terms, terms))
    total = term = eye_array(terms, format="csr")
    for k in range(1, degree + 1):
        term = (1.0 / k) * (derivative @ term)
        total = total + term
    of_degree = np.sqrt(np.arange(terms)).astype(np.intp)
    rows = np.repeat(np.arange(terms), np.diff(total.indptr))
    return total, of_degree[total.indices] - of_degree[rows]


def shift_matrix(degree: int, axis: int, shift: float) -> csr_array:
    """Matrix ((degree + 1)^2, (degree + 1)^2) of coefficients to those of the same polynomials about an origin `shift`
    further along an axis."""
    unit, powers = _unit_shift(degree, axis)
    data = unit.data * (shift ** np.arange(degree + 1))[powers]
    return csr_array((data, unit.indices, unit.indptr), shape=unit.shape)


def largest_on_sphere(degree: int) -> Array:
    """Weights ((degree + 1)^2,) w with |p_l| <= r^l sqrt(sum_m w_lm c_lm^2) at radius r, for each degree l of p.

    |p_l|^2 is at most (2 l + 1) / (4 pi) times its integral over the unit sphere (addition theorem), where the
    harmonics are orthogonal with squares 4 pi / ((2 l + 1) (l + m)! (l - m)!), half of it for m > 0.
    """
    weights = np.empty((degree + 1) ** 2)
    for l in range(degree + 1):
        of_order = [1.0 / (factorial(l + m) * factorial(l - m)) for m in range(l + 1)]
        weights[l * l] = of_order[0]
        weights[l * l + 1 : (l + 1) ** 2] = np.repeat(of_order[1:], 2) / 2.0
    return weights
