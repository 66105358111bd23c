"""Time left of runs whose pieces take known times, on a clock of the test's own."""

import numpy as np
import pytest

from fieldmap.maps import forecast
from fieldmap.maps.forecast import Forecast


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


def run(clock, priors, *truth):
    """(time, share) of a run whose stages take truth (name, pieces, seconds of each)."""
    told = []
    begin = clock.now
    tell = Forecast(lambda message, share: told.append((clock.now - begin, share)), priors)
    for name, pieces, seconds in truth:
        for k, each in enumerate(np.broadcast_to(seconds, pieces)):
            tell.at(name, "", k, pieces)
            clock.now += each
    return np.array([*told, (clock.now - begin, 1.0)])


def test_priors_that_are_right_give_the_time_left(clock):
    told = run(clock, {"a": 40.0, "b": 10.0}, ("a", 8, 5.0), ("b", 2, 5.0))
    assert told[:, 1] == pytest.approx(told[:, 0] / 50.0)


def test_wrong_priors_are_replaced_by_what_pieces_take(clock):
    told = run(clock, {"a": 4.0, "b": 10.0}, ("a", 8, 5.0), ("b", 2, 5.0))
    after_one = told[told[:, 0] > 0]
    assert after_one[:, 1] == pytest.approx(after_one[:, 0] / 50.0)


def test_the_share_never_falls_though_more_is_to_do_than_was_expected(clock):
    told = run(clock, {"a": 10.0, "b": 10.0}, ("a", 2, 5.0), ("b", 40, 5.0))
    assert (np.diff(told[:, 1]) >= 0).all()
    # Where the truth has caught up, the time left is right again.
    late = told[told[:, 0] > 150.0]
    assert late[:, 1] == pytest.approx(late[:, 0] / 210.0, rel=0.05)


def test_a_run_that_goes_back_tells_the_time_of_what_comes_again(clock):
    """Two stages, and both once more: after the return the share is that of the whole run."""
    stages = ("a", 8, 5.0), ("b", 2, 5.0)
    told = run(clock, {"a": 40.0, "b": 10.0}, *stages, *stages)
    before, after = told[told[:, 0] < 50.0], told[told[:, 0] > 50.0]
    assert before[:, 1] == pytest.approx(before[:, 0] / 50.0)
    assert after[:, 1] == pytest.approx(after[:, 0] / 100.0)


def test_a_first_piece_that_waits_says_nothing_of_the_later_ones(clock):
    """Once half of the pieces that are done are others."""
    late = run(clock, {"a": 10.0}, ("a", 20, [40.0] + 19 * [2.0]))[4:]
    assert late[:, 1] == pytest.approx(late[:, 0] / 78.0)
