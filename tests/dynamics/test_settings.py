"""The tables of a scenario: bodies, drives, held places, numerical limits; and linear models in files."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.currents import LiftAndDirections
from fieldmap.device.model import Driver
from fieldmap.dynamics import Sensors, linear_points, prepare, read_scenario
from fieldmap.dynamics.scenario import experiment, schema
from fieldmap.dynamics.scenario.controllers import Constant, FeedbackLinearisation, Pid
from fieldmap.dynamics.scenario.experiment import _lift_and_directions
from fieldmap.dynamics.scenario.linear_points import Linearisation, coupling_signals, loop_poles
from fieldmap.dynamics.scenario.references import MOST_PERIODS, Circle, Step
from fieldmap.dynamics.scenario.schema import (
    BodySettings,
    CoilSettings,
    ControlSettings,
    FieldSettings,
    Settings,
    Start,
)
from fieldmap.errors import InputError, ScenarioError
from tests.refusals import refused

PAYLOAD = fm.Payload(0.02, magnet=fm.MagnetCylinder(0.01, 0.012, 1.2), magnet_offset=0.007)


def test_a_body_of_its_keys():
    """A cylinder of 12 x 40 mm from 5 mm below the magnet's centre; the centre of mass is 2 mm above that centre."""
    body = BodySettings("upright", 0.006, 0.04, 0.005, 0.002, 0.009).body(PAYLOAD, None)
    assert body.upright
    np.testing.assert_allclose([body.magnet_at[2], body.seen_at[2]], [-0.002, 0.007])
    np.testing.assert_allclose(np.unique(body.skin[:, 2].round(12)), [-0.007, 0.033])
    np.testing.assert_allclose(np.hypot(*body.skin[:, :2].T), 0.006)
    m = 0.02
    np.testing.assert_allclose(body.inertia, [m * (9e-6 + 0.04**2 / 12)] * 2 + [m * 18e-6])
    plain = BodySettings().body(PAYLOAD, None)
    assert (plain.upright, plain.seen_at[2], len(plain.magnet.points)) == (False, 0.007, 1)
    with refused(ScenarioError, where="body.finite_magnet"):
        BodySettings(finite_magnet=True).body(fm.Payload(0.02, moment=0.8), None)


def test_a_drive_of_its_keys():
    coil = fm.CircularCoil("a", 0.01, 0.02, 0.01, 100, resistance=1.5, inductance=2e-3)
    device = SimpleNamespace(coils=[coil], driver=Driver(0.5, 3.0, 24.0))
    drive = CoilSettings(True, -5.0, 3e-3, 0.02, 12, 8.0).drive(device)
    assert (drive.supply, drive.time_constant, drive.amplifier.deviation) == ((-5.0, 24.0), 3e-3, 0.02)
    assert (drive.converter.range, drive.converter.bits) == (8.0, 12)
    assert (drive.resistance.tolist(), drive.inductance.tolist()) == ([1.5], [2e-3])
    plain = CoilSettings(dynamics=False).drive(device)
    assert (plain.resistance, plain.inductance, plain.converter) == (None, None, None)
    assert (plain.amplifier.deviation, plain.time_constant) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("given", "iron", "saturating"),
    [
        ({}, "modelled", True),
        ({"iron": "model", "table": (4, 4, 4)}, "modelled", True),
        ({"iron": "table"}, "tabled", True),
        ({"table": (4, 5, 6)}, "tabled", True),
        ({"iron": "table"}, "modelled", False),
        ({"iron": "linearised", "table": (4, 4, 4)}, "linearised", True),
    ],
)
def test_how_the_iron_is_treated(monkeypatch, given, iron, saturating):
    monkeypatch.setattr(schema, "saturates", lambda opened: saturating)
    for name in ("linearised", "modelled", "tabled"):
        monkeypatch.setattr(schema, name, lambda *about, name=name: (name, *about))
    table = given.get("table")
    more = {"linearised": ("currents",), "modelled": (), "tabled": (table,)}[iron]
    found = FieldSettings(1.25, **given).field("map", "currents")
    assert found == (iron, "map", *more, 1.25, None)


