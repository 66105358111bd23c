"""Scenario files: reading, refusals, runs, and written files."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import fieldmap as fm
from fieldmap.currents import LiftAndDirections
from fieldmap.dynamics import MatrixAllocation, Sensors, prepare, read_scenario, run_metrics, simulate
from fieldmap.dynamics.motion import state_of
from fieldmap.dynamics.scenario import reading_mm
from fieldmap.dynamics.scenario.experiment import _begin
from fieldmap.dynamics.scenario.metrics import _step
from fieldmap.dynamics.scenario.references import control_times, references
from fieldmap.errors import Infeasible, InputError, ScenarioError
from fieldmap.shipped import shipped_names
from tests.refusals import refused

TEXT = (Path(__file__).parents[1] / "scenarios" / "step.toml").read_text()


@pytest.mark.parametrize("name", shipped_names("maps", "scenarios"))
def test_shipped_scenarios_are_right(name):
    scenario = read_scenario(name.removeprefix("scenarios/"))
    assert scenario.contents.title
    assert wanted_of(scenario).shape[1] == 3


def wanted_of(scenario):
    """References of x, y and depth in mm of a scenario that starts at a depth of 10 mm."""
    given, period = scenario.settings, scenario.settings.control.period
    time = control_times(given.duration, period)
    start_at = np.array([0.0, 0.0, 1e-2])
    return 1e3 * references(given.reference, given.control.compensator, start_at, time, period)


def test_all_mistakes_of_a_file_are_told_at_once_with_their_lines(written):
    text = TEXT.replace("Kc = 0.5", 'Kc = "much"').replace("depth_mm = 10.0", "depth = 10.0")
    text = text.replace('axis = "depth"', 'axis = "z"').replace("duration_s = 1.0", "duration_s = -1.0")
    with pytest.raises(ScenarioError) as caught:
        read_scenario(written(text))
    told = [problem.where for problem in caught.value.problems]
    lines = text.splitlines()
    for words, key in [
        ("duration_s", "duration_s ="),
        ("control.z.Kc", "Kc ="),
        ("start.depth", "depth = 10"),
        ("reference.1.axis", "axis ="),
    ]:
        number = next(n for n, line in enumerate(lines, 1) if line.startswith(key))
        assert any(words in text and f":{number}: " in text for text in told), (words, told)
    assert any("depth_mm" in problem.remedy for problem in caught.value.problems)


def test_a_finite_magnet_fills_its_cylinder_and_needs_one():
    """Dipoles about the magnet's centre: their moments sum to the magnet's, and their mean square distance on the axis
    is the cylinder's, h^2 / 12."""
    finite = read_scenario("hold", {"body.finite_magnet": True})
    device, opened = fm.read_device("drive_unit"), fm.open_map("sample")
    payload = device.payload
    magnet = finite.settings.body.body(payload, opened).magnet
    assert len(magnet.points) > 1
    np.testing.assert_allclose(magnet.moments.sum(axis=0), [0.0, 0.0, payload.moment], atol=1e-12)
    share = magnet.moments[:, 2] / payload.moment
    assert share @ magnet.points[:, 2] ** 2 == pytest.approx(payload.magnet.height**2 / 12, rel=1e-9)
    assert len(read_scenario("hold").settings.body.body(payload, opened).magnet.points) == 1
    bare = replace(device, payload=replace(payload, magnet=None))
    with refused(ScenarioError, where="body.finite_magnet"):
        prepare(finite, opened, bare)


def test_a_start_shifts_moves_and_leans_what_may_be_turned_already(written):
    """SciPy's rotation about the map's x axis, after the rotation of the operating point."""
    given = {
        "start.shift_mm": [1.0, 2.0, 3.0],
        "start.velocity_mm_per_s": [4.0, 5.0, 6.0],
        "start.lean_deg": 40.0,
    }
    scenario = read_scenario(written(), given)
    before = Rotation.from_rotvec([0.3, -0.5, 0.7])
    quaternion = before.as_quat(scalar_first=True)
    state = state_of([0.1, 0.2, -0.1], [0.0, 0.0, 0.0], quaternion, [7.0, 8.0, 9.0])
    start = _begin(scenario.settings.start, SimpleNamespace(state=state))
    np.testing.assert_allclose(start[:6], [0.101, 0.202, -0.103, 4e-3, 5e-3, 6e-3], rtol=1e-12)
    turned = Rotation.from_quat(start[6:10], scalar_first=True)
    expected = Rotation.from_euler("x", 40.0, degrees=True) * before
    np.testing.assert_allclose(turned.as_matrix(), expected.as_matrix(), atol=1e-12)
    assert start[10:].tolist() == [7.0, 8.0, 9.0]


