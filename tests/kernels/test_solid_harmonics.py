"""Solid harmonics against scipy's spherical harmonics, derivatives against differences, sums against both."""

import math

import numpy as np
import pytest
from scipy.special import sph_harm_y

from fieldmap.kernels.map import cell_harmonics, global_harmonics, solid_harmonics

POINTS = np.random.default_rng(0).uniform(-1, 1, (6, 3))
STEP = 1e-5


def by_scipy(degree, points):
    """r^l P_l^m e^(i m phi) / (l + m)! without the sign (-1)^m that scipy puts into P_l^m."""
    x, y, z = points.T
    r = np.linalg.norm(points, axis=1)
    theta, phi = np.arccos(z / r), np.arctan2(y, x)
    columns = []
    for l in range(degree + 1):
        for m in range(l + 1):
            norm = math.sqrt(4 * np.pi / (2 * l + 1) / (math.factorial(l - m) * math.factorial(l + m)))
            value = (-1) ** m * norm * r**l * sph_harm_y(l, m, theta, phi)
            columns += [value.real] if m == 0 else [value.real, value.imag]
    return np.stack(columns, axis=1)


def table(degree, points):
    return solid_harmonics.regular_table(degree, np.ascontiguousarray(points))


def coefficients(degree, seed=1):
    return np.random.default_rng(seed).normal(size=(degree + 1) ** 2)


def derivative(c, degree, axes):
    for axis in axes:
        c = solid_harmonics.derivative_matrix(degree, axis) @ c
        degree -= 1
    return c, degree


def value_of(c, degree, axes, points):
    derived, lower = derivative(c, degree, axes)
    return table(lower, points) @ derived


def test_harmonics_are_those_of_scipy():
    np.testing.assert_allclose(table(9, POINTS), by_scipy(9, POINTS), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_ladder_differentiates(axis):
    c = coefficients(7)
    shift = STEP * np.eye(3)[axis]
    # Fourth order: the error is that of rounding.
    near = table(7, POINTS + shift) - table(7, POINTS - shift)
    far = table(7, POINTS + 2 * shift) - table(7, POINTS - 2 * shift)
    expected = (8 * near - far) @ c / (12 * STEP)
    np.testing.assert_allclose(value_of(c, 7, [axis], POINTS), expected, rtol=1e-8, atol=1e-9)


def test_every_harmonic_solves_laplace():
    total = sum(
        solid_harmonics.derivative_matrix(7, axis) @ solid_harmonics.derivative_matrix(8, axis)
        for axis in range(3)
    )
    assert np.abs(total).max() < 1e-13


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
