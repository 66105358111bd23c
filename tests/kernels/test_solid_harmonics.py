"""The polynomials of cells and of a whole box in numba, against sums of harmonics."""

import numpy as np
import pytest

from fieldmap.kernels.map import cell_harmonics, global_harmonics
from tests.core.harmonics_in_numpy import derivative_matrix, regular_table

POINTS = np.random.default_rng(0).uniform(-1, 1, (6, 3))


def coefficients(degree, seed=1):
    return np.random.default_rng(seed).normal(size=(degree + 1) ** 2)


def derivative(c, degree, axes):
    for axis in axes:
        c = derivative_matrix(degree, axis) @ c
        degree -= 1
    return c, degree


def value_of(c, degree, axes, points):
    derived, lower = derivative(c, degree, axes)
    return regular_table(lower, points) @ derived


def nine(c, degree, points):
    pairs = [(0,), (1,), (2,), (0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
    return np.stack([value_of(c, degree, axes, points) for axes in pairs], axis=1)


def test_the_cell_written_out():
    c = coefficients(5)
    ours = [cell_harmonics.field_and_gradient(c, *point) for point in POINTS]
    np.testing.assert_allclose(ours, nine(c, 5, POINTS), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("degree", [3, 5, 9])
def test_the_table_of_any_degree(degree):
    c = coefficients(degree)
    rows = np.empty(global_harmonics.ROWS * degree**2)
    global_harmonics.expand(c, degree, rows)
    work = np.empty(degree**2)
    ours = [global_harmonics.field_and_gradient(rows, degree, *point, work) for point in POINTS]
    np.testing.assert_allclose(ours, nine(c, degree, POINTS), rtol=1e-11, atol=1e-12)