@pytest.mark.parametrize(
    ("old", "new", "where"),
    [
        ("format = 1", "format = 2", ": format"),
        ('kind = "pid"', 'kind = "pdi"', ": control."),
        ("lower = 0.0", "lower = 11.0", ": control."),
        ('device = "drive_unit"', 'device = "no_unit"', ": device"),
        ('map = "six.h5"', 'map = "none.h5"', ": map"),
        ("depth_mm = 10.0", "depth_mm = 90.0", ": start"),
        ("delay_ms = 0.5", "delay_ms = 0.55", "Schedule(step)"),
    ],
)
def test_what_cannot_be_is_refused(written, old, new, where):
    with pytest.raises(InputError) as error:
        prepare(read_scenario(written(TEXT.replace(old, new))))
    assert where in error.value.problems[0].where


def test_at_rest_forces_balance_and_a_quiet_run_stays_there(written):
    still = written(TEXT.replace("by_mm = 0.5", "by_mm = 0.0"))
    experiment = prepare(read_scenario(still, {"noise.off": True}))
    point, run = experiment.operating_point, experiment.run()
    assert point.residual < 1e-9
    np.testing.assert_allclose(run.sensed - point.sensed, 0.0, atol=1e-9)
    np.testing.assert_allclose(point.sensed, [0, 0, -0.087], atol=1e-7)
    np.testing.assert_allclose(point.currents, point.currents[0], rtol=1e-6)


def test_six_coils_are_driven_by_least_power_unless_the_scenario_or_the_map_says_otherwise(written):
    asked = 'allocation = "lift_and_directions"\n'
    bare = TEXT.replace(asked, "").replace("allocation_n = 1.25\n", "")
    assert isinstance(prepare(read_scenario(written(bare))).machine.allocation, MatrixAllocation)
    told = prepare(read_scenario(written())).machine.allocation
    assert told.parametrisation == LiftAndDirections(1.25)
    with refused(ScenarioError, where=": control.allocation_n"):
        prepare(read_scenario(written(TEXT.replace("allocation_n = 1.25\n", ""))))


def test_free_bodies_lean_into_rest_where_they_must(written):
    """At a place off the axis, the signals and the tilt that hold the magnet there are found."""
    changes = {"body.turning": "free", "start.x_mm": 2.0, "start.y_mm": -1.0, "noise.off": True}
    rest = prepare(read_scenario(written(), changes)).operating_point
    np.testing.assert_allclose(rest.sensed[:2], [2e-3, -1e-3], atol=1e-12)
    assert rest.residual < 1e-7
    assert rest.outputs[1] > 0 > rest.outputs[2]
    assert abs(rest.state[7:9]).max() > 1e-3


def test_a_run_has_its_metrics_and_is_repeatable(written):
    path = written()
    one, again, other = simulate(path, seed=3), simulate(path, seed=3), simulate(path, seed=4)
    np.testing.assert_array_equal(one.rows, again.rows)
    assert np.abs(one.rows - other.rows).max() > 0
    depth = one.metrics.axes[2]
    true = reading_mm(one.scenario, one.sensed)[:, 2]
    wanted = np.where(one.time >= 0.2 - 1e-9, 10.5, 10.0)
    np.testing.assert_allclose(depth.rms_error_mm, np.sqrt(np.mean((true - wanted) ** 2)))
    assert depth.step is not None
    assert 0.02 < depth.step.rise_time < 0.4
    assert one.metrics.event == ""
    assert run_metrics(one.scenario, one) == one.metrics
    told = str(one).splitlines()
    assert one.scenario.contents.title in told[0]
    assert told[1].startswith(f"its end at {one.time[-1]:.4g} s")
    assert f"depth {true[-1]:.3f} mm" in told[1]
    of_depth = next(line for line in told if line.startswith("depth"))
    assert f"{depth.rms_error_mm:.4f}" in of_depth
    assert depth.step.overshoot > 0.0
    assert f" {100.0 * depth.step.overshoot:.1f} %" in of_depth


