"""The summary of a solution: a small ball in the uniform field of a wide loop, in closed form.

The field of the loop is uniform to 1.5 (radius of the ball / radius of the loop)^2 = 1.4e-3 over the ball.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import mu_0

import fieldmap as fm
from fieldmap.errors import InputError
from fieldmap.iron import NonlinearSolver, solve_linear
from fieldmap.iron.summary import (
    body_fluxes,
    checked_groups,
    common_mu_r,
    compare_references,
    component,
    named_sections,
    summarise_solution,
)

LOOP, BALL, TURNS, MU_R, HEIGHT = 0.1, 0.003, 10000, 50.0, 0.02


def loop_field(z):
    """Bz and dBz/dz of the loop per ampere on its axis."""
    flux = mu_0 * TURNS * LOOP**2 / 2 / (LOOP**2 + z**2) ** 1.5
    return flux, -3 * z / (LOOP**2 + z**2) * flux


# Moment of the ball per ampere; inside, H = H0 - M / 3.
MOMENT = 4 * np.pi * BALL**3 * (MU_R - 1) / (MU_R + 2) * loop_field(HEIGHT)[0] / mu_0
INSIDE = 3 * MU_R / (MU_R + 2) * loop_field(HEIGHT)[0]


def known(quantity, value, current=1.0, mu_r=None):
    return fm.Reference(
        quantity, np.array([0.0, 0.0, HEIGHT + 0.008]), np.array([current]), value, "here", mu_r
    )


def outside(distance):
    """Bz per ampere on the axis above the ball: the loop's, and a dipole's."""
    return loop_field(HEIGHT + distance)[0] + mu_0 * MOMENT / (2 * np.pi * distance**3)


@pytest.fixture(scope="module")
def device():
    ball = fm.Body("ball", "iron", fm.Sphere(BALL), 0.001).moved([0.0, 0.0, HEIGHT])
    coil = fm.CircularCoil("loop", inner_radius=0.0995, outer_radius=0.1005, height=0.001, turns=TURNS)
    section = fm.Section("equator", np.array([0.0, 0.0, HEIGHT]), np.array([0.0, 0.0, 2.0]))
    references = (
        known("Bz", outside(0.008)),
        known("Bz", 2 * outside(0.008), current=2.0, mu_r=MU_R),
        known("Bz", 1.0, mu_r=7.0),
    )
    laws = {"iron": fm.LinearMaterial("iron", MU_R)}
    return fm.Device("ball", "A ball", (coil,), (ball,), laws, sections=(section,), references=references)


@pytest.fixture(scope="module")
def solution(device):
    return solve_linear(device)


def test_numbers_of_a_linear_solution(device, solution):
    point = np.array([[0.0, 0.0, HEIGHT - 0.009]])
    groups = (("ball",), ("loop",), ("ball", "loop"))
    summary = summarise_solution(device, solution, np.array([3.0]), point, groups)
    (found,) = summary.points
    # The dipole's field is the same below it as above.
    expected = 3 * (loop_field(HEIGHT - 0.009)[0] + mu_0 * MOMENT / (2 * np.pi * 0.009**3))
    assert found.B[2] == pytest.approx(expected, rel=3e-3)
    assert found.gradient[2, 2] == pytest.approx(
        3 * (loop_field(HEIGHT - 0.009)[1] + 3 * mu_0 * MOMENT / (2 * np.pi * 0.009**4)), rel=0.01
    )
    (equator,) = summary.sections
    assert equator.area == pytest.approx(np.pi * BALL**2, rel=0.02)
    assert equator.flux == pytest.approx(3 * INSIDE * equator.area, rel=0.01)
    assert equator.flux_density == pytest.approx(3 * INSIDE, rel=0.01)
    # F = m dB/dz of the loop's field, with m and B both three times those of 1 A; the force on the loop is opposite.
    ball, loop, both = summary.forces
    pull = 9 * MOMENT * loop_field(HEIGHT)[1]
    assert ball.names == ("ball",)
    assert ball.force[2] == pytest.approx(pull, rel=0.02)
    assert pull < 0  # towards the loop's plane
    assert loop.force[2] == pytest.approx(-ball.force[2], rel=0.02)
    assert abs(both.force[2]) < 0.02 * abs(pull)
    assert np.abs([ball.force[:2], ball.torque[:2]]).max() < 0.02 * abs(pull)
    assert (summary.nonlinear, summary.bodies) == (False, ())
    assert summary.to_dict()["forces"][0]["names"] == ["ball"]


def test_flux_density_in_a_body(solution):
    (ball,) = body_fluxes(solution.at([2.0]))
    np.testing.assert_allclose(ball.mean, [0, 0, 2 * INSIDE], rtol=0.01, atol=0.01 * INSIDE)
    assert ball.mean_magnitude == pytest.approx(2 * INSIDE, rel=0.01)
    assert ball.mean_magnitude <= ball.largest_magnitude < 1.2 * ball.mean_magnitude


def test_known_values_that_hold_are_compared(device, solution):
    at_one, at_two, other_iron = compare_references(device, solution, np.array([5.0]))
    # A linear solution is compared at the currents of the reference value, not at the given currents.
    for row in (at_one, at_two):
        assert row.deviation == pytest.approx(row.ours / row.reference - 1, rel=1e-12)
        assert abs(row.deviation) < 3e-3
        assert row.why_not == ""
    assert (other_iron.ours, other_iron.deviation) == (None, None)
    assert "7" in other_iron.why_not
    at_one, at_two, _ = compare_references(device, solution, np.array([5.0]), mu_r=60.0)
    assert at_one.ours is not None
    assert at_two.ours is None


def test_a_state_is_compared_at_its_own_currents_only(device):
    solver = NonlinearSolver(device, 0.5)
    at_one, at_two, _ = compare_references(device, solver, np.array([1.0]))
    assert at_one.deviation == pytest.approx(0.0, abs=0.01)
    assert at_two.ours is None
    assert at_two.why_not
    summary = summarise_solution(device, solver, np.array([1.0]))
    assert summary.nonlinear
    assert summary.warnings == ()
    assert summary.bodies[0].mean[2] == pytest.approx(INSIDE, rel=0.02)


def test_entries_by_name():
    flux, gradient = np.array([1.0, 2.0, 3.0]), np.arange(10.0, 19.0).reshape(3, 3)
    assert [component(f"B{axis}", flux, gradient) for axis in "xyz"] == [1.0, 2.0, 3.0]
    found = [[component(f"dB{i}/d{j}", flux, gradient) for j in "xyz"] for i in "xyz"]
    np.testing.assert_array_equal(found, gradient)


def steel(initial=2500.0):
    """Straight up to 100 A/m, a fifth as steep on average up to 1000 A/m."""
    h = np.array([100.0, 1000.0])
    return fm.BHTable(
        "steel", h, initial * mu_0 * h / [1, 5], "straight line to the origin", "slope mu0", initial
    )


def test_one_permeability_of_all_iron(device):
    (ball,) = device.bodies
    other = replace(ball, name="other", material="steel")
    materials = {**device.materials, "steel": steel()}
    assert common_mu_r(device, nonlinear=False) == MU_R
    assert common_mu_r(device, nonlinear=True) == MU_R
    assert common_mu_r(device, nonlinear=True, mu_r=3.0) == 3.0
    both = replace(device, bodies=(ball, other), materials=materials)
    assert np.isnan(common_mu_r(both, nonlinear=False))
    alone = replace(device, bodies=(other,), materials=materials)
    assert common_mu_r(alone, nonlinear=False) == pytest.approx(2500.0)
    assert np.isnan(common_mu_r(alone, nonlinear=True))


def test_names_that_are_not_there_are_told_at_once(device):
    checked_groups(device, [("ball", "loop")])
    assert [section.name for section in named_sections(device, ["equator"])] == ["equator"]
    with pytest.raises(InputError) as error:
        checked_groups(device, [("ball", "bal"), ()], where="--force")
    assert [(p.where, p.received) for p in error.value.problems] == [("--force", "'bal'"), ("--force", "''")]
    assert all("ball, loop" in p.must_hold for p in error.value.problems)
    with pytest.raises(InputError) as error:
        named_sections(device, ["joint", "equator", "middle"])
    assert [p.received for p in error.value.problems] == ["'joint'", "'middle'"]
