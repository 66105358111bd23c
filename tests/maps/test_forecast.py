"""Expected seconds of the stages of a map, from the amounts of their work."""

from itertools import pairwise

import pytest

from fieldmap.maps.forecast import (
    STAGES,
    expect_by_assembly,
    expect_choices,
    expect_fields,
    expect_tried,
    seconds_of_state,
    states_expected,
    states_needed,
    training,
)
from fieldmap.progress import Forecast
from fieldmap.store import Grid


@pytest.fixture
def forecast():
    return Forecast(lambda *_: None, dict.fromkeys((*STAGES, "nodes", "certificate"), 0.0))


def test_stages_of_the_main_map_are_expected_to_take_what_they_took(forecast):
    """Processor seconds of a run of maps/workspace.toml: 51 834 nodes, 925 MB, one image, 27 states, 29 extremes, 20 at
    random, 140 modes and 1600 points; a map of 2057 nodes with 26 fields of 12 418 faces."""
    each = seconds_of_state(51_834, 925_240_344)
    assert each == pytest.approx(1.1, rel=0.2)
    expect_tried(forecast, each, 29, 20)
    expect_choices(forecast, each, 51_834, 27 * 2, 140, 1600)
    forecast.expect("training", each * training(27, 6, 0, 1)[1])
    expect_fields(forecast, Grid([0, 0, 0], [1, 1, 1], (11, 11, 17)), 12_418, 26)
    took = {
        "training": 60,
        "extremes": 37,
        "points": 46,
        "random": 13,
        "search": 14,
        "modes": 51,
        "certificate": 3.5,
    }
    assert {stage: forecast.expected(stage) for stage in took} == pytest.approx(took, rel=0.5)


def test_what_is_expected_grows_as_the_work_does(forecast):
    """Work grows with states, extremes, nodes and points, and for products of modes with the modes' square."""

    def after(expect, stage, *amounts):
        expect(forecast, *amounts)
        return forecast.expected(stage)

    fixed = after(expect_tried, "extremes", 2.0, 0, 20)
    assert after(expect_tried, "extremes", 2.0, 30, 20) - fixed == pytest.approx(
        3 * (after(expect_tried, "extremes", 2.0, 10, 20) - fixed)
    )
    assert after(expect_tried, "random", 2.0, 9, 40) == pytest.approx(
        4 * after(expect_tried, "random", 1.0, 9, 20)
    )
    for stage, amount, power in (
        ("points", 1, 1),
        ("points", 2, 1),
        ("points", 3, 2),
        ("modes", 3, 2),
        ("modes", 4, 1),
    ):
        amounts = [0.0, 5000, 40, 50, 600]
        once = after(expect_choices, stage, *amounts)
        amounts[amount] *= 3
        assert after(expect_choices, stage, *amounts) == pytest.approx(3**power * once)
    small, large = (Grid([0, 0, 0], [1, 1, 1], (n + 1, n + 1, n + 1)) for n in (9, 99))
    assert after(expect_fields, "nodes", large, 2000, 6) == pytest.approx(
        1000 * after(expect_fields, "nodes", small, 2000, 6)
    )


def test_a_training_that_is_done_has_the_modes_left():
    """Work is done piece by piece over states, rounds of four and later steps; at the end the modes are left."""
    whole = training(0, 0, 11, 1)[1]
    done = [training(solved, max(0, solved - 3) // 4, 11 - solved, 1) for solved in range(12)]
    assert [of for _, of in done] == pytest.approx([whole] * 12)
    steps = [after - before for (before, _), (after, _) in pairwise(done)]
    assert steps[3:6] == steps[7:10] == [1.0] * 3
    assert min(steps[:3]) > 1.0
    assert whole > done[-1][0]
    # Images of states add to the work.
    assert training(11, 2, 0, 15)[1] > training(11, 2, 0, 1)[1]


def test_before_the_iron_is_assembled_all_goes_by_what_that_takes(forecast):
    expect_by_assembly(forecast, 10.0, 40, 20)
    once = {stage: forecast.expected(stage) for stage in STAGES}
    expect_by_assembly(forecast, 30.0, 40, 20)
    assert all(forecast.expected(stage) == pytest.approx(3 * seconds) for stage, seconds in once.items())
    assert once["assembling"] == 10.0
    assert min(once.values()) > 0.0


@pytest.mark.parametrize(
    ("shares", "solved", "most", "images", "states"),
    [
        # Before two rounds: 54 with their images, at least those of the first round, at most 65 % of the most allowed.
        ([], [], 200, 0, 54),
        ([0.1], [3], 200, 1, 27),
        ([], [], 200, 15, 7),
        ([], [], 60, 0, 39),
        ([0.1], [50], 60, 0, 50),
        # A tenth for every four states is 1e-3 after 3 + 8 states: this forecast counts half after two rounds, 2 / 3
        # after three.
        ([0.1, 0.01], [3, 7], 60, 0, 25),
        ([0.1, 0.01, 1e-3], [3, 7, 11], 60, 0, 20),
        # Errors of zero, errors that hardly fall, that stay, or that grow.
        ([0.1, 0.0], [3, 7], 60, 0, 23),
        ([0.1, 0.0999], [3, 7], 60, 0, 50),
        ([0.1, 0.1], [3, 7], 60, 0, 50),
        ([0.1, 0.2], [3, 7], 60, 0, 50),
        # Never fewer than the solved states.
        ([0.1, 0.01], [30, 50], 60, 0, 50),
    ],
)
def test_states_that_are_expected_begin_at_what_is_usual(shares, solved, most, images, states):
    assert states_expected(shares, solved, most, 1e-3, images) == pytest.approx(states, abs=0.5)


@pytest.mark.parametrize(
    ("shares", "solved", "states"),
    [
        # A tenth for every four states: 1e-3 after 3 + 8 states.
        ([0.1, 0.01], [3, 7], 11),
        ([0.1, 0.01, 1e-4], [3, 7, 15], 11 + 4),
        # Between the solved states and the most allowed: for an error of zero, and for an error that hardly falls.
        ([0.1, 0.0], [3, 7], 7),
        ([0.1, 0.0999], [3, 7], 60),
        # Errors that grow or stay, and too few rounds.
        ([0.1, 0.1], [3, 7], 60),
        ([0.1, 0.2], [3, 7], 60),
        ([0.1], [3], 39),
        ([], [], 39),
        ([0.1], [50], 50),
    ],
)
def test_states_that_are_needed_follow_from_the_errors_of_the_rounds(shares, solved, states):
    assert states_needed(shares, solved, 60, 1e-3) == states
