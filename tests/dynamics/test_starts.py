"""Where scenarios begin: currents, heights and limits by made-up maps; states turned by made-up deviations."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fieldmap.currents import IndependentCurrents
from fieldmap.dynamics import prepare, read_scenario
from fieldmap.dynamics.linearisation import moved_state
from fieldmap.dynamics.motion import state_of
from fieldmap.dynamics.operating_point import is_step
from fieldmap.dynamics.scenario import simulate_batches, start
from fieldmap.dynamics.scenario.controllers import Constant, Lqg, Pid
from fieldmap.dynamics.scenario.experiment import _of_axes
from fieldmap.dynamics.scenario.start import Lift, floating_at, outputs_near
from fieldmap.errors import Infeasible, NotConverged, Problem, ScenarioError
from tests.refusals import refused

UP = SimpleNamespace(soft=(), moment=0.8, moments=np.array([[0.0, 0.0, 0.8]]))
BODY = SimpleNamespace(mass=0.01, gravity=9.8, magnet=UP, upright=False)
LIMITS = np.array([-2.0, -3.0]), np.array([4.0, 5.0])


def lift(opened=None, body=BODY, scale=0.5, divided=False):
    box = {"lower": np.array([-0.01, -0.02, -0.1234567]), "upper": np.array([0.01, 0.02, -0.05])}
    about = {"coil_names": ("a", "b"), "fixed_sources": (), "parametrisation": None, "info": None}
    return Lift(SimpleNamespace(**(about | box | (opened or {}))), None, body, scale, LIMITS, divided)


@pytest.mark.parametrize("place", [(0.0101, 0.0, -0.07), (0.0, -0.0201, -0.07), (0.0, 0.0, -0.0499)])
def test_a_start_beside_the_map_is_told_with_its_corners(place):
    with pytest.raises(ScenarioError) as caught:
        lift().currents(np.array(place))
    (told,) = caught.value.problems
    assert told.received == f"the magnet at {[round(1e3 * p, 3) for p in place]} mm"
    assert "[-10.0, -20.0, -123.457] to [10.0, 20.0, -50.0] mm" in told.must_hold


@pytest.mark.parametrize("fails", [0, 1, 2, 3])
def test_currents_for_soft_iron_drop_one_condition_after_the_other(fails):
    """No horizontal force and nine tenths of the limits, in the map's own currents; no limits; any horizontal force."""
    asked, body = [], replace_of(BODY, magnet=SimpleNamespace(soft=("bead",), moments=np.zeros((0, 3))))

    def currents_for(point, force, magnet, limits):
        asked.append((force.tolist(), None if limits is None else np.array(limits).tolist()))
        if len(asked) <= fails:
            error = (Infeasible, NotConverged)[len(asked) % 2]
            raise error(Problem("map", f"must hold {len(asked)}", "r", "m"))
        return np.array([1.0, 2.0])

    one = lift({"currents_for": currents_for}, body)
    if fails == 3:
        with refused(Infeasible, must_hold="must hold 3"):
            one._for_soft_iron(np.zeros(3))
    else:
        np.testing.assert_allclose(one._for_soft_iron(np.zeros(3)), [2.0, 4.0])
    held = [[-0.9, -1.35], [1.8, 2.25]]
    weight = pytest.approx(0.098)
    expected = [([0.0, 0.0, weight], pytest.approx(np.array(held))), ([0.0, 0.0, weight], None)]
    for (force, limits), (wanted, within) in zip(asked, expected, strict=False):
        assert force == wanted
        assert (limits is None) is (within is None)
        if limits is not None:
            np.testing.assert_allclose(limits, held)
    if len(asked) > 2:
        assert np.isnan(asked[2][0][:2]).all()
        assert (asked[2][0][2], asked[2][1]) == (weight, None)


def replace_of(namespace, **changes):
    return SimpleNamespace(**(vars(namespace) | changes))