def settings(control=None, **more):
    pids = {"z": Pid(1.0), "x": Constant(0.3), "y": Constant()}
    control = ControlSettings(**(pids if control is None else control))
    return Settings("t", "m", control, 1.0, **more)


def test_places_and_outputs_that_are_held():
    """A given place is held; otherwise the output of a constant controller, or zero."""
    place, outputs = settings().held()
    np.testing.assert_array_equal(place, [np.nan] * 3)
    np.testing.assert_array_equal(outputs, [np.nan, 0.3, 0.0])
    stated = settings(start=Start(0.004, y=-0.002), sensors=Sensors(zero_depth=0.07))
    place, outputs = stated.held()
    np.testing.assert_allclose(place, [np.nan, -0.002, -0.074], rtol=1e-12)
    np.testing.assert_array_equal(outputs, [np.nan, 0.3, np.nan])
    assert stated.height(0.001) == pytest.approx(-0.071)


IDLE = {
    "nothing is asked of it": (settings(), None),
    "a constant alone": (settings({"z": Pid(1.0), "x": Constant(), "y": Pid(1.0)}), None),
    "a controller": (settings({"z": Pid(1.0), "x": Pid(1.0), "y": Constant()}), ("control.x", "pid")),
    "a place": (settings(start=Start(x=0.0025)), ("start.x_mm", "2.5 mm")),
    "a place of the other axis": (settings(start=Start(y=0.0025)), None),
    "a reference": (settings(reference=(Step("y", 0.0, 1e-3), Step("x", 0.0, 1e-3))), ("reference.1", "")),
    "a circle": (settings(reference=(Circle(1e-3, 1.0),)), ("reference.0", "")),
    "forces": (settings({"coupled": FeedbackLinearisation()}), ("control.coupled", "")),
}


@pytest.mark.parametrize(("given", "told"), IDLE.values(), ids=IDLE)
def test_what_is_asked_of_an_axis_along_which_nothing_pushes(given, told):
    given.refuse_idle(())
    if told is None:
        given.refuse_idle(("x",))
        return
    with pytest.raises(ScenarioError) as caught:
        given.refuse_idle(("x",))
    (problem,) = caught.value.problems
    assert problem.where == told[0]
    assert problem.received.endswith(told[1])
    assert "along x" in problem.must_hold + problem.received or "x, y and z" in problem.must_hold


@pytest.mark.parametrize(
    ("changes", "where"),
    [
        ({"control.step_ms": 2e-6}, None),
        ({"control.step_ms": 1.9e-6}, "control.step_ms"),
        ({"duration_s": 2e-3 * MOST_PERIODS}, None),
        ({"duration_s": 2e-3 * MOST_PERIODS + 0.01}, "duration_s"),
        ({"disturbance": [{"force_mN": [0, 0, 1], "from_s": 1.0, "until_s": 1.0}]}, "until_s"),
        ({"disturbance": [{"force_mN": [0, 0, 1], "from_s": 1.0, "until_s": 1.001}]}, None),
        ({"control.z.upper": 0.0, "control.z.lower": 0.0}, "control.z.upper"),
        ({"control.z.upper": 0.1, "control.z.lower": 0.0}, None),
        ({"field.table": [4, 4, 3]}, "field.table.3"),
        ({"noise.seed": -1}, "noise.seed"),
        ({"record.every": 0}, "record.every"),
    ],
)
def test_limits_of_keys(changes, where):
    if where is None:
        read_scenario("vertical_step", changes)
        return
    with pytest.raises(InputError) as caught:
        read_scenario("vertical_step", changes)
    assert any(f"{problem.where}.".endswith(f"{where}.") for problem in caught.value.problems), [
        problem.where for problem in caught.value.problems
    ]


SIX, THREE = (SimpleNamespace(coil_names=tuple("123456"[:n]), parametrisation=None) for n in (6, 3))
OWN = SimpleNamespace(coil_names=SIX.coil_names, parametrisation=LiftAndDirections(1.4))


