"""Where scenarios begin: currents, heights and limits in made-up maps; states with made-up deviations."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fieldmap.dynamics import MatrixAllocation, lift_and_directions, prepare, read_scenario
from fieldmap.dynamics.linearisation import moved_state
from fieldmap.dynamics.motion import state_of
from fieldmap.dynamics.operating_point import is_step
from fieldmap.dynamics.scenario import simulate_batches, start
from fieldmap.dynamics.scenario.controllers import Constant, Lqg, Pid
from fieldmap.dynamics.scenario.experiment import _of_axes
from fieldmap.dynamics.scenario.start import allocation_about, carrying, easy_height, floating_at
from fieldmap.errors import Infeasible, OutsideMapError, Problem, ScenarioError
from tests.refusals import refused

UP = SimpleNamespace(soft=(), moments=np.array([[0.0, 0.0, 0.8]]))
LIMITS = np.array([-2.0, -3.0]), np.array([4.0, 5.0])
LOWER, UPPER = np.array([-0.01, -0.01, -0.1434567]), np.array([0.01, 0.02, 0.0034567])


def balance(currents, along=1.0, upright=False, **more):
    """A stand-in for `WeightBalance` with these currents at a place, in a field along the z axis."""
    field = {
        "lower": LOWER,
        "upper": UPPER,
        "field": lambda *_: np.array([0.0, 0.0, along]),
        "fixed_sources": (),
    }
    body = SimpleNamespace(magnet=UP, upright=upright)
    return SimpleNamespace(field=SimpleNamespace(**field | more), body=body, limits=LIMITS, currents=currents)


@pytest.mark.parametrize("place", [(0.0101, 0.0, -0.07), (0.0, -0.0101, -0.07), (0.0, 0.0, 0.0035)])
def test_a_start_beside_the_map_is_told_with_its_corners(place):
    with refused(ScenarioError, where="here") as caught:
        carrying(balance(None), np.array(place), "here")
    (told,) = caught.value.problems
    assert told.received == f"the magnet at {[round(1e3 * p, 3) for p in place]} mm"
    assert "[-10.0, -10.0, -143.457] to [10.0, 20.0, 3.457] mm" in told.must_hold


def test_a_body_that_sticks_out_of_the_map_is_told():
    def currents(place):
        raise OutsideMapError.of("a", "b", "c", "d")

    with refused(ScenarioError, where="here"):
        carrying(balance(currents), np.zeros(3), "here")
    with refused(ScenarioError, where="here"):
        easy_height(balance(currents), 0.0, 0.0, "here")
    # The remaining heights, at which the body fits, are used.
    fits = balance(lambda place: currents(place) if place[2] > -0.1 else np.ones(2))
    assert -0.11 < easy_height(fits, 0.0, 0.0, "here") < -0.1


def test_the_height_of_a_start_is_the_nearest_to_the_middle_that_takes_half_of_the_currents():
    """Limits are 4 and 5 A upward, 2 and 3 A downward; the current grows with the distance from -60 mm."""

    def needing(amperes, lowest=-0.115):
        def currents(place):
            if place[2] < lowest:
                share = 0.5 + float(place[2])
                raise Infeasible(Problem("x", "y", f"{share:.4f}", "w"), share=share)
            return np.array([1.0, -1.0]) * (place[2] + 0.06) * amperes / 0.01

        return currents

    assert easy_height(balance(needing(0.0)), 0.0, 0.0, "") == pytest.approx(-0.07)
    # Twenty-one heights over nine tenths of the box. The larger of |i| / 4 and |i| / 3 above -60 mm, of |i| / 2 and
    # |i| / 5 below, is a half at 5 mm above and 3.3 mm below.
    room = 0.05 * (UPPER[2] - LOWER[2])
    heights = np.linspace(LOWER[2] + room, UPPER[2] - room, 21)
    share = np.where(heights > -0.06, 1.0 / 3.0, 1.0 / 2.0) * np.abs(heights + 0.06) * 300
    easy = heights[share <= 0.5]
    assert easy_height(balance(needing(3.0)), 0.0, 0.0, "") == pytest.approx(
        easy[np.abs(easy + 0.07).argmin()]
    )
    least = heights[np.abs(heights + 0.06).argmin()]
    assert easy_height(balance(needing(100.0)), 0.0, 0.0, "") == pytest.approx(least)
    # If no height is possible, the message is about the height with the largest share of the weight.
    with refused(Infeasible, where="here", received=f"{0.5 + heights[-1]:.4f}"):
        easy_height(balance(needing(1.0, lowest=1.0)), 0.0, 0.0, "here")


@pytest.mark.parametrize(("upright", "expected"), [(False, -0.02), (True, -0.07)])
def test_a_body_that_may_turn_begins_where_the_field_points_along_its_moment(upright, expected):
    """The current is small at every height; the field points up above -25 mm."""
    one = balance(lambda _: np.array([0.1, 0.1]), upright=upright)
    one.field.field = lambda place, _: np.array([0.0, 0.0, place[2] + 0.025])
    spacing = 0.9 * (UPPER[2] - LOWER[2]) / 20
    assert easy_height(one, 0.0, 0.0, "") == pytest.approx(expected, abs=spacing)
    # If the field points up nowhere, the height nearest to the middle is used.
    one.field.field = lambda *_: np.array([0.0, 0.0, -1.0])
    assert easy_height(one, 0.0, 0.0, "") == pytest.approx(-0.07)


def test_the_scale_of_the_signals():
    """The largest current over the gain; with fixed magnets the current for the weight alone."""
    force = np.array([[0.05, -0.05], [0.0, 0.0], [0.1, 0.1]])
    about = {"force_per_ampere": lambda *_: force, "weight": 0.098}
    one = SimpleNamespace(field=SimpleNamespace(fixed_sources=()), **about)
    matrix = allocation_about(one, np.zeros(3), np.array([-0.5, 0.25]), 0.4, "").matrix
    np.testing.assert_allclose(matrix[:, 0], [-1.0, 0.5])
    np.testing.assert_allclose(matrix[:, 1], [0.5 / 0.4, -0.5 / 0.4])
    beside = SimpleNamespace(field=SimpleNamespace(fixed_sources=("m",)), **about)
    matrix = allocation_about(beside, np.zeros(3), np.array([-0.5, 0.25]), 0.4, "").matrix
    np.testing.assert_allclose(matrix[:, :2], [[1.0, 0.098 / 0.2 / 0.4], [1.0, -0.098 / 0.2 / 0.4]])
    about["force_per_ampere"] = lambda *_: 0.0 * force
    with refused(Infeasible, where="here"):
        allocation_about(SimpleNamespace(field=beside.field, **about), np.zeros(3), np.ones(2), 0.4, "here")


def test_the_outputs_nearest_to_voltages():
    """A division gives back its signals; a matrix has more voltages than outputs, and an idle signal."""
    of_division = lift_and_directions(1.25)
    outputs = np.array([1.3, 0.2, -0.1])
    np.testing.assert_allclose(of_division.nearest(of_division.voltages(outputs)), outputs, atol=1e-12)
    matrix = MatrixAllocation(
        np.array([[1.0, 0.5, 0.0], [0.5, -1.0, 0.0], [0.2, 0.0, 0.0]]), np.array([0.3, 0.0, 0.0])
    )
    np.testing.assert_allclose(matrix.nearest(matrix.voltages(outputs)), [1.3, 0.2, 0.0], atol=1e-12)
    # (0.2, 0.1, -1.25) is orthogonal to both columns, so no output produces it.
    aside = matrix.voltages(outputs) + np.array([0.2, 0.1, -1.25])
    np.testing.assert_allclose(matrix.nearest(aside), [1.3, 0.2, 0.0], atol=1e-12)


def test_heights_are_solved_from_the_nearest_that_is_known(monkeypatch):
    asked = []

    def floating(machine, held, guess, near, where):
        asked.append((round(float(held[0][2]), 6), guess, float(near[2])))
        return SimpleNamespace(outputs=round(float(held[0][2]), 6), sensed=held[0])

    monkeypatch.setattr(start, "floating", floating)
    begin = SimpleNamespace(sensed=np.array([0, 0, -0.09]), outputs="begin")
    heights = [-0.08, -0.12, -0.09, -0.1]
    found = floating_at(None, (np.array([1.0, 2.0, np.nan]), np.zeros(3)), begin, heights)
    # Outward from the start at -90 mm.
    assert sorted(asked) == [(-0.12, -0.1, -0.1), (-0.1, "begin", -0.09), (-0.08, "begin", -0.09)]
    assert [one.outputs for one in found] == [-0.08, -0.12, "begin", -0.1]


def test_a_deviation_turns_a_state_about_the_bodys_own_axes():
    """By SciPy's rotations, for a rotated state; and the order of places, velocities and spins."""
    before, turn = Rotation.from_rotvec([0.5, -0.3, 0.8]), np.array([0.2, 0.4, -0.9])
    state = state_of([1.0, 2.0, 3.0], [4.0, 5.0, 6.0], before.as_quat(scalar_first=True), [7.0, 8.0, 9.0])
    names = ("y", "turn_x", "turn_y", "turn_z", "velocity_x", "velocity_z", "angular_velocity_z", "i1")
    linear = SimpleNamespace(states=names, operating_point=SimpleNamespace(state=state))
    moved = moved_state(linear, [0.1, *turn, 0.2, 0.3, 0.4, 99.0])
    np.testing.assert_allclose(moved[:6], [1.0, 2.1, 3.0, 4.2, 5.0, 6.3])
    np.testing.assert_allclose(moved[10:], [7.0, 8.0, 9.4])
    found = Rotation.from_quat(moved[6:10], scalar_first=True)
    np.testing.assert_allclose(
        found.as_matrix(), (before * Rotation.from_rotvec(turn)).as_matrix(), atol=1e-12
    )


