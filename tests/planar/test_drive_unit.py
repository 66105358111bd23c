"""The planar drive unit: convergence, and the positions of its equilibria."""

from dataclasses import replace

import numpy as np
import pytest

from fieldmap.errors import InputError
from fieldmap.planar import read_planar_device, solve_planar, stationary_points

DEVICE = read_planar_device("planar_drive_unit")
CURRENTS = [(900.0, 1100.0), (800.0, 1200.0), (500.0, 1500.0)]


@pytest.fixture(scope="module")
def unit():
    return solve_planar(DEVICE)


def numbers(unit):
    positions = [stationary_points(unit, pair, -0.1, 0.0, 0.16)[0].x for pair in CURRENTS]
    positions += [
        stationary_points(unit, CURRENTS[1], -depth, -0.05, 0.16)[-1].x for depth in (0.125, 0.15, 0.2)
    ]
    at = [unit.gradient([[0.0, -0.1]], pair)[0] for pair in ((1e3, 1e3), CURRENTS[2], CURRENTS[0])]
    return np.array(positions), np.array([at[0][1, 1], at[1][1, 0], at[2][1, 0]])


def test_doubling_the_elements_moves_little_and_ever_less():
    positions, gradients = zip(
        *(numbers(solve_planar(DEVICE, size)) for size in (0.0171, 0.0085, 0.00425)), strict=True
    )
    steps = np.abs(np.diff(positions, axis=0)).max(axis=1)
    assert steps[0] < 2e-4
    assert steps[1] < 1e-4 / 2
    assert steps[0] / steps[1] > 3
    assert np.abs(gradients[2] / gradients[1] - 1).max() < 3e-3 / 3


def test_positions_and_gradients_of_finite_elements(unit):
    """Independent finite elements in the same box give 41.6, 50.0, 61.0, 17.4, 6.0, -0.7 mm, to the last digit."""
    positions, gradients = numbers(unit)
    np.testing.assert_allclose(1e3 * positions, [41.6, 50.0, 61.0, 17.4, 6.0, -0.7], rtol=0, atol=0.25)
    assert gradients[0] == pytest.approx(2.05e-3, rel=0.01)
    free = numbers(solve_planar(replace(DEVICE, walls=None)))[0]
    np.testing.assert_allclose(1e3 * free[:3], [86.8, 89.0, 93.6], rtol=0, atol=0.2)


def test_mirrored_currents_mirror_the_points(unit):
    one = stationary_points(unit, [800.0, 1200.0], -0.07, -0.165, 0.165)
    other = stationary_points(unit, [1200.0, 800.0], -0.07, -0.165, 0.165)
    assert len(one) == 3
    np.testing.assert_allclose([p.x for p in one], [-p.x for p in reversed(other)], rtol=1e-6)
    assert [p.stable for p in one] == [True, False, True]


def test_a_pair_within_one_step_is_found(unit):
    """Just above the fold the two points on the weak side are 5 mm apart; steps of 33 mm find both."""
    fine = stationary_points(unit, [800.0, 1200.0], -0.0789, -0.165, 0.165, samples=2000)
    coarse = stationary_points(unit, [800.0, 1200.0], -0.0789, -0.165, 0.165, samples=10)
    assert len(fine) == len(coarse) == 3
    assert fine[1].x - fine[0].x < 0.01
    np.testing.assert_allclose([p.x for p in coarse], [p.x for p in fine], atol=1e-8)


def test_stiffness_is_that_of_differences(unit):
    h = 1e-4
    for point in stationary_points(unit, [800.0, 1200.0], -0.07, -0.165, 0.165):
        places = [[point.x - h, -0.07], [point.x, -0.07], [point.x + h, -0.07]]
        gradient = unit.gradient(places, [800.0, 1200.0])
        slope = (gradient[2, 1, 0] - gradient[0, 1, 0]) / (2 * h)
        assert point.stiffness == pytest.approx(-np.sign(gradient[1, 1, 1]) * slope, rel=1e-4)


@pytest.mark.parametrize(
    ("points", "received"),
    [([[0.0, -0.3]], "(0, -300) mm"), ([[0.179, 0.109]], "(179, 109) mm"), ([[np.nan, 0.0]], "nan")],
)
def test_points_without_a_field(points, received):
    unit = solve_planar(DEVICE, 0.05)
    with pytest.raises(InputError) as caught:
        unit.field(points, [1.0, 1.0])
    (problem,) = caught.value.problems
    assert problem.where == "planar field(points)"
    assert received in problem.received


@pytest.mark.parametrize(
    ("call", "where"),
    [
        (lambda: solve_planar(DEVICE, size=-1.0), "solve_planar(size)"),
        (lambda: solve_planar(DEVICE, mu_r=0.0), "solve_planar(mu_r)"),
        (
            lambda: stationary_points(solve_planar(DEVICE, 0.05), [1.0, 1.0], -0.1, 0.1, -0.1),
            "stationary_points(lower, upper)",
        ),
        (lambda: solve_planar(DEVICE, 0.05).at([1.0]), "currents"),
    ],
)
def test_bad_arguments(call, where):
    with pytest.raises(InputError) as caught:
        call()
    assert [problem.where for problem in caught.value.problems] == [where]


def test_a_solution_at_currents_has_the_field_of_the_solution():
    unit = solve_planar(DEVICE, 0.05)
    points, currents = [[0.0, -0.1], [0.05, -0.07], [0.0, 0.05]], [1000.0, 800.0]
    state = unit.at({"right": 800.0, "left": 1000.0})
    assert state.coil_names == unit.coil_names
    assert np.array_equal(state.currents, currents)
    for name in ("field", "gradient", "derivatives"):
        assert np.array_equal(getattr(state, name)(points), getattr(unit, name)(points, currents))
    assert np.array_equal(unit.at(2.0).currents, [2.0, 2.0])
