"""Field sensors in the closed loop: the desk levitator, with its Hall element and a second one near the magnet.

Readings are compared with Python's, which tests/lookup compares with closed forms and the full solver.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import fieldmap as fm
from fieldmap.control import PID, FunctionController, RunningPID
from fieldmap.dynamics import linear_points, open_machine, prepare, read_scenario, simulate
from fieldmap.errors import InputError, ScenarioError
from fieldmap.instruments import calibrate
from fieldmap.lookup import MagneticBody, magnetic_body
from tests.refusals import refused

TS = 5e-4
IDEAL = {"noise.off": True, "field_sensors.input_bits": None, "field_sensors.range_mT": None}
SHORT = {"duration_s": 1.0, "reference": [], "record.every": 1}
HALL = {"field_sensors.sensor": "hall"}
IDEAL_SOURCE = {"coils.drive": "ideal", "coils.dynamics": False}
UNSEEN = {
    **SHORT,
    "field_sensors.estimator": "none",
    "field_sensors.input_bits": None,
    "control.z": None,
    "control.x": None,
    "control.y": None,
    "control.coupled": {"kind": "own"},
}


@pytest.fixture(scope="module")
def device():
    shipped = fm.read_device("desk_levitator")
    return shipped.replace(
        sensors=(*shipped.sensors, fm.FieldSensor("beside", [0.018, 0.004, -0.035], [1, 0, 1]))
    )


@pytest.fixture(scope="module")
def field(device, tmp_path_factory):
    path = tmp_path_factory.mktemp("hall") / "desk.h5"
    return fm.open_map(fm.generate(device, path, spacing=3e-3, progress=False))


@pytest.fixture(scope="module")
def magnet(device):
    return magnetic_body(device.payload, level=4)


@pytest.fixture(scope="module")
def curve(field, magnet):
    return calibrate(field, magnet, "hall")


def turn_of(quaternion):
    return Rotation.from_quat(np.roll(quaternion, -1, axis=-1)).as_matrix()


def body_of(field):
    return prepare(read_scenario("desk_hall", HALL), field).machine.body.magnet


def true_readings(field, run):
    """Readings (r, 2) at the rows of a run, for the body at its simulated poses."""
    return field.readings(run.position, body_of(field), run.currents, turn_of(run.quaternion))


@pytest.mark.parametrize("late", [0, 1, 3])
def test_what_is_shown_are_the_readings_so_many_samples_ago(field, late):
    """At the currents of the same sample, for any currents and poses; the height by the calibration curve."""
    changes = {**IDEAL, **HALL, "field_sensors.latency_samples": late, "start.lean_deg": 5.0}
    rig = open_machine("desk_hall", changes, field_map=field, gives="currents")
    body, true, currents = rig.machine.body.magnet, [], []
    random, own = np.random.default_rng(3), rig.machine.sensors.curve
    for n in range(30):
        turn = turn_of(rig.quaternion)
        true.append(field.readings(rig.position, body, rig.currents, turn))
        currents.append(rig.currents)
        shown = max(n - late, 0)
        np.testing.assert_allclose(rig.readings, true[shown], rtol=1e-12)
        np.testing.assert_array_equal(rig.measured_currents, currents[shown])
        at_start = rig.operating_point.sensed[:2]
        np.testing.assert_array_equal(rig.measured[:2], at_start)
        assert rig.measured[2] == pytest.approx(float(own.height(true[shown][0], currents[shown])), abs=1e-12)
        rig.step(random.uniform(0.0, 0.8, 1))


def holding(curve, kept):
    """A PD controller of the height by the curve, which appends its measurements to `kept`."""
    pid = RunningPID(PID(320.0, np.inf, 0.0192, TS, Tf=0.00192, acts_on_minus_error=False))

    def control(time, measured, reference, state):
        kept.append(measured)
        height = float(curve.height(measured[0], measured[2:]))
        return (0.2418 + pid.step(float(reference[2]), height),)

    return FunctionController(control, gives="currents", lower=-1.0, upper=1.0)


def test_noise_offset_and_gain_are_those_of_each_element(field, curve):
    kept = []
    changes = {
        **UNSEEN,
        "duration_s": 2.0,
        "field_sensors.deviation_mT": 0.03,
        "field_sensors.input_noise_V": 0.001,
        "field_sensors.offset_mT": [0.1, -0.2],
        "field_sensors.gain_error": [0.004, -0.02],
        "field_sensors.current_deviation_A": 0.002,
        "field_sensors.latency_samples": 0,
    }
    run = simulate("desk_hall", changes, field_map=field, controller=holding(curve, kept))
    assert run.event is None
    assert np.isnan(run.seen).all(axis=0).tolist() == [True, True, True]
    shown, true = np.array(kept), true_readings(field, run)
    assert shown.shape == (4000, 3)
    off = shown[:, :2] - true * [1.004, 0.98]
    deviation = np.hypot(30e-6 * np.array([1.004, 0.98]), 0.001 / 25.0)
    # 4000 samples: deviations to 1.1 %, means to 0.8 um.
    assert off.std(axis=0) == pytest.approx(deviation, rel=0.05)
    assert off.mean(axis=0) == pytest.approx([1e-4, -2e-4], abs=4e-6)
    assert abs(np.corrcoef(off.T)[0, 1]) < 0.06
    currents = shown[:, 2] - run.currents[:, 0]
    assert currents.std() == pytest.approx(0.002, rel=0.05)
    assert abs(np.corrcoef(currents, off[:, 0])[0, 1]) < 0.06


def test_steps_and_range_of_the_electronics(field):
    changes = {**HALL, **IDEAL_SOURCE, "noise.off": True, "field_sensors.latency_samples": 0}
    changes["field_sensors.input_bits"] = 8
    rig = open_machine("desk_hall", changes, field_map=field, gives="currents")
    step, seen = 2 * 2.5 / 2**8 / 25.0, []
    for n in range(9):
        turn = turn_of(rig.quaternion)
        true = field.readings(rig.position, rig.machine.body.magnet, rig.currents, turn)
        seen.append(rig.readings)
        np.testing.assert_allclose(rig.readings / step, np.round(rig.readings / step), atol=1e-9)
        assert np.abs(rig.readings - np.clip(true, -0.085, 0.085)).max() <= 0.5 * step * (1 + 1e-9)
        rig.step([0.25 * n])
    assert np.max(seen) == pytest.approx(0.085, abs=0.5 * step)


def test_numba_and_python_get_the_same_numbers(field):
    def control(time, measured, reference, state):
        state[0] = measured[0] + 2.0 * measured[1] + 4.0 * measured[2] + len(measured)
        return (0.24 + 1e-3 * state[0] + (0.1 if time % 0.01 < 0.005 else -0.1),)

    numba = pytest.importorskip("numba")
    runs = [
        simulate(
            "desk_hall",
            {**UNSEEN, "duration_s": 0.05},
            field_map=field,
            controller=FunctionController(function, 1, gives="currents"),
        )
        for function in (control, numba.njit(control))
    ]
    np.testing.assert_array_equal(runs[0].rows, runs[1].rows)
    wave = np.where(runs[0].time % 0.01 < 0.005, 0.1, -0.1)
    shown = (runs[0].outputs[:, 0] - 0.24 - wave) / 1e-3 - 3.0
    true = true_readings(field, runs[0]) @ [1.0, 2.0] + 4.0 * runs[0].currents[:, 0]
    # One sample late, to the noise.
    np.testing.assert_allclose(shown[1:], true[:-1], atol=0.02)
    assert np.ptp(true) > 0.5


def test_the_levitator_holds_with_noise_delay_and_quantisation(field):
    """Height noise: element, converter, quantisation and currents, divided by the slope of the curve."""
    changes = {**HALL, **SHORT, "duration_s": 2.0, "start.shift_mm": [0, 0, 0.3], "start.lean_deg": 0.0}
    run = simulate("desk_hall", {**changes, "field_sensors.latency_samples": 0}, field_map=field)
    assert run.event is None
    late = run.time > 1.0
    height = 1e6 * (run.seen - run.sensed)[late, 2]
    own = body_of(field)
    slope = field.readings_and_slopes([0, 0, -0.025], own, 0.0)[1][0, 2]
    share = float(field.readings([0, 0, -0.025], np.zeros(3), 1.0)[0])
    parts = 20e-6, 0.0005 / 25, 5.0 / 2**12 / 25 / np.sqrt(12), 0.0005 * share
    assert height.std() == pytest.approx(1e6 * np.linalg.norm(parts) / slope, rel=0.08)
    assert abs(height.mean()) < 1.0
    assert 1e6 * (run.sensed[late, 2] + 0.025).std() < 5.0
    assert run.currents[late].std() < 0.05
    again = simulate("desk_hall", {**changes, "field_sensors.latency_samples": 0}, field_map=field)
    np.testing.assert_array_equal(run.rows, again.rows)


def test_it_holds_for_a_minute(field):
    """From a shift along x, whose sway no coil damps, and 1 mm higher in the second half."""
    run = simulate("desk_hall", HALL, field_map=field)
    assert run.event is None
    assert run.time[-1] > 59.9
    assert np.abs(run.currents).max() < 0.9
    for low, high, wanted in ((5, 30, -0.025), (35, 60, -0.024)):
        part = (run.time > low) & (run.time < high)
        assert 1e6 * np.sqrt(np.mean((run.sensed[part, 2] - wanted) ** 2)) < 15.0
        assert 1e3 * np.abs(run.sensed[part, 2] - wanted).max() < 0.05


def test_beyond_the_range_of_the_element_the_magnet_is_lost(field):
    """Beyond the range the reading is constant; less the coil's share it is too small, as if the magnet fell."""
    far = {**HALL, **SHORT, **IDEAL_SOURCE, "start.shift_mm": [0, 0, 1.0]}
    assert simulate("desk_hall", far, field_map=field).event is not None
    without = {**far, "field_sensors.range_mT": None, "field_sensors.input_range_V": 10.0}
    assert simulate("desk_hall", without, field_map=field).event is None
    # The bridge of 12 V is slow, and the magnet returns into the range first.
    assert simulate("desk_hall", far | {"coils.drive": "bridge"}, field_map=field).event is None


