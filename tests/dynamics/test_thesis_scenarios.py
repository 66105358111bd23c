"""The results of the coupled loop on a made-up map of six dipoles without saturation: properties of any such machine,
and predictions of its statics and of closed forms of its loops."""

from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.control.blocks import AxisReading
from fieldmap.dynamics import Plate, prepare, read_scenario, simulate
from fieldmap.thesis import coupled_loop
from fieldmap.thesis.computation import Answers, function_of
from fieldmap.thesis.coupled_runs import Readings
from fieldmap.thesis.printed import figure_numbers, read_part

SENSOR_MM, SIDEWAYS_MM = 0.0104, 0.00706


@pytest.fixture
def answers(six, legible):
    """The results of a part of S18 or S19 on this map, with inputs of its data file or given ones; the first figures of
    the part are checked."""

    def compute(part, figures=1, **inputs):
        printed = read_part(part)
        given = printed.inputs | {"map": six} | inputs
        found = function_of(part)(given)
        assert isinstance(found, Answers)
        assert {number for figure in found.curves for number in figure_numbers(figure.title)} == set(
            printed.figures
        )
        legible(found.curves[:figures])
        numbers = {key: np.asarray(getattr(value, "value", value)) for key, value in found.numbers.items()}
        assert all(np.isfinite(curve.y).all() for figure in found.curves for curve in figure.series)
        return SimpleNamespace(**numbers, facts=found.facts, numbers=numbers)

    return compute


@pytest.mark.parametrize(
    "part", ["S18_combined", "S18_spikes", "S18_sway", "S18_proportional", "S18_regulator", "S19"]
)
def test_all_figures_are_legible(answers, part):
    answers(part, figures=None)


def shift_per_signal(six, depth_mm):
    """mm per unit of the x and the y signal about the axis, from the machine's rest at small signals."""
    places = []
    for signal in (0.005, -0.005):
        changes = {"start.depth_mm": depth_mm, "control.x.output": signal, "control.y.output": signal}
        places.append(prepare(read_scenario("horizontal_open_loop", changes), six).operating_point.sensed)
    return 1e3 * (places[0] - places[1])[:2] / 0.01


def test_table_7_1(answers):
    row = answers("S18_vertical")
    assert 0.03 < row.rise_time < row.time_to_reference < row.peak_time < row.settling_time < 1.5
    assert 15 < row.overshoot < 60
    # The RMS at rest is the sensor noise and the response of the loop to this noise.
    assert SENSOR_MM * 0.95 < row.rms_at_rest < 2 * SENSOR_MM
    column = [row.peak_time, row.rise_time, row.settling_time, row.overshoot, row.rms_at_rest]
    np.testing.assert_array_equal(row.setup_of_30, column)


def test_table_7_2_is_slow_without_overshoot_and_rests_in_the_noise_of_crossed_sensors(answers):
    row = answers("S18_horizontal")
    assert (row.rise_time > 0.3).all()
    assert row.rise_time[0] < row.rise_time[1] < 2.0
    assert (row.overshoot < 3.0).all()
    assert row.rms_at_rest == pytest.approx([SIDEWAYS_MM] * 2, rel=0.2)


def test_axes_of_a_symmetric_machine_leave_each_other_alone(answers):
    row = answers("S18_combined")
    assert row.y_when_x_steps < 0.003
    assert row.y_when_x_goes_slowly < 0.003
    assert (row.aside_when_z_steps < 0.003).all()


def test_without_saturation_there_are_no_spikes(answers):
    row = answers("S18_spikes")
    assert 3 * SENSOR_MM < row.spike < 5 * SENSOR_MM
    assert row.with_compensator == pytest.approx(row.spike, abs=SENSOR_MM)
    assert row.facts["spikes_then"][1] == "gone"
    assert row.facts["small_spikes_mm"][1] < 1.5 * row.facts["still_mm"]


def test_sway_and_block(answers):
    row = answers("S18_sway")
    assert 0.1 < row.settling_with_block < 2.0
    assert 0.3 < row.vertical_settling_near_block < 2.0


def test_the_block_damps_the_sway_as_its_formula_says(six):
    """Decay of an open-loop swing without and with the block: (drag + block) / 2 m against the peaks."""
    mass, place = 0.01119, np.array([0.0, 0.0, -0.102])
    block = Plate(3.5e7, 0.05, (0.0, 0.0, -0.109)).damping(tuple(place), (0.0, 0.0, 0.8126))[0, 0]
    changes = {"start.shift_mm": [0.5, 0.0, 0.0], "signal.0.by": 0.0, "noise.off": True, "duration_s": 3.0}
    rate = None
    for name, loss in (("horizontal_open_loop", 0.005), ("horizontal_open_loop_plate", 0.005 + block)):
        run = simulate(name, changes, field_map=six)
        rate = rate or _rate(run)
        damping = loss / (2 * mass)
        wanted = damping if damping < rate else damping - np.sqrt(damping**2 - rate**2)
        assert _decay(run.sensed[:, 0], run.time) == pytest.approx(wanted, rel=0.1)


