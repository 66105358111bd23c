"""Scenarios of machines with any number of coils: lift and signals by least power."""

import re
from functools import cache

import numpy as np
import pytest

from fieldmap.dynamics import linear_points, prepare, read_scenario, simulate
from fieldmap.dynamics.allocation import least_power_allocation
from fieldmap.errors import Infeasible, InputError, ScenarioError
from fieldmap.levitation.lift import lift_shares
from fieldmap.lookup import open_map, wrench_actuation
from tests.conftest import DEVICES
from tests.refusals import refused

DEVICE = (DEVICES / "ring_of_coils.toml").read_text()
# The shipped scenario with depths from the origin, an earlier step, no sensor noise, and no damping of turns.
QUIET = {
    "duration_s": 1.0,
    "drag.turning_N_m_s": [0.0, 0.0, 0.0],
    "sensors.deviation_mm": [0.0, 0.0, 0.0],
    "start.depth_mm": 100,
    "reference.0.at_s": 0.3,
}
DEPTH = {"kind": "step", "axis": "depth", "at_s": 0.3, "by_mm": -1.0}
ASIDE = {"kind": "step", "axis": "x", "at_s": 0.3, "by_mm": 0.5}
STILL = {"kind": "constant"}
PIDS = {
    "control.coupled": None,
    "control.z": {"kind": "pid", "Kc": 0.5, "Ti_s": 0.5, "Td_s": 0.05},
    "control.x": STILL,
    "control.y": STILL,
}
RING = [[0.04, 0.0], [0.0, 0.04], [-0.04, 0.0], [0.0, -0.04]]


@pytest.fixture(scope="module")
def map_of(dipole_map, tmp_path_factory):
    """map_of(places, device): the bytes of a map of dipoles, cached because several tests use the same."""

    @cache
    def written(places, device):
        sources = np.column_stack([places, np.full(len(places), 0.026)])
        return dipole_map(sources, tmp_path_factory.mktemp("maps") / "some.h5", device).read_bytes()

    return written


@pytest.fixture
def some(map_of, tmp_path):
    """Write the device and a map of dipoles in place of its coils, 8 A m^2 per ampere, above the workspace; return the
    changes of the shipped scenario for both."""

    def write(places, device=DEVICE, records=True):
        device = device.replace("count = 4", f"count = {len(places)}")
        of = tuple(map(tuple, np.asarray(places).tolist()))
        (tmp_path / "some.h5").write_bytes(map_of(of, device if records else ""))
        (tmp_path / "some.toml").write_text(device)
        return {"map": str(tmp_path / "some.h5"), "device": str(tmp_path / "some.toml")} | QUIET

    return write


@pytest.mark.parametrize("turning", ["upright", "free"])
@pytest.mark.parametrize("count", [3, 4, 8])
def test_any_ring_of_coils_holds_and_moves_a_magnet(some, count, turning):
    angles = 2 * np.pi * np.arange(count) / count
    ring = some(0.04 * np.column_stack([np.cos(angles), np.sin(angles)]))
    run = simulate("hold", ring | {"body.turning": turning, "reference": [DEPTH, ASIDE]})
    assert run.event is None
    end = run.sensed[-100:]
    np.testing.assert_allclose(end, np.broadcast_to([5e-4, 0.0, -0.099], end.shape), atol=2e-5)
    assert run.outputs.shape[1] == 3
    assert run.currents.shape[1] == count
    assert any("least power" in words for words in run.assumptions)


def test_currents_at_rest_are_those_of_least_power(some):
    """Against the map's own inverse, which is independent of scenarios."""
    five = some(RING + [[0.0, 0.0]])
    experiment, opened = (
        prepare(read_scenario("hold", five | {"body.turning": "upright"})),
        open_map(five["map"]),
    )
    moment = experiment.machine.body.magnet.moment * np.array([0.0, 0.0, 1.0])
    weight = 6e-3 * 9.80665
    known = opened.currents_for([0, 0, -0.1], [0.0, 0.0, weight], moment)
    np.testing.assert_allclose(experiment.operating_point.currents, known, rtol=1e-6)
    # Lift, x and y give forces along z, x and y alone.
    force = wrench_actuation(opened, [0, 0, -0.1], moment).matrix[:3]
    made = (force @ experiment.machine.allocation.matrix)[:, [1, 2, 0]]
    np.testing.assert_allclose(made, np.diag(np.diag(made)), atol=1e-6 * made.max())
    assert (np.diag(made) > 0).all()


def test_the_linear_loop_is_stable_and_tells_what_is_held(some):
    (point,) = linear_points(prepare(read_scenario("hold", some(RING))))
    assert point.loop.stable
    assert point.linear.inputs == ("lift_V", "x_signal", "y_signal")
    np.testing.assert_allclose(np.diag(point.coupling.relative), 1.0, atol=1e-3)


def test_one_coil_holds_the_depth_and_leaves_the_rest_to_the_field(some):
    changes = some([[0.0, 0.0]]) | PIDS
    run = simulate("hold", changes)
    assert run.event is None
    assert abs(run.sensed[-1, 2] + 0.099) < 1e-4
    assert sum("does nothing" in words for words in run.assumptions) == 2
    (point,) = linear_points(prepare(read_scenario("hold", changes)))
    assert point.coupling.relative[0, 0] == 0.0