def test_latency_takes_its_share_of_the_phase(field):
    """The phase lost is 360 degrees times crossover times latency."""
    found = {}
    for late in (0, 1, 3):
        experiment = prepare(
            read_scenario("desk_hall", {**HALL, "field_sensors.latency_samples": late}), field
        )
        (point,) = linear_points(experiment)
        found[late] = next(one for one in point.margins if one.output == "lift_V")
    for late in (1, 3):
        lost = found[0].phase - found[late].phase
        assert lost == pytest.approx(360.0 * found[0].crossover * late * TS, rel=0.01)


def test_the_regulator_is_designed_for_the_noise_of_the_height(field):
    machine = prepare(read_scenario("desk_hall", HALL), field).machine
    element, slope = machine.sensors.elements[0], machine.sensors.curve.slope_at(-0.025)
    assert machine.sensors.deviations == (0.0, 0.0, pytest.approx(element.whole_deviation * slope))


# ---- the curve ------------------------------------------------------------------------------


def test_a_curve_finds_the_height_at_any_current(field, magnet, curve):
    random = np.random.default_rng(5)
    heights = random.uniform(curve.heights.min(), curve.heights.max(), 300)
    currents = random.uniform(-2.0, 2.0, (300, 1))
    places = np.column_stack([np.zeros((300, 2)), heights])
    read = field.readings(places, magnet, currents)[:, 0]
    off = np.abs(curve.height(read, currents) - heights)
    assert off.max() < 1.5 * curve.error < 1e-6
    assert off.max() > 0.1 * curve.error


