"""Refusals of the checked functions, and their messages."""

import numpy as np
import pytest

from fieldmap.device.model import CircularCoil, PathCoil, RoundedRectangleCoil
from fieldmap.errors import InputError
from fieldmap.sources import unit_flux_density, unit_flux_density_and_gradient
from fieldmap.sources.magpylib_objects import magpylib_coil

COIL = CircularCoil("c", 0.011, 0.021, 0.039, 840.0)


@pytest.mark.parametrize("function", [unit_flux_density, unit_flux_density_and_gradient])
@pytest.mark.parametrize(
    ("points", "words"),
    [
        (np.zeros((3, 2)), r"shape \(3, 2\)"),
        (np.zeros((2, 2, 3)), r"shape \(2, 2, 3\)"),
        (0.0, r"shape \(\)"),
        ([[0, 0, 0], [0, np.nan, 0]], "index 1"),
        ([[np.inf, 0, 0]], "finite"),
    ],
)
def test_bad_points_are_named(function, points, words):
    with pytest.raises(InputError, match=words) as caught:
        function(COIL, points)
    assert caught.value.exit_code == 2


def test_one_point_and_many_points_agree():
    one = unit_flux_density(COIL, [0.01, 0.0, 0.05])
    assert one.shape == (1, 3)
    many, gradient = unit_flux_density_and_gradient(COIL, [[0.01, 0.0, 0.05], [0, 0, 0]])
    np.testing.assert_allclose(many[0], one[0], rtol=1e-13)
    assert gradient.shape == (2, 3, 3)


def test_no_points_give_no_values():
    field, gradient = unit_flux_density_and_gradient(COIL, np.zeros((0, 3)))
    assert field.shape == (0, 3)
    assert gradient.shape == (0, 3, 3)


def test_points_are_not_changed():
    points = np.ones((2, 3))
    unit_flux_density(COIL, points)
    assert np.all(points == 1)


def test_path_whose_roundings_do_not_fit_is_refused_edge_by_edge():
    corners = np.array([[0, 0], [0.01, 0], [0.01, 0.01], [0, 0.01]])
    with pytest.raises(InputError, match="too short") as caught:
        unit_flux_density(PathCoil("p", corners, 0.006, 0.002, 0.01, 1.0), np.zeros(3))
    assert len(caught.value.problems) == 4


@pytest.mark.parametrize("corners", [[[0, 0], [0.01, 0]], [[0, 0], [0.1, 0], [0.1, 0], [0, 0.1]]])
def test_path_with_too_few_or_repeated_corners_is_refused(corners):
    with pytest.raises(InputError, match="corners"):
        unit_flux_density(PathCoil("p", np.array(corners), 0.001, 0.001, 0.01, 1.0), np.zeros(3))


def test_winding_thicker_than_its_rounding_is_refused():
    with pytest.raises(InputError, match="thickness/2"):
        unit_flux_density(RoundedRectangleCoil("r", 0.03, 0.03, 0.004, 0.01, 0.01, 1.0), np.zeros(3))


@pytest.mark.parametrize("digits", [3, 15, float("nan")])
def test_digits_out_of_range_are_refused(digits):
    with pytest.raises(InputError, match="digits"):
        unit_flux_density(COIL, np.zeros(3), digits=digits)


def test_magpylib_twin_needs_a_shell_and_a_current():
    with pytest.raises(InputError, match="shells"):
        magpylib_coil(COIL, shells=0)
    with pytest.raises(InputError, match="current"):
        magpylib_coil(COIL, current=float("nan"))