def test_the_height_of_a_start_is_the_nearest_to_the_middle_that_takes_half_of_the_currents(monkeypatch):
    """4 and 5 A last upward, 2 and 3 A downward; what a height takes grows with its distance from -60 mm."""
    box = {"lower": np.array([-0.01, -0.01, -0.14]), "upper": np.array([0.01, 0.01, 0.0])}

    def currents(self, point):
        if point[2] < -0.115:
            raise Infeasible.of("x", "y", "z", "w")
        return np.array([1.0, -1.0]) * (point[2] + 0.06) * scale[0] / 0.01

    along = {"field": lambda point, amperes: np.array([0.0, 0.0, 1.0])}
    monkeypatch.setattr(Lift, "currents", currents)
    scale = [0.0]
    one = lift(box | along)
    # Twenty-one heights over nine tenths of the box.
    heights = np.linspace(-0.14 + 0.007, -0.007, 21)
    assert one.height(0.0, 0.0) == pytest.approx(-0.07)
    scale[0] = 3.0
    # The worse of |i| / 4 and |i| / 3 above -60 mm, of |i| / 2 and |i| / 5 below: half at 5 mm above, 3.3 mm below.
    share = np.where(heights > -0.06, 1.0 / 3.0, 1.0 / 2.0) * np.abs(heights + 0.06) * 300
    easy = heights[share <= 0.5]
    assert one.height(0.0, 0.0) == pytest.approx(easy[np.abs(easy + 0.07).argmin()])
    scale[0] = 100.0
    least = heights[np.abs(heights + 0.06).argmin()]
    assert one.height(0.0, 0.0) == pytest.approx(least)
    # A moment against the field would turn over; of a body that stays upright it may.
    against = lift(box | {"field": lambda point, amperes: np.array([0.0, 0.0, -1.0])})
    assert against.height(0.0, 0.0) == pytest.approx(-0.07)
    upright = replace(against, body=replace_of(BODY, upright=True))
    assert upright.height(0.0, 0.0) == pytest.approx(least)


@pytest.mark.parametrize(("fixed", "expected"), [((), 0.5), (("magnet",), -1.5)])
def test_equal_currents_on_saturating_iron_beside_what_no_current_drives(monkeypatch, fixed, expected):
    """dBz/dz = 2 g (i + off): levels from 0.3 to 3 A, or from -3 to 3 where a magnet lifts as well."""
    monkeypatch.setattr(start, "division_domain", lambda _: None)
    needed = 0.098 / (0.8 * 0.5)
    opened = {
        "fixed_sources": fixed,
        "parametrisation": IndependentCurrents(2),
        "info": SimpleNamespace(
            reduced_model=SimpleNamespace(lower=np.array([-3.0, -4.0]), upper=np.array([3.0, 5.0]))
        ),
        "gradient": lambda _, amperes: np.diag([0.0, 0.0, needed * (1.0 + amperes[0] - expected)]),
    }
    np.testing.assert_allclose(lift(opened)._equal(np.zeros(3)), [expected, expected], rtol=1e-9)
    # A field that falls with the currents: the same level, from the other end.
    if fixed:
        falls = opened | {"gradient": lambda _, i: np.diag([0.0, 0.0, needed * (1.0 - i[0] + expected)])}
        np.testing.assert_allclose(lift(falls)._equal(np.zeros(3)), [expected, expected], rtol=1e-9)
    weak = opened | {"gradient": lambda _, amperes: np.diag([0.0, 0.0, 0.01 * needed * amperes[0]])}
    with pytest.raises(Infeasible) as caught:
        lift(weak)._equal(np.zeros(3))
    assert caught.value.problems[0].received == "0.03 of the weight at most"
    assert ("-3" in caught.value.problems[0].must_hold) is bool(fixed)
    assert "to 3 A" in caught.value.problems[0].must_hold