def test_a_curve_of_more_points_is_better_by_the_fourth_power(field, magnet):
    """Within one cell of the map, because its polynomials jump from cell to cell."""
    low, high = field.info.grid.lower[2] + 0.003 * np.array([6.05, 6.95])
    body = MagneticBody.dipole([0, 0, 1.08])
    errors = [calibrate(field, body, "hall", heights=(low, high), nodes=n).error for n in (3, 5, 9)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.6)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(4.0, abs=0.6)


def test_the_point_whose_height_is_found_may_lie_above_the_magnet(field, magnet, curve):
    above = calibrate(field, magnet, "hall", above=0.004)
    assert above.height(0.03, 0.0) == pytest.approx(float(curve.height(0.03, 0.0)) + 0.004, abs=1e-12)
    assert above.error == pytest.approx(curve.error)


def test_a_calibration_of_the_field_scales_the_share_of_the_currents(field, magnet, curve):
    scaled = calibrate(field, magnet, "hall", scale=1.5)
    assert scaled.per_ampere == pytest.approx(1.5 * curve.per_ampere)
    np.testing.assert_array_equal(scaled.readings, curve.readings)
    still = {"start.shift_mm": [0.0, 0.0, 0.3], "start.lean_deg": 0.0}
    rig = open_machine(
        "desk_hall", {**IDEAL, **HALL, **still, "field.scale": 1.1}, field_map=field, gives="currents"
    )
    assert rig.measured[2] == pytest.approx(rig.sensed[2], abs=2e-6)