def _rate(run):
    """rad/s of a lightly damped swing, from its zeros."""
    zeros = run.time[np.flatnonzero(np.diff(np.sign(run.sensed[:, 0])))]
    return np.pi / np.diff(zeros).mean()


def _decay(x, time):
    """Decay rate of the envelope, 1/s: from the peaks of a swing, or from the slow end if there are none."""
    size = np.abs(x)
    peaks = np.flatnonzero((size[1:-1] > size[:-2]) & (size[1:-1] >= size[2:])) + 1
    if len(peaks) < 3:
        peaks = np.arange(len(x) // 4, len(x) // 2)
    return -np.polyfit(time[peaks], np.log(size[peaks]), 1)[0]


def test_pd_control_rests_where_its_gain_and_the_statics_say(answers, six):
    row = answers("S18_proportional")
    kx, ky = shift_per_signal(six, 10.0)
    # Gain 1 per mm: x = k (wanted - x).
    np.testing.assert_allclose(
        row.numbers["x_at_0.9_1.0_0.9"], np.array([0.9, 1.0, 0.9]) * kx / (1 + kx), atol=3e-3
    )
    np.testing.assert_allclose(row.numbers["y_at_0.1_and_back"], 0.1 * ky / (1 + ky), atol=3e-3)


def test_range_is_what_is_asked_for_where_nothing_bounds_it(answers):
    row = answers("S18_range", depths_mm=np.array([11.5]))
    np.testing.assert_allclose(row.range_upper, [15, -15, 15, -15], atol=0.05)
    assert row.vertical_range == pytest.approx(35.0, abs=1.0)
    assert "fell out" in row.facts["end"]


def test_the_regulator_scenario_has_the_printed_gains(six):
    control = read_scenario("regulator").settings.control
    block = control.z.block(AxisReading("z", -1e3, -77.0), control.period, 0.0, np.zeros(7))
    # u = ... - k x / 0.69 on the predicted states: (7-13).
    gains = 0.69 * np.abs(np.ravel(block.C))
    for printed in (627.22, 2306.0, 914.07):
        assert np.min(np.abs(gains / printed - 1)) < 1e-4


def test_table_7_3_the_regulator_swings_by_its_whole_step_near_the_block(answers):
    row = answers("S18_regulator")
    peak, rise, settling, overshoot = row.regulator
    assert 0.01 < rise < row.time_to_reference < peak < 0.08
    assert 0.3 < settling < 1.0
    assert 70 < overshoot < 130
    assert row.pid[3] < 0.5 * overshoot
    assert row.rms_at_rest[0] == pytest.approx(SENSOR_MM, rel=0.15)
    assert SENSOR_MM < row.rms_at_rest[1] < 0.02
    assert SENSOR_MM < row.rms_sideways[0] < 0.02


def test_table_7_4_the_regulator_needs_the_block(answers):
    row = answers("S18_heights", further_gaps_mm=np.array([2.0, 20.0]))
    assert (np.diff(row.rms) > 0).all()
    assert SENSOR_MM < row.rms[0] < row.rms[-1] < 0.03
    near, far = row.facts["farther"]
    assert "pole" in near
    assert "held" not in near
    assert "held" not in far


def test_circles_lag_as_their_slow_loop_says_and_keep_the_height_without_saturation(answers, six):
    row = answers("S19", turns=np.array([0.5, 0.5, 0.25]))
    assert row.growth == pytest.approx(1.0, abs=0.1)
    assert row.vertical_rms == pytest.approx(np.full(3, row.rms_at_rest), rel=0.1)
    np.testing.assert_allclose(row.speed, [0.08, 0.48], rtol=1e-12)
    # At this speed the plant is its statics: T = k C / (1 + k C), C = Kc (1 + 1 / (Ti s)).
    for k, rate in ((0, 0.16), (2, 0.0502)):
        loop = shift_per_signal(six, 11.0)[0] * 0.025 * (1 + 1 / (0.36j * rate))
        expected = -np.rad2deg(np.angle(loop / (1 + loop)))
        followed = row.facts["followed"][k]
        assert followed.lag_deg == pytest.approx(expected, abs=0.25 + 0.15 * expected)
        assert 1.0 + followed.growth == pytest.approx(abs(loop / (1 + loop)), abs=0.004)


def test_how_a_circle_is_followed():
    time = np.arange(0.0, 30.0, 0.01)
    wanted = 2.0 * np.exp(0.3j * time)
    path = 0.9 * wanted * np.exp(-1j * np.deg2rad(12.0)) + 0.3
    plane = (np.column_stack([np.real(z), np.imag(z), 0 * time]) for z in (path, wanted))
    true, asked = plane
    found = coupled_loop.follows(Readings(None, time, true, true, asked), 0.3, 5.0)
    assert found == pytest.approx((-0.1, 12.0, 0.3), rel=1e-9)