def test_currents_of_least_power_carry_what_the_magnets_leave(monkeypatch):
    force = np.array([[0.1, -0.1], [0.0, 0.0], [0.2, 0.2]])
    monkeypatch.setattr(start, "force_per_ampere", lambda *_: force)
    one = lift({"constant_gradient": lambda _: np.diag([0.0, 0.0, 0.03])})
    # 0.5 of 0.4 N/A of both coils with 1 A each; the magnets carry 0.5 0.8 0.03 N where they count.
    np.testing.assert_allclose(one._least_power(np.zeros(3)), [0.098 / 0.2] * 2)
    beside = lift({"constant_gradient": lambda _: np.diag([0.0, 0.0, 0.03]), "fixed_sources": ("m",)})
    np.testing.assert_allclose(beside._least_power(np.zeros(3)), [(0.098 - 0.012) / 0.2] * 2)
    # The scale of the signals: the largest current over the gain, or that of the weight alone beside magnets.
    matrix = one.allocation(np.zeros(3), np.array([0.5, 0.25]), 0.4).matrix
    np.testing.assert_allclose(matrix[:, 0], [1.0, 0.5])
    np.testing.assert_allclose(matrix[:, 1], [0.5 / 0.4, -0.5 / 0.4])
    matrix = beside.allocation(np.zeros(3), np.array([0.5, 0.25]), 0.4).matrix
    np.testing.assert_allclose(matrix[:, :2], [[1.0, 0.098 / 0.2 / 0.4], [1.0, -0.098 / 0.2 / 0.4]])


def test_the_first_guess_of_the_outputs():
    allocation = SimpleNamespace(voltages=lambda outputs: outputs[0] * np.array([1.0, 0.5]))
    machine = SimpleNamespace(
        allocation=allocation, drive=SimpleNamespace(amplifier=SimpleNamespace(gain=0.4))
    )
    plain, beside = SimpleNamespace(fixed_sources=()), SimpleNamespace(fixed_sources=("m",))
    currents = np.array([-2.0, 1.0])
    assert outputs_near(machine, plain, currents) == [5.0, 0.0, 0.0]
    # The projection on the lift's currents, which may pull down.
    assert outputs_near(machine, beside, currents) == pytest.approx([-1.5 / 1.25 / 0.4, 0.0, 0.0])


def test_heights_are_solved_from_the_nearest_that_is_known(monkeypatch):
    asked = []

    def floating(machine, held, guess):
        asked.append((round(float(held[0][2]), 6), guess))
        return SimpleNamespace(outputs=round(float(held[0][2]), 6))

    monkeypatch.setattr(start, "floating", floating)
    begin = SimpleNamespace(sensed=np.array([0, 0, -0.09]), outputs="begin")
    heights = [-0.08, -0.12, -0.09, -0.1]
    found = floating_at(None, (np.array([1.0, 2.0, np.nan]), np.zeros(3)), begin, heights)
    # Outward from the start at -90 mm.
    assert sorted(asked) == [(-0.12, -0.1), (-0.1, "begin"), (-0.08, "begin")]
    assert [one.outputs for one in found] == [-0.08, -0.12, "begin", -0.1]


def test_a_deviation_turns_a_state_about_the_bodys_own_axes():
    """SciPy's rotations, of a state that is turned already; and the order of places, velocities and spins."""
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
    """By a slope that is 1 it would vanish within 0.01; of two unknowns, of which the second is at rest."""
    assert is_step(lambda x: np.array([x[0] + slope, 2.0 * x[1]]), np.zeros(2)) is step
    assert not is_step(lambda x: np.array([0.0 * x[0], 1.0]), np.zeros(2))


def test_each_axis_has_its_controller_and_its_unit():
    point = SimpleNamespace(sensed=np.array([0.001, 0.002, -0.09]), outputs=np.array([3.0, 0.1, -0.2]))
    block = _of_axes((Pid(2.0), Pid(3.0), Pid(5.0)), point, 2e-3, 0.077)
    # Lift, x and y by their references: per mm, and the depth downward.
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