def test_a_tilted_magnet_reads_as_if_it_were_lower(field, magnet, curve):
    """By the cosine of the tilt: 2 % at 0.2 rad."""
    turn = Rotation.from_rotvec([0.2, 0.0, 0.0]).as_matrix()
    read = field.readings([0, 0, -0.025], magnet, 0.0, turn)[0]
    assert -4e-4 < curve.height(read, 0.0) + 0.025 < -1e-4
    tilted = calibrate(field, magnet, "hall", orientation=turn)
    assert tilted.height(read, 0.0) == pytest.approx(-0.025, abs=1e-6)
    beside = calibrate(field, magnet, "hall", beside=[0.002, 0.001])
    moved = field.readings([0.002, 0.001, -0.025], magnet, 0.0)[0]
    assert beside.height(moved, 0.0) == pytest.approx(-0.025, abs=1e-6)


def test_a_reading_that_turns_is_refused(field, magnet):
    with refused(InputError, where="calibrate(heights)"):
        calibrate(field, magnet, "beside")


@pytest.mark.parametrize("sensor", [None, "third"])
def test_the_sensor_must_be_named(field, magnet, sensor):
    with refused(InputError, where="calibrate(sensor)"):
        calibrate(field, magnet, sensor)


@pytest.mark.parametrize(
    ("changes", "where"),
    [
        ({}, "field_sensors.sensor"),
        ({"field_sensors.sensor": "beside"}, "field_sensors.estimator"),
        ({**HALL, "field_sensors.offset_mT": [0.1, 0.2, 0.3]}, "field_sensors.offset_mT"),
        ({"field_sensors.estimator": "none"}, "field_sensors.estimator"),
        ({"field_sensors.nodes": 1}, "field_sensors.nodes"),
        ({"field_sensors.latency_samples": -1}, "field_sensors.latency_samples"),
        ({"field_sensors.sensitivity_V_per_T": 0.0}, "field_sensors.sensitivity_V_per_T"),
    ],
)
def test_mistakes_name_their_key(field, changes, where):
    with refused(ScenarioError, where=where):
        prepare(read_scenario("desk_hall", changes), field)