@pytest.mark.parametrize(("slope", "step"), [(0.9e-2, True), (1.1e-2, False)])
def test_a_step_over_zero_is_told_from_a_fold(slope, step):
    """With slope 1 the residual would vanish within 0.01; the second of two unknowns is at rest."""
    assert is_step(lambda x: np.array([x[0] + slope, 2.0 * x[1]]), np.zeros(2)) is step
    assert not is_step(lambda x: np.array([0.0 * x[0], 1.0]), np.zeros(2))


def test_each_axis_has_its_controller_and_its_unit():
    point = SimpleNamespace(sensed=np.array([0.001, 0.002, -0.09]), outputs=np.array([3.0, 0.1, -0.2]))
    block = _of_axes((Pid(2.0), Pid(3.0), Pid(5.0)), point, 2e-3, 0.077)
    # Lift, x and y from their references, per mm; depth counts downward.
    np.testing.assert_allclose(block.D[:, :3], 1e3 * np.array([[0, 0, 2.0], [3.0, 0, 0], [0, 5.0, 0]]))
    np.testing.assert_allclose(block.D[:, 3:6], -block.D[:, :3])
    three = (Constant(1.5), None, Constant(None))
    held = _of_axes(three, point, 2e-3, 0.077)
    np.testing.assert_allclose(held.D[:, 6], [1.5, -0.2])


