"""Harmonic polynomials about another origin, as a matrix on their coefficients."""

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, eye_array

from fieldmap.core.harmonics import derivative_matrix


@cache
def _unit_shift(degree: int, axis: int) -> tuple[csr_array, NDArray[np.intp]]:
    """Matrix of coefficients ((degree + 1)^2,) to those about an origin 1 further along an axis, and of each of its
    entries by which power of the shift it grows.

    Taylor's series, which ends: p(x + s) = sum_k (s d/dx)^k p(x) / k!. All degrees that the polynomials have are kept.
    """
    terms = (degree + 1) ** 2
    derivative = csr_array(derivative_matrix(degree, axis))
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
