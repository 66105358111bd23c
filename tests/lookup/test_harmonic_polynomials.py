"""Harmonic polynomials about another origin, and bounds on them by their coefficients."""

import numpy as np
import pytest

from fieldmap.interpolants import global_polynomial
from fieldmap.interpolants.harmonic_matrix import field_matrix, gradient_matrix, largest_on_sphere
from fieldmap.maps.error_bound import shift_matrix
from fieldmap.store import Grid, MapData
from tests.core.harmonics_in_numpy import regular_table

DEGREE = 7


@pytest.fixture
def coefficients():
    return np.random.default_rng(6).standard_normal(((DEGREE + 1) ** 2, 2))


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_about_another_origin_it_is_the_same_polynomial(coefficients, axis):
    points = np.random.default_rng(axis).uniform(-1, 1, (40, 3))
    shift = 0.37 * np.eye(3)[axis]
    moved = shift_matrix(DEGREE, axis, 0.37) @ coefficients
    here = regular_table(DEGREE, points + shift) @ coefficients
    assert regular_table(DEGREE, points) @ moved == pytest.approx(here, abs=1e-12 * np.abs(here).max())
    assert shift_matrix(DEGREE, axis, -0.37) @ moved == pytest.approx(coefficients, abs=1e-12)


@pytest.mark.parametrize("degree", [2, 3, DEGREE])
def test_gradients_are_differences_of_fields(degree):
    points, step = np.random.default_rng(3).uniform(-1, 1, (20, 3)), 1e-5
    for j, along in enumerate(step * np.eye(3)):
        difference = (field_matrix(degree, points + along) - field_matrix(degree, points - along)) / (
            2 * step
        )
        assert gradient_matrix(degree, points)[:, :, j] == pytest.approx(difference, abs=1e-8)


@pytest.mark.parametrize("degree", range(DEGREE + 1))
def test_no_point_of_a_sphere_is_beyond_the_bound_and_one_reaches_it(degree):
    """The bound is reached at one point by the polynomial of one degree with the coefficients harmonics over weights
    (the reproducing kernel)."""
    radius, own = 0.8, slice(degree**2, (degree + 1) ** 2)
    directions = np.random.default_rng(degree).standard_normal((3000, 3))
    points = radius * directions / np.linalg.norm(directions, axis=1)[:, None]
    weights = largest_on_sphere(DEGREE)[own]
    table = regular_table(DEGREE, points)[:, own]
    for numbers in (np.random.default_rng(1).standard_normal(2 * degree + 1), table[0] / weights):
        bound = radius**degree * np.sqrt(weights @ numbers**2)
        assert np.abs(table @ numbers).max() <= bound * (1 + 1e-12)
    assert abs(table[0] @ numbers) == pytest.approx(bound, rel=1e-12)


@pytest.mark.parametrize("shape", [(5, 7, 6), (14, 5, 15)], ids=["all nodes", "some of them"])
def test_the_polynomial_of_a_box_is_that_of_least_squares(shape):
    """Fields and gradients that no polynomial fits, against one least-squares system of all equations."""
    grid, random = Grid([0.01, -0.02, 0.0], [1e-3, 2e-3, 1.5e-3], shape), np.random.default_rng(7)
    flux, slope = random.standard_normal((2, *shape, 3)), 1e3 * random.standard_normal((2, *shape, 3, 3))
    data = MapData(grid, ("a", "b"), np.ones(2), flux_density=flux, gradient=slope)
    chosen = [global_polynomial._spread(n) for n in shape]
    assert [len(axis) for axis in chosen] == [min(n, 12 if n == 14 else 13) for n in shape]
    size = np.array(grid.upper - grid.lower)
    degree, length = 6, np.linalg.norm(size) / 2
    found = global_polynomial._fit(data, chosen, degree, length)

    at = np.ix_(*chosen)
    points = ((grid.points() - grid.lower - size / 2) / length).reshape(*shape, 3)[at].reshape(-1, 3)
    share = global_polynomial.GRADIENT_WEIGHT
    rows = [field_matrix(degree, points), share * gradient_matrix(degree, points).reshape(len(points), 9, -1)]
    design = np.concatenate(rows, axis=1).reshape(-1, (degree + 1) ** 2)[:, 1:]
    for k in range(2):
        wanted = [flux[k][at].reshape(-1, 3), share * length * slope[k][at].reshape(-1, 9)]
        exact = np.linalg.lstsq(design, np.concatenate(wanted, axis=1).ravel(), rcond=None)[0]
        off = design @ (found[k, 1:] - exact)
        assert np.abs(off).max() < 1e-12 * np.abs(design @ exact).max()
    assert not found[:, 0].any()