@pytest.mark.parametrize(
    ("places", "changes", "error", "where"),
    [
        ([[0.0, 0.0]], {"start.x_mm": 1.0}, ScenarioError, "start.x_mm"),
        ([[0.0, 0.0]], {"reference.0.axis": "x"}, ScenarioError, "reference.0"),
        ([[0.0, 0.0]], {"control.feedforward": {}}, ScenarioError, "control.feedforward"),
        (RING, {"control.allocation": "lift_and_directions"}, ScenarioError, "control.allocation"),
        (RING, {"field.scale": 0.05}, Infeasible, "start"),
        (RING, {"control.coupled.upper": [1.0, 1.0, 1.0]}, Infeasible, "control.coupled"),
        (RING, {"start.x_mm": 50.0}, ScenarioError, "start"),
        (RING, {"device": "drive_unit"}, ScenarioError, "map"),
    ],
)
def test_what_cannot_be_held_is_told(some, places, changes, error, where):
    with refused(error, where=f": {where}"):
        prepare(read_scenario("hold", some(places) | changes))


def test_a_start_beside_the_map_is_told_with_its_corners(some):
    ring = some(RING)
    opened = open_map(ring["map"])
    with pytest.raises(ScenarioError) as caught:
        prepare(read_scenario("hold", ring | {"start.x_mm": 50.0}))
    told = [float(v) for v in re.findall(r"-?\d+\.?\d*", caught.value.problems[0].must_hold)]
    np.testing.assert_allclose(told, 1e3 * np.concatenate([opened.lower, opened.upper]), atol=1e-3)


def test_coils_that_do_not_lift_are_told(some):
    """A dipole at (a, 0, h) above: dBz/dz on the axis vanishes where 5 h^2 = 3 (a^2 + h^2), so at a = h sqrt(2/3)."""
    height = 0.126
    aside = height * np.sqrt(2 / 3)
    with refused(Infeasible, where=": start"):
        prepare(read_scenario("hold", some([[aside, 0.0], [-aside, 0.0]])))


def test_shares_and_signals_of_a_known_matrix():
    """Two coils in a row along x, a third that only lifts: least squares by hand."""
    force = np.array([[0.1, -0.1, 0.0], [0.0, 0.0, 0.0], [0.3, 0.3, 0.3]])
    np.testing.assert_allclose(lift_shares(force), [1, 1, 1])
    allocation = least_power_allocation(force, [1, 1, 1], 3.0)
    np.testing.assert_allclose(allocation.matrix, [[1, 3, 0], [1, -3, 0], [1, 0, 0]], atol=1e-12)
    assert allocation.idle == ("y",)
    with refused(InputError, where="least_power_allocation(shares)"):
        least_power_allocation(force, [1, 1], 3.0)


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_the_shipped_scenario_takes_any_map(some, scale):
    """The start is the middle of the map if half of the 5 A carry the magnet there, else the deepest such place."""
    run = simulate("hold", {"map": some(RING)["map"], "field.scale": scale})
    assert run.event is None
    start = -1e3 * run.references[0, 2]
    assert abs(-1e3 * run.sensed[0, 2] - start) < 0.01
    assert abs(-1e3 * run.sensed[-1, 2] - (start - 1.0)) < 0.02
    if scale == 1.0:
        assert start == pytest.approx(108.0)
    else:
        # One step deeper, a twentieth of the map, takes 11 % more: the fourth power of the distance.
        assert 2.5 / 1.11 < run.currents[0].max() <= 2.5


@pytest.mark.parametrize("zero", [-10.0, 77.0])
def test_a_chosen_start_is_the_same_place_from_any_zero_of_depth(some, zero):
    """The middle of the map, z = -108 mm, read downward from z = -zero."""
    given = {"map": some(RING)["map"], "sensors.zero_depth_mm": zero}
    experiment = prepare(read_scenario("hold", given))
    assert experiment.operating_point.sensed[2] == pytest.approx(-0.108, abs=1e-9)
    assert linear_points(experiment)[0].depth_mm == pytest.approx(108.0 - zero)


def test_what_falls_on_the_shipped_map_falls_by_its_margins():
    """The shipped driver gives 3.55 A of the 5.95 A that its magnet needs. At three times the field the magnet swings,
    nearly undamped, and the loops have a gain margin below 10 %, so it falls; damping of its turns holds it."""
    sample = open_map("sample")
    with pytest.raises(Infeasible) as caught:
        simulate("hold", field_map=sample)
    # The force is proportional to the current.
    assert float(caught.value.problems[0].received.split()[0]) == pytest.approx(3.55 / 5.95, rel=1e-3)
    given = {"field.scale": 3.0}
    fallen = simulate("hold", given, field_map=sample).event
    assert fallen is not None
    assert fallen.name == "fell out"
    (point,) = linear_points(prepare(read_scenario("hold", given), sample))
    assert min(margin.gain_up for margin in point.margins) < 1.1
    assert (
        simulate("hold", given | {"drag.turning_N_m_s": [1e-5, 1e-5, 1e-5]}, field_map=sample).event is None
    )


def test_a_map_without_a_device_needs_one(some):
    with refused(ScenarioError, where=": device"):
        prepare(read_scenario("hold", {"map": some(RING, records=False)["map"]}))


@pytest.mark.parametrize("table", ["payload", "driver"])
def test_a_device_without_magnet_or_amplifiers_is_told(some, table):
    end = DEVICE.index("[driver]") if table == "payload" else len(DEVICE)
    bare = some(RING, DEVICE[: DEVICE.index(f"[{table}]")] + DEVICE[end:])
    with refused(ScenarioError, where=": device", must_hold=f"[{table}]"):
        prepare(read_scenario("hold", bare))


def test_saturating_iron_that_pushes_down_is_told(saturating):
    """Over its division the iron's field has dBz/dz < 0 on the axis."""
    given = {"device": "drive_unit", "start.depth_mm": -15.0}
    with refused(Infeasible, where=": start") as caught:
        prepare(read_scenario("hold", given), saturating())
    assert caught.value.problems[0].received.startswith("-0.")
