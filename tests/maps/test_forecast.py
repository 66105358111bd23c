"""Time left of runs whose pieces take known times, on a clock of the test's own."""

import numpy as np
import pytest

from fieldmap.maps import forecast
from fieldmap.maps.forecast import (
    STAGES,
    Forecast,
    expect_modes,
    expect_points,
    expect_training,
    expect_tried,
    states_needed,
)


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


def test_a_stage_without_pieces_that_takes_longer_has_a_tenth_of_that_left(clock):
    """Of 10 s and 20 s that are expected; a remark tells no progress, and pieces beyond their number end a stage."""
    told = []
    tell = Forecast(lambda *given: told.append(given), {"a": 10.0, "b": 20.0})
    for now, text in ((0.0, "begun"), (4.0, "on"), (40.0, "late")):
        clock.now = 100.0 + now
        tell.at("a", text)
    tell.note("by the way")
    clock.now += 10.0
    tell.at("a", "done", 6.0, 5.0)
    assert [text for text, _ in told] == ["begun", "on", "late", "by the way", "done"]
    shares = [share for _, share in told]
    assert shares == pytest.approx([0.0, 4.0 / 30.0, 40.0 / 64.0, 40.0 / 64.0, 50.0 / 70.0])
    assert (tell.expected("a"), tell.expected("b"), tell.taken()) == (50.0, 20.0, 50.0)
    tell.expect("b", 3.0)
    tell.at("b", "next")
    assert (tell.expected("b"), tell.taken(), told[-1]) == (3.0, 0.0, ("next", pytest.approx(50.0 / 53.0)))


def test_of_stages_of_which_nothing_is_expected_nothing_is_known(clock):
    told = []
    tell = Forecast(lambda text, share: told.append(share), {"a": 0.0, "b": 0.0})
    tell.at("a", "")
    clock.now += 5.0
    tell.at("a", "")
    tell.expect("b", 5.0)
    tell.at("a", "")
    assert told == [0.0, 0.0, pytest.approx(5.0 / 10.5)]


def test_a_training_is_expected_to_take_what_shipped_devices_took():
    """Seconds of each stage, where the assembly takes 100 s: by the shares that stand beside the constants."""
    tell = Forecast(lambda *_: None, {name: 100.0 if name == "assembling" else 0.0 for name in STAGES})
    expect_training(tell, states=10, held_out=12)
    # A state takes 17 s; 65 % of the allowed ones are expected; one to try takes 30 % of one to train on.
    expected = {
        "assembling": 100.0,
        "training": 6.5 * 17.0,
        "extremes": 25 * 5.1,
        "points": 100.0,
        "random": 12 * 5.1,
        "search": 30 * 5.1,
        "modes": 70.0,
    }
    assert {name: tell.expected(name) for name in STAGES} == pytest.approx(expected)
    expect_tried(tell, 4, 10.0)
    assert [tell.expected(name) for name in ("extremes", "random", "search")] == pytest.approx([75, 12, 90])
    # 1e10 products in a second: of each state, each point, and each mode with each other, twice.
    expect_points(tell, points=3000, modes=50, states=40)
    assert tell.expected("points") == pytest.approx(40 * 3000 * 50 * 50 * 2 / 1e10)
    expect_modes(tell, points=400, modes=30)
    assert tell.expected("modes") == pytest.approx(70.0 + 5000 * 400 * 30 * 30 * 2 / 1e10)


@pytest.mark.parametrize(
    ("shares", "solved", "states"),
    [
        # A tenth for every four states: 1e-3 after 3 + 8 of them.
        ([0.1, 0.01], [3, 7], 11),
        ([0.1, 0.01, 1e-4], [3, 7, 15], 11 + 4),
        # Between the states that are there and the most: with an error of nothing, and with one that hardly falls.
        ([0.1, 0.0], [3, 7], 7),
        ([0.1, 0.0999], [3, 7], 60),
        # Errors that grow or stay, and of too few rounds.
        ([0.1, 0.1], [3, 7], 60),
        ([0.1, 0.2], [3, 7], 60),
        ([0.1], [3], 39),
        ([], [], 39),
        ([0.1], [50], 50),
    ],
)
def test_states_that_are_needed_follow_from_the_errors_of_the_rounds(shares, solved, states):
    assert states_needed(shares, solved, 60, 1e-3) == states
