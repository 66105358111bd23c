"""A map inside the user's own compiled functions."""

import numpy as np
import pytest
from numba import njit
from scipy.integrate import solve_ivp

from fieldmap.lookup import interpolate

MASS, MOMENT = 0.02, 0.8
CURRENTS = np.array([0.9, -0.3, 0.5])


@njit
def fall(evaluate, data, state, dt, steps):
    """Positions of a vertical dipole in the field, classical Runge-Kutta."""
    out = np.empty((steps + 1, 6))
    out[0] = state
    for n in range(steps):
        k1 = rates(evaluate, data, out[n])
        k2 = rates(evaluate, data, out[n] + dt / 2 * k1)
        k3 = rates(evaluate, data, out[n] + dt / 2 * k2)
        k4 = rates(evaluate, data, out[n] + dt * k3)
        out[n + 1] = out[n] + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return out


@njit
def rates(evaluate, data, state):
    _, slope = evaluate(data, state[0], state[1], state[2])
    rate = np.empty(6)
    rate[:3] = state[3:]
    for j in range(3):
        rate[3 + j] = MOMENT * slope[2][j] / MASS
    rate[5] -= 9.81
    return rate


@pytest.fixture(scope="module")
def field_map(dipoles):
    return interpolate(dipoles.map((12, 10, 12)), "harmonic")


def test_right_hand_side_of_an_equation_of_motion(field_map, dipoles):
    evaluate, data = field_map.compiled(CURRENTS)
    start = np.array([0.0, 0.0, -0.01, 0.05, 0.02, 0.3])
    path = fall(evaluate, data, start, 1e-4, 300)

    def by_closed_form(_, state):
        parts = zip(CURRENTS, dipoles.moments, dipoles.sources, strict=True)
        slope = sum(i * dipoles.gradient(m, s, state[None, :3])[0] for i, m, s in parts)
        return np.concatenate([state[3:], MOMENT * slope[2] / MASS - [0, 0, 9.81]])

    expected = solve_ivp(by_closed_form, (0, 0.03), start, rtol=1e-11, atol=1e-13).y[:, -1]
    assert np.all(path[:, :3] > field_map.lower)
    np.testing.assert_allclose(path[-1], expected, rtol=0, atol=2e-6)


def test_currents_that_change_from_call_to_call(field_map, dipoles):
    evaluate, data = field_map.compiled()

    @njit
    def total(data, points, currents):
        result = np.zeros(3)
        for p in range(len(points)):
            flux, _ = evaluate(data, currents[p], points[p, 0], points[p, 1], points[p, 2])
            for i in range(3):
                result[i] += flux[i]
        return result

    points = dipoles.points(50)
    currents = np.random.default_rng(0).normal(size=(50, 3))
    expected = field_map.field(points, currents).sum(axis=0)
    np.testing.assert_allclose(total(data, points, currents), expected, rtol=1e-12)


def test_outside_is_nan_for_a_compiled_caller(field_map):
    evaluate, data = field_map.compiled(CURRENTS)
    flux, slope = evaluate(data, 1.0, 0.0, 0.0)
    assert np.isnan(flux).all()
    assert np.isnan(slope).all()
