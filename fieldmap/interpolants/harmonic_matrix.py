"""Matrices from the coefficients of a harmonic polynomial to its derivatives at points."""

from functools import cache
from itertools import combinations_with_replacement
from math import factorial

import numpy as np
from numpy.typing import NDArray

from fieldmap.core.harmonics import derivative_matrix, regular_table
from fieldmap.typing import Array


def field_matrix(degree: int, points: Array) -> Array:
    """(n, 3, (degree + 1)^2): first derivatives at local points (n, 3)."""
    table = regular_table(degree - 1, np.ascontiguousarray(points))
    return np.stack([_derived(table, degree, i) for i in range(3)], axis=1)


def gradient_matrix(degree: int, points: Array) -> Array:
    """(n, 3, 3, (degree + 1)^2): second derivatives at local points (n, 3)."""
    table = regular_table(degree - 2, np.ascontiguousarray(points))
    rows = np.empty((len(points), 3, 3, (degree + 1) ** 2))
    for i, j in combinations_with_replacement(range(3), 2):
        rows[:, i, j] = _derived(_derived(table, degree - 1, j), degree, i)
        rows[:, j, i] = rows[:, i, j]
    return rows


def _derived(table: Array, degree: int, i: int) -> Array:
    """table (n, degree^2) @ derivative_matrix(degree, i), a matrix with at most two entries a column."""
    harmonics, shares = _two_harmonics(degree, i)
    # For degree 1 there is only one harmonic to sum.
    first, *second = [share * table[:, k] for k, share in zip(harmonics, shares, strict=True)]
    return np.asarray(first + second[0] if second else first)


@cache
def _two_harmonics(degree: int, i: int) -> tuple[NDArray[np.intp], Array]:
    """The harmonics (2, (degree + 1)^2) that sum to each derivative, and their factors; one row for degree 1."""
    matrix = derivative_matrix(degree, i)
    rows = np.sort(np.argsort(-np.abs(matrix), axis=0, kind="stable")[:2], axis=0)
    return rows, np.take_along_axis(matrix, rows, axis=0)


@cache
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
