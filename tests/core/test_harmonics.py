"""Harmonics and derivatives of the C core against scipy and the ladder in numpy, and against differences."""

import numpy as np
import pytest

from fieldmap.core import harmonics
from tests.core import harmonics_in_numpy

POINTS = np.random.default_rng(0).uniform(-1, 1, (6, 3))
STEP = 1e-5


@pytest.mark.parametrize("degree", [0, 1, 9, 20])
def test_harmonics_are_those_of_scipy(degree):
    expected = harmonics_in_numpy.regular_table(degree, POINTS)
    np.testing.assert_allclose(harmonics.regular_table(degree, POINTS), expected, rtol=1e-11, atol=1e-15)


@pytest.mark.parametrize("degree", [1, 2, 5, 16])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_derivatives_are_those_of_the_ladder(degree, axis):
    expected = harmonics_in_numpy.derivative_matrix(degree, axis)
    np.testing.assert_array_equal(harmonics.derivative_matrix(degree, axis), expected)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_ladder_differentiates(axis):
    c, shift = np.random.default_rng(1).normal(size=64), STEP * np.eye(3)[axis]

    def value(points):
        return harmonics.regular_table(7, points) @ c

    # Differences of fourth order: only the rounding error is left.
    near, far = (
        value(POINTS + shift) - value(POINTS - shift),
        value(POINTS + 2 * shift) - value(POINTS - 2 * shift),
    )
    found = harmonics.regular_table(6, POINTS) @ harmonics.derivative_matrix(7, axis) @ c
    np.testing.assert_allclose(found, (8 * near - far) / (12 * STEP), rtol=1e-8, atol=1e-9)


def test_every_harmonic_solves_laplace():
    total = sum(
        harmonics.derivative_matrix(7, axis) @ harmonics.derivative_matrix(8, axis) for axis in range(3)
    )
    assert np.abs(total).max() < 1e-13


def test_what_does_not_fit_is_refused():
    for degree, points in ((-1, POINTS), (2, POINTS[0]), (2, POINTS[:, :2])):
        with pytest.raises(TypeError):
            harmonics.regular_table(degree, points)
    for degree, axis in ((0, 0), (3, 3), (3, -1)):
        with pytest.raises(ValueError, match="axis"):
            harmonics.derivative_matrix(degree, axis)