@pytest.mark.parametrize(
    ("opened", "allocation", "n", "found"),
    [
        (SIX, None, None, None),
        (SIX, None, 1.25, None),
        (OWN, "least_power", 1.25, None),
        (OWN, None, None, 1.4),
        (OWN, None, 1.25, 1.25),
        (OWN, "lift_and_directions", None, 1.4),
        (SIX, "lift_and_directions", 1.25, 1.25),
        (SIX, "lift_and_directions", None, ("control.allocation_n", "none")),
        (THREE, "lift_and_directions", 1.25, ("control.allocation", "a map of 3 coils")),
    ],
)
def test_the_allocation_that_is_named_or_that_the_map_was_made_for(opened, allocation, n, found):
    if isinstance(found, tuple):
        with refused(ScenarioError, where=found[0], received=found[1]):
            _lift_and_directions(opened, allocation, n)
    else:
        got = _lift_and_directions(opened, allocation, n)
        assert (None if got is None else got.parametrisation.n) == found


def test_a_map_is_looked_for_beside_the_scenario_and_among_the_maps(monkeypatch, tmp_path):
    """Next to the scenario first, then in the working directory, then in maps/out, with or without its ending."""
    monkeypatch.setattr(experiment, "open_map", lambda path, outside_currents: (path, outside_currents))
    monkeypatch.chdir(tmp_path)
    folder, out = tmp_path / "scenarios", tmp_path / "maps" / "out"
    folder.mkdir()
    out.mkdir(parents=True)
    with refused(ScenarioError, where="map", received='"some"', remedy="fieldmap map some"):
        experiment._open_map(folder, "some")
    for place, name in (
        (out / "some.h5", "maps/out/some.h5"),
        (out / "some", "maps/out/some"),
        (tmp_path / "some", "some"),
    ):
        place.write_text("")
        found, beyond = experiment._open_map(folder, "some")
        assert (found.as_posix(), beyond) == (name, "evaluate")
    (folder / "some").write_text("")
    assert experiment._open_map(folder, "some")[0] == folder / "some"


@pytest.mark.parametrize("table", ["payload", "driver"])
@pytest.mark.parametrize("named", [True, False])
def test_a_device_without_magnet_or_amplifiers(monkeypatch, tmp_path, table, named):
    """If the device is the one recorded in the map, the remedy names a device file; a map of other coils is refused."""
    device = fm.read_device("drive_unit")
    monkeypatch.setattr(experiment, "sampled_field", lambda field: field)
    monkeypatch.setattr(experiment, "read_device", lambda path: bare)
    (tmp_path / "some.toml").write_text("")
    bare = replace(device, **{table: None})
    about = tmp_path, "map", "some.toml" if named else None, SIX, None if named else bare
    with refused(ScenarioError, where="device", must_hold=f"[{table}]") as caught:
        experiment._device_and_map(*about)
    assert ("--set device=FILE.toml" in caught.value.problems[0].remedy) is not named
    bare = device
    assert experiment._device_and_map(tmp_path, "map", None, SIX, device) == (device, SIX)
    with refused(ScenarioError, where="map", received="3 coils", must_hold="device's 6 coils"):
        experiment._device_and_map(tmp_path, "map", None, THREE, device)
    with refused(ScenarioError, where="device", received='"none.toml"'):
        experiment._device_and_map(tmp_path, "map", "none.toml", SIX, None)


@pytest.mark.parametrize(
    ("feedforward", "signals", "gives", "where"),
    [
        (True, False, "signals", "control.feedforward"),
        (False, True, "currents", "signal"),
        (False, True, "signals", None),
        (False, False, "voltages", None),
    ],
)
def test_keys_beside_a_function(feedforward, signals, gives, where):
    about = SimpleNamespace(gives=gives), feedforward, signals
    if where is None:
        experiment._refuse_beside(*about)
    else:
        with refused(ScenarioError, where=where):
            experiment._refuse_beside(*about)


