"""Maps that missed their accuracy: the largest errors in made-up reports, and the line at which the warning points."""

import runpy
import warnings

import pytest

from fieldmap.errors import MapAccuracyWarning
from fieldmap.store import MissedAccuracy, missed_accuracy, stated_accuracy, warn_of_missed_accuracy
from fieldmap.store.stated_accuracy import largest_share


def report(flux=0.01, gradient=0.02, within=0.01, **more):
    """flux, gradient: the largest errors, in different kinds of states."""
    tried = {
        "searched for": {"flux_density_share": flux, "gradient_share": 0.001, "states": 3},
        "at random": {"flux_density_share": 0.002, "gradient_share": 0.003, "states": 40},
        "trained on": {"flux_density_share": 0.001, "gradient_share": gradient, "states": 500},
    }
    return {"held_out_within": within, "states_tried": tried} | more


def test_errors_of_twice_the_accuracy_are_allowed_and_twice_as_much_of_the_gradient():
    """held_out_within already is twice the recipe's accuracy."""
    assert missed_accuracy(report()) is None
    assert missed_accuracy(report(flux=0.0101)) == MissedAccuracy(0.0101, 0.02, 0.005, 543)
    assert missed_accuracy(report(gradient=0.0201)) == MissedAccuracy(0.01, 0.0201, 0.005, 543)
    assert missed_accuracy(report(flux=0.03, gradient=0.04)) == MissedAccuracy(0.03, 0.04, 0.005, 543)


@pytest.mark.parametrize(
    "other",
    [
        {},
        {"held_out_within": 0.001},
        report(states_tried={}),
        report(states_tried=None),
        report(within=None),
        report(within="much"),
        report(states_tried={"a": {"flux_density_share": 1.0, "gradient_share": 1.0}}),
    ],
)
def test_what_states_no_errors_has_missed_nothing(other):
    assert missed_accuracy(other) is None


def test_its_words_and_the_larger_share():
    missed = MissedAccuracy(0.032, 0.05, 0.0125, 9)
    assert (
        missed.text == "current model off by up to 3.2 % of B and 5 % of the gradient (1.2 % of B asked for)"
    )
    assert (missed.largest_share, MissedAccuracy(0.01, 0.05, 0.001, 9).largest_share) == (0.032, 0.025)
    assert (largest_share(0.1, 0.3), largest_share(0.2, 0.3)) == (0.15, 0.2)


def opens(path, **given):
    warn_of_missed_accuracy(path, report(flux=0.1), **given)


def test_the_warning_points_at_the_line_that_opens_the_map():
    with pytest.warns(MapAccuracyWarning, match=r"^a\.h5: current model off by up to 10 %") as caught:
        opens("a.h5")
    assert (caught[0].filename, caught[0].lineno) == (__file__, opens.__code__.co_firstlineno + 1)
    with pytest.warns(MapAccuracyWarning) as caught:
        opens("a.h5", stacklevel=2)
    here = test_the_warning_points_at_the_line_that_opens_the_map.__code__.co_firstlineno
    assert (caught[0].filename, caught[0].lineno) == (__file__, here + 5)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_missed_accuracy("a.h5", report())


def test_rules_of_the_program_that_imports_it_come_first():
    with warnings.catch_warnings():
        warnings.resetwarnings()
        warnings.simplefilter("ignore")
        runpy.run_path(stated_accuracy.__file__)
        rules = [(one[0], one[2]) for one in warnings.filters]
    assert rules == [("ignore", Warning), ("always", MapAccuracyWarning)]
