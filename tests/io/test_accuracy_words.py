"""The accuracy of a map in words: every number of the data is in the text, in the stated unit."""

from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.io.accuracy_words import accuracy_words, reference_words
from fieldmap.io.map_summary import MapSummary
from fieldmap.store import FieldError

TRIED = {
    "searched for": {"states": 7, "solved": 7, "flux_density_share": 0.0012, "gradient_share": 0.0034},
    "at random": {"states": 20, "solved": 18, "flux_density_share": 0.0056, "gradient_share": 0.0023},
}
SOLVER = {
    "modes": 21,
    "sample_points": 430,
    "states_trained_on": 60,
    "states_trained_on_solved": 60,
    "corners_trained_on": 0,
    "extremes": {"looked_at": 77, "different": 77, "solved": 21, "by_residual": False, "searched": 0},
}


def words(
    report=SOLVER, reference=(1.5, 1.5), domain="a domain", bound=None, sampled=None, error=None, **more
):
    """Kind of error -> text. domain: None for a map that is linear in the currents."""
    info = SimpleNamespace(
        reference_current=np.array(reference),
        provenance=SimpleNamespace(solver_report={**report, **more}),
        interpolation_error=sampled,
        error_bounds={"harmonic": bound} if bound else {},
        reduced_model=None if domain is None else SimpleNamespace(domain=domain),
        current_error=error,
    )
    return dict(accuracy_words(MapSummary("a.h5", 1, info, None, None, (), "")))


def model(**more):
    """The lines on the current model: test states, recipe and extremes, training."""
    return words(**more)["current model"].splitlines()


@pytest.mark.parametrize(
    ("reference", "told"),
    [
        ((1.5, 1.5), "1.5 A in every coil"),
        ((0.123456,), "0.1235 A in every coil"),
        ((1.5, 2.0), "1.5, 2 A"),
        ((2.0, 1.5, 0.123456), "2, 1.5, 0.1235 A"),
    ],
)
def test_reference_currents(reference, told):
    assert (
        reference_words(SimpleNamespace(info=SimpleNamespace(reference_current=np.array(reference)))) == told
    )


def test_errors_of_the_mesh_in_percent():
    estimate = {"flux_density": 5.1e-4, "gradient": 0.062}
    found = words({"tetrahedra": 10, "error": estimate}, domain=None)
    assert found["mesh error"] == "0.051 % of B, 6.2 % of the gradient of the largest, estimated"
    assert words({"tetrahedra": 10}, domain=None)["mesh error"].startswith(
        "not measured; a map with a larger"
    )
    assert "mesh error" not in words({"tetrahedra": 0}, domain=None)
    assert list(words({}, domain=None)) == ["interpolation"]


def test_errors_of_the_interpolation_in_microtesla():
    bound, sampled = FieldError(3.4e-6, 0.045), FieldError(7.8e-9, 0.0012)
    linear = words({}, domain=None, bound=bound, sampled=sampled)
    assert linear == {
        "interpolation": "certified: lookups within 3.4 uT, 45 mT/m of the solver in the box, up to 1.5 A in every coil"
    }
    assert words(bound=bound, sampled=sampled)["interpolation"] == (
        "certified for the interpolation alone: lookups within 3.4 uT, 45 mT/m of the fields that the map "
        "interpolates, at all currents"
    )
    assert words(sampled=sampled, reference=(1.0, 2.5))["interpolation"] == (
        "largest found 0.0078 uT, 1.2 mT/m, at sampled points in the Hermite form with 1, 2.5 A"
    )
    assert words()["interpolation"] == "not measured"


