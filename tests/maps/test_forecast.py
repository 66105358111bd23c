"""Time left of runs whose pieces take known times, on a clock of the test's own."""

from time import perf_counter

import numpy as np
import pytest

from fieldmap.maps import forecast
from fieldmap.maps.forecast import Forecast
from fieldmap.maps.recipe import Plan
from fieldmap.maps.training.expected import expect_modes, states_needed


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(forecast, "monotonic", clock)
    return clock


def run(clock, priors, truth):
    """(time, share) of a run whose stages take truth[name] = (pieces, seconds of each)."""
    told = []
    begin = clock.now
    tell = Forecast(lambda message, share: told.append((clock.now - begin, share)), priors)
    for name, (pieces, seconds) in truth.items():
        for k in range(pieces):
            tell.at(name, "", k, pieces)
            clock.now += seconds
    return np.array([*told, (clock.now - begin, 1.0)])


def test_priors_that_are_right_give_the_time_left(clock):
    told = run(clock, {"a": 40.0, "b": 10.0}, {"a": (8, 5.0), "b": (2, 5.0)})
    assert told[:, 1] == pytest.approx(told[:, 0] / 50.0)


def test_wrong_priors_are_replaced_by_what_pieces_take(clock):
    told = run(clock, {"a": 4.0, "b": 10.0}, {"a": (8, 5.0), "b": (2, 5.0)})
    after_one = told[told[:, 0] > 0]
    assert after_one[:, 1] == pytest.approx(after_one[:, 0] / 50.0)


def test_the_share_never_falls_though_more_is_to_do_than_was_expected(clock):
    told = run(clock, {"a": 10.0, "b": 10.0}, {"a": (2, 5.0), "b": (40, 5.0)})
    assert (np.diff(told[:, 1]) >= 0).all()
    # Where the truth has caught up, the time left is right again.
    late = told[told[:, 0] > 150.0]
    assert late[:, 1] == pytest.approx(late[:, 0] / 210.0, rel=0.05)


def test_a_run_that_goes_back_tells_the_time_of_what_comes_again(clock):
    """Two stages, and both once more: after the return the share is that of the whole run."""
    told = []
    tell = Forecast(lambda message, share: told.append((clock.now - 100.0, share)), {"a": 40.0, "b": 10.0})
    for name, pieces in (("a", 8), ("b", 2), ("a", 8), ("b", 2)):
        for k in range(pieces):
            tell.at(name, "", k, pieces)
            clock.now += 5.0
    told = np.array(told)
    before, after = told[told[:, 0] < 50.0], told[told[:, 0] > 50.0]
    assert before[:, 1] == pytest.approx(before[:, 0] / 50.0)
    assert after[:, 1] == pytest.approx(after[:, 0] / 100.0)


def test_a_first_piece_that_waits_says_nothing_of_the_later_ones(clock):
    """Once half of the pieces that are done are others."""
    told = []
    tell = Forecast(lambda message, share: told.append((clock.now - 100.0, share)), {"a": 10.0})
    for k in range(20):
        tell.at("a", "", k, 20)
        clock.now += 40.0 if k == 0 else 2.0
    late = np.array(told[4:])
    assert late[:, 1] == pytest.approx(late[:, 0] / 78.0)


def test_time_for_compilation_does_not_count_for_later_pieces(clock, monkeypatch):
    compiled = [0.0]
    monkeypatch.setattr(forecast, "seconds_compiling", lambda: compiled[0])
    told = []
    tell = Forecast(lambda message, share: told.append((clock.now - 100.0, share)), {"a": 20.0, "b": 10.0})
    for stage, pieces in (("a", 10), ("b", 5)):
        for k in range(pieces):
            tell.at(stage, "", k, pieces)
            clock.now += 2.0
            if (stage, k) == ("a", 0):
                clock.now += 50.0
                compiled[0] = 50.0
    told = np.array(told)[1:]
    assert told[:, 1] == pytest.approx(told[:, 0] / 80.0)


def test_a_kernel_that_is_compiled_takes_time():
    from numba import njit

    from fieldmap.kernels.compile_time import seconds_compiling

    before = seconds_compiling()
    begin = perf_counter()
    njit(lambda x: x * x + 1.0)(2.0)
    assert 0.0 < seconds_compiling() - before <= perf_counter() - begin


def test_without_any_expectation_nothing_is_done(clock):
    told = []
    tell = Forecast(lambda message, share: told.append(share), {"a": 0.0, "b": 0.0})
    clock.now += 5.0
    tell.at("a", "begins")
    tell.note("resumed")
    assert told == [0.0, 0.0]


def test_states_needed_follow_the_errors_of_the_rounds():
    plan = Plan(states=60, accuracy=1e-3, modes=10, points=10, fields=3, held_out=1, tolerance=1e-6)
    solved = [5, 9, 13]
    shares = [10.0 ** (-1 - k / 10) for k in solved]
    assert states_needed(shares, solved, plan) == 20
    assert states_needed([0.1, 0.1], [5, 9], plan) == 60
    assert 13 <= states_needed([1e-2, 1e-9], [5, 13], plan) <= 60
    assert 20 <= states_needed([], [], plan) <= 60


def test_the_choice_of_modes_takes_as_its_points_and_the_square_of_its_modes():
    tell = Forecast(lambda message, share: None, {"assembling": 10.0, "modes": 0.0})

    def seconds(points, modes):
        expect_modes(tell, points, modes)
        return tell.expected("modes")

    fields = seconds(0, 40)
    assert fields > 0.0
    one = seconds(300, 40) - fields
    assert one > 0.0
    assert seconds(600, 40) - fields == pytest.approx(2.0 * one)
    assert seconds(300, 80) - fields == pytest.approx(4.0 * one)