def test_a_map_without_sensors_is_refused(tmp_path):
    device = fm.read_device("desk_levitator").replace(sensors=(), bodies=(), materials={})
    bare = fm.open_map(fm.generate(device, tmp_path / "bare.h5", spacing=4e-3, progress=False))
    changes = {"start.depth_mm": None, "start.shift_mm": [0.0, 0.0, 0.0]}
    with refused(ScenarioError, where="field_sensors"):
        prepare(read_scenario("desk_hall", changes), bare)


def test_a_bridge_that_switches_moves_the_magnet_as_its_mean_does(field):
    """A PWM of 20 kHz with dead times, drop and ripple, in steps of 1 us with exact edges, under the same PID with the
    same delays."""
    numba = pytest.importorskip("numba")
    device = fm.read_device("desk_levitator")
    bridge, step, slots, volts = device.driver.bridge, 1e-6, 50, 12.0
    quiet = IDEAL | SHORT | {"start.lean_deg": 0.0, "start.shift_mm": [0, 0, 0.3], "coils.output_bits": None}
    quiet |= HALL | {"body.finite_magnet": False, "duration_s": 0.1}
    of_scenario = prepare(read_scenario("desk_hall", quiet), field)
    mean, begin = of_scenario.run(), of_scenario.controller.memory
    n, lift = len(begin), float(of_scenario.operating_point.outputs[0])
    block = of_scenario.controller
    A, B, C, D, E = (getattr(block, name).copy() for name in "ABCDE")

    def switched(time, measured, reference, state):
        """state: the controller's memory; the last height; the outputs of this period and of the next."""
        tick = round(time / step)
        if tick % 500 == 0:
            late = measured[2] if tick == 0 else state[n]
            state[n], state[n + 1] = measured[2], state[n + 2]
            v = np.array([reference[0], reference[1], reference[2], measured[0], measured[1], late, 1.0])
            wanted = 0.0
            for k in range(n):
                wanted += C[0, k] * state[k]
            for k in range(7):
                wanted += D[0, k] * v[k]
            state[n + 2] = min(max(wanted, -5.0), 5.0)
            memory = state[:n].copy()
            for i in range(n):
                state[i] = E[i, 0] * state[n + 2]
                for k in range(n):
                    state[i] += A[i, k] * memory[k]
                for k in range(7):
                    state[i] += B[i, k] * v[k]
        share, slot = 0.5 * (1.0 + state[n + 1] / 5.0), (tick % slots) * step
        first = 0.5 * (1.0 - share) * slots * step + bridge_dead_time
        on = max(0.0, min(0.5 * (1.0 + share) * slots * step, slot + step) - max(first, slot)) / step
        return (5.0 * (2.0 * on - 1.0) - 5.0 * bridge_drop / volts,)

    bridge_dead_time, bridge_drop = bridge.dead_time, bridge.drop
    fast = {
        "control.period_ms": 1e-3,
        "control.step_ms": 1e-3,
        "control.delay_ms": 0.0,
        "coils.drive": "voltage",
    }
    fast["field_sensors.latency_samples"] = 0
    # The supply has 13 V because voltage and drop add up.
    wider = device.replace(driver=replace(device.driver, current_limit=2.5, supply_voltage=13.0))
    own = FunctionController(numba.njit(switched), [*begin, 0.0, lift, lift], gives="voltages")
    run = simulate("desk_hall", quiet | fast, field_map=field, device=wider, controller=own)
    assert mean.event is run.event is None
    assert 1e3 * np.ptp(mean.sensed[:, 2]) > 0.3
    assert 1e3 * np.ptp(run.currents[-50:, 0]) == pytest.approx(12.0, rel=0.1)
    assert run.currents.min() > 0.05
    np.testing.assert_allclose(run.sensed[::500, 2], mean.sensed[:, 2], atol=1e-6)
    np.testing.assert_allclose(run.currents[::500, 0], mean.currents[:, 0], atol=1e-3)