def test_a_reading_counts_from_the_axes_and_the_zero_of_the_sensor(written):
    scenario = read_scenario(written())
    assert reading_mm(scenario, np.array([1e-3, -2e-3, -0.09])) == pytest.approx([1.0, -2.0, 13.0], rel=1e-12)


@pytest.mark.parametrize(
    "steps",
    [
        "times = 2\nevery_s = 0.4\n",
        '\n[[reference]]\nkind = "step"\naxis = "depth"\nat_s = 0.6\nby_mm = 0.5\n',
    ],
)
def test_the_metrics_of_a_step_end_where_the_next_begins(steps, written):
    """Two steps of 0.5 mm, followed by 0.5 (1 - exp(-t / T)): 10 % to 90 % take T ln 9."""
    scenario = read_scenario(written(TEXT + steps))
    time, slow = np.arange(0.0, 1.0, 1e-3), 0.03
    true = 10.0 + sum(0.5 * (1.0 - np.exp(-np.maximum(time - at, 0.0) / slow)) for at in (0.2, 0.6))
    wanted = 10.0 + 0.5 * (time >= 0.2 - 1e-9) + 0.5 * (time >= 0.6 - 1e-9)
    found = _step(scenario, time, true, wanted, "depth")
    assert found.rise_time == pytest.approx(slow * np.log(9.0), rel=0.02)
    assert found.settling_time == pytest.approx(slow * np.log(50.0), rel=0.02)
    assert found.overshoot == 0.0


def test_a_step_is_measured_from_where_the_body_was(written):
    """The body is 0.2 mm below the reference before the step, and reaches it after: these 0.7 mm take T ln 9."""
    scenario = read_scenario(written())
    time, slow = np.arange(0.0, 1.0, 1e-3), 0.03
    true = 9.8 - 0.3 * (time < 0.1) + 0.7 * (1.0 - np.exp(-np.maximum(time - 0.2, 0.0) / slow))
    found = _step(scenario, time, true, 10.0 + 0.5 * (time >= 0.2 - 1e-9), "depth")
    assert found.rise_time == pytest.approx(slow * np.log(9.0), rel=0.02)
    assert found.settling_time == pytest.approx(slow * np.log(50.0), rel=0.02)


def wanted_by(written, kind, changes=None, **keys):
    """The references of a scenario with one reference of this kind."""
    piece = "".join(f"{name} = {json.dumps(value)}\n" for name, value in keys.items())
    text = TEXT[: TEXT.index("[[reference]]")] + f'[[reference]]\nkind = "{kind}"\n{piece}'
    return wanted_of(read_scenario(written(text), changes))


def test_references_are_what_they_are_called(written):
    time = 2e-3 * np.arange(500)
    ramp = wanted_by(written, "ramp", axis="depth", at_s=0.1, by_mm=-1.0, rate_mm_per_s=5.0)
    np.testing.assert_allclose(ramp[:, 2], 10 - np.clip(5 * (time - 0.1), 0, 1), atol=1e-6)
    sine = wanted_by(written, "sine", axis="x", amplitude_mm=0.2, frequency_Hz=2.0)
    np.testing.assert_allclose(sine[:, 0], 0.2 * np.sin(4 * np.pi * time), atol=1e-6)
    round_about = {"at_s": 0.5, "radius_mm": 3.0, "rate_rad_per_s": 2.0}
    circle = wanted_by(written, "circle", **round_about)
    np.testing.assert_allclose(np.hypot(circle[250:, 0], circle[250:, 1]), 3.0)
    np.testing.assert_allclose(circle[250], [3.0, 0.0, 10.0], atol=1e-7)
    angle = np.unwrap(np.arctan2(circle[250:, 1], circle[250:, 0]))
    np.testing.assert_allclose(np.diff(angle), 4e-3, rtol=1e-6)
    out = wanted_by(written, "circle", **round_about, out_at_s=0.1, out_mm_per_s=10.0)
    np.testing.assert_allclose(out[:250, 0], np.clip(10 * (time[:250] - 0.1), 0, 3), atol=1e-9)
    np.testing.assert_array_equal(out[250:], circle[250:])
    stairs = wanted_by(written, "step", axis="x", at_s=0.1, by_mm=0.1, times=3, every_s=0.2)
    np.testing.assert_allclose(np.flatnonzero(np.diff(stairs[:, 0])) + 1, [50, 150, 250])
    np.testing.assert_allclose(stairs[[0, 50, 150, 499], 0], [0.0, 0.1, 0.2, 0.3], atol=1e-12)
    bits = wanted_by(written, "prbs", axis="y", amplitude_mm=0.3, bit_ms=20.0, order=4)[:, 1]
    assert set(bits.round(9)) == {0.0, 0.3}
    changes = np.flatnonzero(np.diff(bits)) + 1
    assert changes.size > 5
    assert not (changes % 10).any()
    # A maximal sequence of 15 bits has 8 ones.
    assert np.count_nonzero(bits[:150]) == 8 * 10
    push = {"control.compensator.push_mm": 0.05, "control.compensator.duration_ms": 10.0}
    pushed = wanted_by(written, "step", push, axis="x", at_s=0.1, by_mm=0.1)
    np.testing.assert_allclose(np.flatnonzero(np.abs(pushed[:, 2] - 10) > 1e-9), np.arange(50, 55))
    np.testing.assert_allclose(pushed[50, 2], 9.95)


