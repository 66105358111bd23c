"""Extrapolated states: exact on polynomials, of third order on curves, no worse than the last state on noise."""

import numpy as np
import pytest

from fieldmap.core.iron import continued


def go_on(aim, passed, states):
    return continued(*(np.array(part, float, order="C") for part in (aim, passed, states)))


def parabola(t):
    return np.array([2.0 + 3.0 * t - 0.7 * t**2, -1.0 + t**2])


@pytest.mark.parametrize("times", [(0.0, 1.0, 2.0, 3.0), (0.0, 0.7, 2.0, 2.9), (0.0, 1.5, 2.0, 2.4)])
def test_parabola_along_a_line_is_met(times):
    start, way = np.array([1.0, 2.0, -1.0]), np.array([0.3, -0.1, 0.2])
    places = [start + t * way for t in times]
    found = go_on(places[3], places[:3], [parabola(t) for t in times[:3]])
    np.testing.assert_allclose(found, parabola(times[3]), rtol=1e-12)


def test_error_on_a_curve_is_of_third_order_and_of_fewer_states_lower():
    """A state that is smooth in the parameters, which move along a circle."""

    def error(step, count):
        angles = 0.4 + step * np.arange(-count, 1)
        places = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        states = np.exp(places @ [0.5, -0.3])[:, None]
        return abs(go_on(places[-1], places[:-1], states[:-1])[0] - states[-1, 0])

    for count in (1, 2, 3):
        slope = np.log2(error(0.02, count) / error(0.01, count))
        assert slope == pytest.approx(count, abs=0.15)


def test_leap_begins_from_no_further_than_the_last_step_reaches():
    """Forward by two steps at most; backward and to the side from the last state."""
    places, states = [[0.0, 0.0], [1.0, 0.0]], [[0.0], [10.0]]
    np.testing.assert_allclose(go_on([50.0, 0.0], places, states), [30.0])
    np.testing.assert_allclose(go_on([-50.0, 0.0], places, states), [10.0])
    np.testing.assert_allclose(go_on([1.0, 7.0], places, states), [10.0])


def test_one_state_and_standing_still_give_the_last():
    np.testing.assert_array_equal(go_on([5.0], [[1.0]], [[3.0, 4.0]]), [3.0, 4.0])
    np.testing.assert_array_equal(go_on([5.0], [[1.0], [2.0], [2.0]], [[0.0], [1.0], [7.0]]), [7.0])


def test_turning_back_takes_no_third_state_of_the_same_place():
    """From 0 to 1 and back to 0: no polynomial passes through two states at one place."""
    found = go_on([-1.0], [[0.0], [1.0], [0.0]], [[5.0], [6.0], [5.0]])
    np.testing.assert_allclose(found, [4.0])


def test_noise_is_not_amplified():
    """The state equals the parameters, which are random. A parabola through them would err by 4.5 times their spread
    (weights 3, -3, 1 and the aim's own), the last state by 1.4."""
    rng = np.random.default_rng(3)
    errors = []
    for _ in range(300):
        places = rng.normal(size=(4, 6))
        errors.append(np.sqrt(((go_on(places[3], places[:3], places[:3]) - places[3]) ** 2).mean()))
    assert np.median(errors) < 1.45