def test_errors_of_the_current_model_are_the_largest_over_all_kinds():
    first, *_ = model(states_tried=TRIED, error=FieldError(9.1e-6, 0.0082))
    assert first == (
        "largest error 0.56 % of B, 0.34 % of the gradient, relative to the largest of the state (9.1 uT, 8.2 mT/m), "
        "at test states outside of the training: 7 found by a search; 20 at random (18 solved, the others "
        "mirror images)"
    )
    trained = {"trained on": {"states": 60, "solved": 60, "flux_density_share": 0.0, "gradient_share": 0.0}}
    first, *_ = model(states_tried=TRIED | trained)
    assert first.startswith(
        "largest error 0.56 % of B, 0.34 % of the gradient, relative to the largest of the state, at "
    )
    assert first.endswith(
        "at test states: 7 found by a search; 20 at random (18 solved, the others mirror images); 60 of the training"
    )
    assert model()[0] == "not measured"


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ({}, "21 modes and 430 points from 60 solved states"),
        (
            {"condensed_from": {"modes": 44, "points": 900}},
            "21 modes and 430 points, condensed from 44 and 900, from 60 solved states",
        ),
        ({"condensed_from": {"modes": 44, "points": 431}},
         "21 modes and 430 points, condensed from 44 and 431, from 60 solved states"),
        ({"condensed_from": {"modes": 44, "points": 430}}, "21 modes and 430 points from 60 solved states"),
        ({"condensed_from": {"modes": 44, "points": 100}}, "21 modes and 430 points from 60 solved states"),
        ({"states_trained_on": 100}, "21 modes and 430 points from 60 solved states, 100 with mirror images"),
        ({"states_trained_on": 61}, "21 modes and 430 points from 60 solved states, 61 with mirror images"),
        ({"states_trained_on": 59}, "21 modes and 430 points from 60 solved states"),
        (
            {"corners_trained_on": 5, "states_trained_on": 72},
            "21 modes and 430 points from 60 solved states, 5 of them extremes of the currents, 72 with mirror images",
        ),
        (
            {"corners_trained_on": 5, "extremes": None},
            "21 modes and 430 points from 60 solved states, 5 of them corners of the domain",
        ),
    ],
)  # fmt: skip
def test_what_the_current_model_was_trained_on(more, told):
    assert model(**more)[-1] == told


EXTREMES = "extremes of the currents (corners, single coils, equal and opposed currents): 77"
RESIDUAL = ": those with the largest residuals of the model and some at random"


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ({}, ", 21 solved"),
        ({"different": 33}, ", 33 without mirror images, 21 solved"),
        ({"different": 76}, ", 76 without mirror images, 21 solved"),
        ({"by_residual": True}, f", 21 solved{RESIDUAL}"),
        ({"searched": 4321}, ", 21 solved; search by the residual among 4321 further currents"),
        (
            {"different": 33, "by_residual": True, "searched": 1},
            f", 33 without mirror images, 21 solved{RESIDUAL}; search by the residual among 1 further currents",
        ),
    ],
)
def test_the_extremes_of_the_currents(more, told):
    assert model(extremes=SOLVER["extremes"] | more)[1:-1] == [EXTREMES + told]


OLD = "extremes of the currents were not searched: the map is of an earlier version"


@pytest.mark.parametrize(
    ("corners", "told"),
    [
        (None, []),
        ({"looked_at": 64, "in_all": 64, "different": 20, "solved": 20}, []),
        ({"looked_at": 64, "in_all": 64, "different": 20, "solved": 21}, []),
        (
            {"looked_at": 64, "in_all": 128, "different": 20, "solved": 19},
            [
                "the model's residual was evaluated at 64 of 128 corners (20 without mirror images); 19 were solved: "
                "those with the largest residuals and some at random"
            ],
        ),
        (
            {"looked_at": 64, "in_all": 128, "different": 64, "solved": 12},
            [
                "the model's residual was evaluated at 64 of 128 corners; 12 were solved: those with the largest "
                "residuals and some at random"
            ],
        ),
    ],
)
def test_the_corners_of_maps_of_earlier_versions(corners, told):
    assert model(extremes=None, corners=corners)[1:-1] == [OLD, *told]


@pytest.mark.parametrize(
    ("within", "told"),
    [
        (0.004, ["the recipe asks for 0.4 % of B and 0.8 % of the gradient at these states; its states, modes and "
                 "points do not reach this: allow more of them under [currents], or make the domain smaller"]),
        (0.0056, []),
    ],
)  # fmt: skip
def test_what_the_recipe_asked_for(within, told):
    """Allowed is twice the accuracy at a tested state, and twice that for the gradient."""
    assert model(states_tried=TRIED, held_out_within=within)[1:-2] == told