def test_the_vertical_sensor_reads_zero_at_the_origin_unless_told(written):
    assert read_scenario(written(TEXT)).zero_depth_mm == 77.0
    assert read_scenario(written(TEXT.replace("zero_depth_mm = 77.0\n", ""))).zero_depth_mm == 0.0
    np.testing.assert_array_equal(Sensors().numbers.shift, np.zeros(3))


def test_a_reference_from_a_file(written, tmp_path):
    (tmp_path / "path.csv").write_text("t,x,y,depth\n0,0,0,10\n0.5,1,0,10\n1,1,1,11\n")
    path = wanted_by(written, "csv", file="path.csv")
    np.testing.assert_allclose(path[125], [0.5, 0.0, 10.0])
    # The names of the columns give their order and units.
    (tmp_path / "path.csv").write_text("depth (cm);y_mm;x (m);t (ms);note\n1;0;0;0;1\n1;0;0,001;500;2\n")
    np.testing.assert_allclose(wanted_by(written, "csv", file="path.csv")[125], [0.5, 0.0, 10.0])
    for text, wheres in (
        ("t,x,y,depth\n0,0,0,10\n0,1,0,10\n", [":3"]),
        ("t,x,y,depth\n0,0,0,10,1\n1,nan,0,10\n", [":2", ":3"]),
        ("t,x (A),y,z\n0,0,0,10\n1,1,1,11\n", [": depth", ": column x"]),
    ):
        (tmp_path / "path.csv").write_text(text)
        with pytest.raises(ScenarioError) as caught:
            wanted_by(written, "csv", file="path.csv")
        assert [one.where for one in caught.value.problems] == [
            f"{tmp_path / 'path.csv'}{where}" for where in wheres
        ]


def test_open_loop_signals_and_disturbances_act(written):
    cut = TEXT[: TEXT.index("[[reference]]")]
    text = cut + '[[signal]]\noutput = "x"\nat_s = 0.1\nby = 0.1\n'
    text += "[[disturbance]]\nforce_mN = [0.0, 2.0, 0.0]\nfrom_s = 0.5\nuntil_s = 1.0\n"
    run = simulate(written(text), {"noise.off": True})
    at = [np.argmin(np.abs(run.time - t)) for t in (0.1, 0.5, 0.99)]
    assert abs(run.sensed[at[0], 0]) < 1e-6 < 1e-4 < run.sensed[at[1], 0]
    assert abs(run.sensed[at[1], 1]) < 1e-6 < 1e-4 < run.sensed[at[2], 1]


def test_a_field_too_weak_is_told(written):
    with refused(Infeasible, where=": start"):
        prepare(read_scenario(written(), {"field.scale": 0.1}))


@pytest.mark.parametrize(
    ("given", "place"),
    [(0, "sensors.averages"), ("a", "sensors.averages"), ([1, 0, 1], "sensors.averages.2")],
)
def test_a_value_that_may_have_two_types_is_refused_once_at_its_key(given, place):
    with pytest.raises(ScenarioError) as caught:
        read_scenario("vertical_step", {"sensors.averages": given})
    (problem,) = caught.value.problems
    assert problem.where.endswith(f": {place}")
