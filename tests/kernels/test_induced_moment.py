"""Induced moments of soft ellipsoids, against the equations they solve; small, for code that is not compiled."""

import numpy as np
import pytest

from fieldmap.kernels.map.body_wrench import wrench_and_slopes
from fieldmap.kernels.map.induced_moment import (
    SIZE,
    induced_moment,
    induced_moments,
    inner_field,
    moment_slope,
)

FACTORS = np.array([0.5, 0.3, 0.2])
KNOTS = np.array([0.0, 1e-3, 4e-3, 0.1])
J = np.array([0.0, 0.8, 1.4, 1.8])
SLOPES = np.array([800.0, 500.0, 50.0, 0.0])
TURN = np.array([[0.0, -1.0, 0.0], [0.6, 0.0, -0.8], [0.8, 0.0, 0.6]])


def work():
    width = np.diff(KNOTS)
    pieces = width * (J[1:] + J[:-1]) / 2 + width**2 * (SLOPES[:-1] - SLOPES[1:]) / 12
    return np.concatenate([[0.0], np.cumsum(pieces)])


def pieces(reluctance):
    """One piece of constant permeability and one with a law, the second turned."""
    first = [0, 0, 0, *np.eye(3).ravel(), 1 / 3, 1 / 3, 1 / 3, 2.0, reluctance, 0, 0]
    second = [1e-3, 0, 2e-3, *TURN.ravel(), *FACTORS, 3.0, -1.0, 1 + 2 * SIZE, 4]
    return np.concatenate([[2.0], first, second, KNOTS, J, SLOPES, work()])


@pytest.mark.parametrize("reluctance", [0.0, 0.02, 10.0])
def test_a_sphere_of_constant_permeability(reluctance):
    soft, flux = pieces(reluctance), np.array([0.1, -0.2, 0.3])
    *moment, energy = induced_moment(soft, 0, 0, *flux)
    exact = 2.0 * flux / (reluctance + 1 / 3)
    np.testing.assert_allclose(moment, exact, rtol=1e-15)
    assert energy == pytest.approx(-0.5 * exact @ flux, rel=1e-14)


@pytest.mark.parametrize("size", [0.0, 1e-6, 0.05, 0.4, 0.9, 2.0])
@pytest.mark.parametrize("base", [0, 5])
def test_an_ellipsoid_with_a_law(size, base):
    soft = np.concatenate([np.full(base, np.nan), pieces(0.02)])
    along = size * np.array([0.6, -0.5, 0.4])
    row = base + 1 + SIZE
    s, j, slope, _ = inner_field(soft, base, row, *along)
    if size == 0.0:
        assert (s, j, slope) == (0.0, 0.0, 800.0)
    else:
        h = along / (1 + FACTORS * j / s)
        assert np.linalg.norm(h) == pytest.approx(s, rel=1e-13)
    flux = TURN @ along
    *moment, _ = induced_moment(soft, base, 1, *flux)
    if size > 0.0:
        np.testing.assert_allclose(TURN.T @ moment, 3.0 * j * h / s, rtol=1e-12, atol=1e-18)
    if 0.0 < size <= 0.9:
        out, step = np.empty((3, 3)), 1e-5 * size
        moment_slope(soft, base, 1, *flux, np.empty((3, 3, 3)), out)
        ahead, behind = (
            np.array([induced_moment(soft, base, 1, *(flux + way * step * unit)) for unit in np.eye(3)])
            for way in (1, -1)
        )
        exact = (ahead - behind) / (2 * step)
        np.testing.assert_allclose(out, exact[:, :3].T, atol=1e-7 * np.abs(out).max())
        np.testing.assert_allclose(exact[:, 3], -np.array(moment), atol=1e-7 * np.linalg.norm(moment))


def test_bodies_at_several_poses():
    soft = pieces(0.02)
    turns = np.array([np.eye(3), TURN])
    flux = np.random.default_rng(1).normal(size=(2, 2, 3))
    moments, energies, slopes = np.empty((2, 2, 3)), np.empty((2, 2)), np.empty((2, 2, 3, 3))
    induced_moments(soft, turns, flux, moments, energies, slopes)
    for n in range(2):
        for p in range(2):
            *own, energy = induced_moment(soft, 0, p, *(turns[n].T @ flux[n, p]))
            np.testing.assert_allclose(moments[n, p], turns[n] @ own, rtol=1e-13)
            assert energies[n, p] == energy
    np.testing.assert_allclose(slopes, slopes.transpose(0, 1, 3, 2), atol=1e-12)
    again = np.empty((2, 2, 3))
    induced_moments(soft, turns, flux, again, energies, np.empty((2, 2, 0, 0)))
    np.testing.assert_array_equal(again, moments)


def test_slopes_by_weights():
    rng, soft = np.random.default_rng(2), pieces(0.02)
    dipoles, arms = rng.normal(size=(1, 3)), 1e-2 * rng.normal(size=(3, 3))
    flux, slope = 0.05 * rng.normal(size=(3, 2, 3)), rng.normal(size=(3, 2, 3, 3))

    def at(weights):
        wrench, slopes = np.empty(6), np.empty((6, 2))
        wrench_and_slopes(dipoles, arms, soft, TURN, flux, slope, weights, wrench, slopes)
        return wrench, slopes

    weights = np.array([1.0, -0.6])
    exact = np.column_stack([(at(weights + d)[0] - at(weights - d)[0]) / 2e-5 for d in 1e-5 * np.eye(2)])
    np.testing.assert_allclose(at(weights)[1], exact, atol=1e-6 * np.abs(exact).max())
