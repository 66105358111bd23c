"""Factors and inverses by LAPACK's addresses against dense algebra."""

import numpy as np
import pytest
from scipy.linalg import LinAlgError

from fieldmap.iron.operators.mutual import cholesky_in_place, inverse_in_place


def positive(size, precision):
    square = np.random.default_rng(size).standard_normal((size, size))
    return np.asfortranarray(square @ square.T + size * np.eye(size), precision)


@pytest.mark.parametrize("size", [1, 2, 50])
@pytest.mark.parametrize(("precision", "digits"), [(np.float32, 1e-4), (np.float64, 1e-12)])
def test_lower_triangles_are_those_of_the_factor_and_the_inverse(size, precision, digits):
    matrix = positive(size, precision)
    held = matrix.copy(order="F")
    cholesky_in_place(held)
    assert np.tril(held) == pytest.approx(np.linalg.cholesky(matrix.astype(float)), rel=digits, abs=digits)
    # Entries above the diagonal are left alone.
    assert np.array_equal(np.triu(held, 1), np.triu(matrix, 1))
    inverse_in_place(held)
    exact = np.linalg.inv(matrix.astype(float))
    assert np.tril(held) == pytest.approx(np.tril(exact), abs=digits * np.abs(exact).max())


def test_what_has_no_factor_or_is_stored_otherwise_is_refused():
    indefinite = positive(5, np.float64)
    indefinite[3, 3] = -1.0
    with pytest.raises(LinAlgError):
        cholesky_in_place(indefinite)
    with pytest.raises(LinAlgError):
        inverse_in_place(np.zeros((3, 3), order="F"))
    for other in (np.ascontiguousarray(np.arange(9.0).reshape(3, 3)), np.zeros((3, 4), order="F")):
        with pytest.raises(ValueError, match="Fortran"):
            cholesky_in_place(other)