@pytest.fixture(scope="module")
def still(six):
    quiet = {"drag.linear_N_s_per_m": [0.5] * 3, "reference.0.by_mm": 0.0, "noise.off": True}
    return prepare(read_scenario("vertical_step", quiet), six)


def test_designs_over_depths_rise_evenly_from_the_deepest(still):
    machine, point, asked = still.machine, still.operating_point, []

    def points_at(heights):
        asked.extend(heights)
        return [replace(point, sensed=np.array([0.0, 0.0, height])) for height in heights]

    lqg = Lqg(depths=(0.004, 0.01), designs=3)
    found = lqg.controller(machine, point, points_at, 2e-3, 0.0)
    zero = machine.sensors.zero_depth
    np.testing.assert_allclose(asked, [-0.01 - zero, -0.007 - zero, -0.004 - zero])
    assert (found.first, found.step) == (pytest.approx(-0.01 - zero), pytest.approx(0.003))
    alone = Lqg().controller(machine, point, points_at, 2e-3, 0.0)
    np.testing.assert_array_equal(found.blocks[0].memory, alone.memory)
    assert len(asked) == 3
    # The outputs at the operating point must lie within the limits, ends included.
    at = point.outputs
    Lqg(lower=at, upper=at + 1.0).prepared(machine, point)
    for lower, upper in ((at + [0, 0, 1e-6], at + 1.0), (at - 1.0, at - [1e-6, 0, 0])):
        with pytest.raises(Infeasible) as caught:
            Lqg(lower=lower, upper=upper).prepared(machine, point)
        told = caught.value.problems[0]
        assert told.received == f"{at[0]:.3g} V, {at[1]:.3g}, {at[2]:.3g}"
        assert f"{lower.tolist()} to {upper.tolist()}" in told.must_hold


def test_batches_tell_how_far_they_are(still, six):
    told = []
    simulate_batches(
        "vertical_step", lambda: six, {"duration_s": 0.01}, {"control.z.Kc": [0.4, 0.5]}, runs=2, threads=1,
        progress=lambda *given: told.append(given),
    )  # fmt: skip
    words = [f"control.z.Kc = {kc} run {k} of 2" for kc in (0.4, 0.5) for k in (1, 2)]
    assert told == list(zip(words, (0.25, 0.5, 0.75, 1.0), strict=True))