def test_the_drags_of_payload_and_scenario_add_up(six):
    device = fm.read_device("drive_unit")
    device = replace(device, payload=replace(device.payload, drag=0.3))
    for given, linear in (([0.0] * 3, [0.3] * 3), ([0.1, 0.2, 0.5], [0.4, 0.5, 0.8])):
        scenario = read_scenario("vertical_step", {"drag.linear_N_s_per_m": given})
        machine = prepare(scenario, six, device).machine
        np.testing.assert_allclose(machine.drag.linear, linear, rtol=1e-15)
        assert machine.drag.turning == scenario.settings.drag.turning


@pytest.fixture(scope="module")
def linear(six):
    given = {"drag.linear_N_s_per_m": [0.5] * 3, "reference.0.by_mm": 0.0, "start.depth_mm": 12.0}
    ready = prepare(read_scenario("vertical_step", given), six)
    return Linearisation(ready, tuple(linear_points(ready, [10.0, 12.0])))


def test_linear_models_at_depths(linear):
    low, high = linear.points
    zero = linear.experiment.machine.sensors.zero_depth
    for point, depth in ((low, 10.0), (high, 12.0)):
        assert point.depth_mm == depth
        assert point.linear.operating_point.sensed[2] == pytest.approx(-zero - 1e-3 * depth, abs=1e-9)
        poles = loop_poles(point)
        assert (np.diff(poles.real) <= 1e-9 * np.abs(poles).max()).all()
        there = np.exp(poles * point.loop.period)
        known = point.loop.poles
        assert max(np.abs(known - z).min() for z in there) < 1e-9
        assert len(there) == (np.abs(known) > 1e-6).sum()
    # By default only the start.
    (alone,) = linear_points(linear.experiment)
    assert alone.depth_mm == 12.0
    assert linear.stable is all(point.loop.stable for point in linear.points)
    unstable = replace(high, loop=replace(high.loop, A=2.0 * high.loop.A))
    assert not replace(linear, points=(low, unstable)).stable
    assert coupling_signals(low) == ("x_signal", "y_signal", "lift_V")
    other = replace(low, linear=replace(low.linear, inputs=("a", "b", "c")))
    assert coupling_signals(other) == ("a", "b", "c")


def test_linear_models_in_files(linear, tmp_path):
    whole = json.loads(linear.write(tmp_path / "some.json").read_text())
    point = linear.points[1]
    told, machine = whole["points"][1], point.linear
    assert (whole["states"], whole["inputs"]) == (list(machine.states), list(machine.inputs))
    assert (told["depth_mm"], told["loop"]["period_s"]) == (12.0, point.loop.period)
    for name in "ABCDG":
        np.testing.assert_array_equal(told[name], getattr(machine, name))
    for name in "ABC":
        np.testing.assert_array_equal(told["loop"][name], getattr(point.loop, name))
    np.testing.assert_array_equal(told["rest"]["currents"], machine.operating_point.currents)
    assert told["loop"]["poles"] == [[p.real, p.imag] for p in loop_poles(point)]
    assert [one["pole"] for one in told["modes"]] == [[m.pole.real, m.pole.imag] for m in point.modes]
    assert told["modes"][0]["frequency_Hz"] == point.modes[0].frequency
    assert told["coupling"]["signals"] == ["x_signal", "y_signal", "lift_V"]
    assert told["controllability"] == point.controllability.controllability
    arrays = np.load(linear.write(tmp_path / "some.npz"))
    assert arrays["depth_mm"].tolist() == [10.0, 12.0]
    for k, one in enumerate(linear.points):
        np.testing.assert_array_equal(arrays["A"][k], one.linear.A)
        np.testing.assert_array_equal(arrays["loop_A"][k], one.loop.A)
        np.testing.assert_array_equal(arrays["rest_state"][k], one.linear.operating_point.state)
    assert arrays["states"].tolist() == list(machine.states)
    assert arrays["period_s"] == point.loop.period
