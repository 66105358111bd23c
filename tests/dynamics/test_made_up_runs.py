"""Metrics, texts and files of runs with made-up numbers."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.control import StepMetrics
from fieldmap.dynamics import run_metrics
from fieldmap.dynamics.loop_run import EVENTS, Event, IronUse, LevitationRun, as_csv, event_of, recorded
from fieldmap.dynamics.motion import state_of
from fieldmap.dynamics.scenario.batches import Batch, BatchRun, batch_words
from fieldmap.dynamics.scenario.measured_log import LaidLog, LaidSignal, lay_over
from fieldmap.dynamics.scenario.metrics import AxisMetrics, RunMetrics, _step
from fieldmap.dynamics.scenario.references import (
    Circle,
    Disturbance,
    Ramp,
    Signal,
    Sine,
    Step,
    control_times,
    disturbances,
    open_loop_signals,
)
from fieldmap.errors import InputError
from tests.refusals import refused

ROWS, COILS = 4, 2
LINEAR = IronUse()
TIME = 0.01 * np.arange(ROWS)
# Turns about the body's y axis, which move the sensed point, 5 mm above the magnet, along x.
TURN = np.array([0.1, -0.3, 0.2, 0.0])
SCENARIO = SimpleNamespace(
    zero_depth_mm=77.0,
    settings=SimpleNamespace(reference=()),
    contents=SimpleNamespace(duration_s=0.04, title="Made up"),
)


def made(event=None, touched=(), forces=False, names=("lift_V", "x_signal"), iron=LINEAR):
    """A run of four rows whose numbers increase from column to column."""
    rows = np.arange(1.0, 1.0 + ROWS)[:, None] + 10.0 * np.arange(13 + 2 * COILS + 3 + len(names))
    rows[:, :3] = 1e-3 * rows[:, :3]
    rows[:, 6:10] = np.column_stack([np.cos(TURN / 2), 0 * TURN, np.sin(TURN / 2), 0 * TURN])
    references = np.column_stack([TIME, 2 * TIME, -0.09 - TIME])
    about = TIME, rows, COILS, np.array([0.0, 0.0, 5e-3]), event, touched, ("made up",), forces
    fields = ("time", "rows", "coils", "seen_at", "event", "touched", "assumptions", "forces")
    given = dict(zip(fields, about, strict=True))
    return LevitationRun(**given, references=references, output_names=names, iron=iron)


def true_places():
    rows = made().rows
    return rows[:, :3] + 5e-3 * np.column_stack([np.sin(TURN), 0 * TURN, np.cos(TURN)])


def test_parts_of_a_row():
    run = made()
    first = run.rows[0]
    np.testing.assert_array_equal(run.position[0], first[:3])
    np.testing.assert_array_equal(run.velocity[0], first[3:6])
    np.testing.assert_array_equal(run.quaternion[0], first[6:10])
    np.testing.assert_array_equal(run.angular_velocity[0], first[10:13])
    np.testing.assert_array_equal(run.currents[0], first[13:15])
    np.testing.assert_array_equal(run.commanded[0], first[15:17])
    np.testing.assert_array_equal(run.seen[0], first[17:20])
    np.testing.assert_array_equal(run.outputs[0], first[20:22])
    np.testing.assert_allclose(run.sensed, true_places(), rtol=1e-12)
    np.testing.assert_array_equal(run.response, run.sensed)
    np.testing.assert_allclose(run.tilt, np.abs(TURN), atol=1e-12)
    # A turn about the vertical is no tilt; half a turn about x is a tilt of 180 degrees.
    for quaternion, lean in (([0.6, 0.0, 0.0, 0.8], 0.0), ([0.0, 1.0, 0.0, 0.0], np.pi)):
        rows = run.rows.copy()
        rows[:, 6:10] = quaternion
        np.testing.assert_allclose(replace(run, rows=rows).tilt, lean)


def test_metrics_are_those_of_the_rows():
    metrics = run_metrics(SCENARIO, made(touched=("tube",), iron=IronUse("model", 7, 12, 1, 2)))
    scale, zero = [1e3, 1e3, -1e3], [0.0, 0.0, 77.0]
    true, seen, wanted = (points * scale - zero for points in (true_places(), made().seen, made().references))
    for k, one in enumerate(metrics.axes):
        assert one.axis == ("x", "y", "depth")[k]
        assert one.rms_error_mm == pytest.approx(np.sqrt(np.mean((true - wanted)[:, k] ** 2)))
        assert one.largest_error_mm == pytest.approx(np.abs(true - wanted)[:, k].max())
        assert one.rms_seen_mm == pytest.approx(np.sqrt(np.mean((seen - wanted)[:, k] ** 2)))
        assert one.travel_mm == pytest.approx(true[:, k].max() - true[:, k].min())
        assert one.step is None
    assert (metrics.end_s, metrics.event, metrics.touched) == (pytest.approx(0.03), "", ("tube",))
    assert metrics.largest_lean_deg == pytest.approx(np.degrees(0.3))
    assert metrics.largest_current_A == 144.0
    assert metrics.end_mm == pytest.approx(true[-1])
    assert metrics.end_mm_per_s == pytest.approx([34e3, 44e3, -54e3])
    assert metrics.end_A == (134.0, 144.0)
    told = str(metrics).splitlines()
    at = ", ".join(f"{axis} {value:.3f}" for axis, value in zip(("x", "y", "depth"), true[-1], strict=True))
    assert told[0] == f"its end at 0.03 s: {at} mm; currents 134, 144 A"
    assert told[4:] == [
        "largest lean 17.19 degrees, current 144.000 A",
        "touched: tube",
        "iron solved at 7 steps; 1 did not converge",
    ]


def test_at_an_event_the_end_is_that_of_the_event():
    state = np.array([1e-3, 2e-3, -0.1, 0.01, 0.02, 0.03, 1.0, 0, 0, 0, 0, 0, 0])
    event = Event("fell out", "it fell", 0.035, state, np.array([1.0, -2.0]))
    assert str(event) == "fell out after 0.035 s: it fell"
    metrics = run_metrics(SCENARIO, made(event))
    assert (metrics.end_s, metrics.event) == (0.035, "fell out")
    assert metrics.end_mm == pytest.approx((1.0, 2.0, 18.0))
    assert metrics.end_mm_per_s == pytest.approx((10.0, 20.0, -30.0))
    assert metrics.end_A == (1.0, -2.0)
    assert str(metrics).startswith("fell out at 0.035 s: x 1.000, y 2.000, depth 18.000 mm; currents 1, -2 A")
    record = recorded(made(event), ("a", "b"), {"value": 3})
    assert record.about == {
        "event": "fell out",
        "about_event": "it fell",
        "end_s": 0.035,
        "state": state.tolist(),
        "currents": [1.0, -2.0],
        "touched": [],
        "iron": {"model": "linear", "solves": 0, "newton_steps": 0, "unsolved": 0, "outside": 0},
        "assumptions": ["made up"],
        "value": 3,
    }
    assert event_of(next(iter(EVENTS)), 0.5, state, np.zeros(2)).time == 0.5


def test_a_run_without_a_row_has_zeros():
    run = made()
    none = replace(run, time=run.time[:0], rows=run.rows[:0], references=run.references[:0])
    metrics = run_metrics(SCENARIO, none)
    assert metrics.axes[0] == AxisMetrics("x", 0.0, 0.0, 0.0, 0.0, None)
    ends = metrics.end_s, metrics.largest_lean_deg, metrics.largest_current_A, metrics.end_mm, metrics.end_A
    assert ends == (0.0, 0.0, 0.0, (0.0, 0.0, 0.0), ())
    assert metrics.end_mm_per_s == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("given", "unit", "columns"),
    [
        ({}, ("V", "1"), ("lift", "x")),
        ({"forces": True, "names": ("fx", "fy", "fz")}, ("N", "N", "N"), ("x", "y", "z")),
        ({"names": ("coil_1_A", "coil_2_A")}, ("A", "A"), ("first", "second")),
        ({"names": ("coil_1_V", "coil_2_V")}, ("V", "V"), ("first", "second")),
        ({"names": ("coil_1_A", "coil_2_V")}, ("V", "1"), ("lift", "x")),
    ],
)
def test_signals_as_text(given, unit, columns):
    run = made(**given)
    head, *lines = as_csv(recorded(run, ("first", "second"))).splitlines()
    names = head.split(",")
    axes = [f"{of} {axis} ({u})" for of, u in (("position", "m"), ("velocity", "m/s")) for axis in "xyz"]
    assert names[:7] == ["time (s)", *axes]
    assert names[7:11] == [f"quaternion {part} (1)" for part in "wxyz"]
    assert names[11:14] == ["spin about (rad/s)", "spin 1 (rad/s)", "spin 2 (rad/s)"]
    assert names[14:23] == [f"{of} {axis} (m)" for of in ("sensed", "seen", "reference") for axis in "xyz"]
    coils = [f"{of} {coil} (A)" for of in ("currents", "commanded") for coil in ("first", "second")]
    assert names[23:27] == coils
    assert names[27:] == [f"outputs {part} ({u})" for part, u in zip(columns, unit, strict=True)]
    table = np.array([line.split(",") for line in lines], float)
    np.testing.assert_allclose(table[:, 0], TIME)
    np.testing.assert_allclose(table[:, 14:17], true_places(), rtol=1e-8)
    np.testing.assert_allclose(table[:, 27:], run.outputs)


STEP = StepMetrics(0.01, 0.02, 0.034567, 0.1234, 0.5)
RESTLESS = StepMetrics(0.01, 0.02, np.inf, 0.2, 0.3)


def metrics_of(step=None, **more):
    axes = tuple(
        AxisMetrics(axis, 0.12344, 0.5, 0.7, 1.5, step if axis == "y" else None)
        for axis in ("x", "y", "depth")
    )
    given = {"event": "", "touched": (), "iron": LINEAR, "end_s": 2.0} | more
    return RunMetrics(axes, largest_lean_deg=1.0, largest_current_A=2.0, end_mm=(1.0, 2.0, 3.0),
                      end_mm_per_s=(3.0, 4.0, 12.0), end_A=(0.5, 1.25), **given)  # fmt: skip


def test_words_about_an_axis_and_its_step():
    told = str(metrics_of(STEP)).splitlines()
    assert told[1] == "x: 0.1234 mm rms off its reference, 0.5000 at most"
    assert told[2] == told[1].replace("x:", "y:") + "; step overshoots by 12.3 %, settles in 0.0346 s"
    assert str(metrics_of(RESTLESS)).splitlines()[2].endswith("; step overshoots by 20.0 %, does not settle")


def batch(*runs, seconds=0.5, residual=1e-9, lean=0.0):
    half, about = np.radians(lean) / 2, np.radians(35.0)
    turn = [np.cos(half), np.sin(half) * np.cos(about), np.sin(half) * np.sin(about), 0.0]
    place = np.array([1e-3, -2e-3, -0.09])
    point = SimpleNamespace(
        residual=residual,
        sensed=place,
        currents=np.array([1.23456, 2.0]),
        state=state_of(place, quaternion=turn),
    )
    experiment = SimpleNamespace(scenario=SCENARIO, operating_point=point)
    return Batch({"start.depth_mm": 3}, experiment, tuple(BatchRun(one, None) for one in runs), seconds)


def test_words_about_a_batch():
    fell = metrics_of(RESTLESS, event="fell out", end_s=0.25, touched=("floor",))
    later = replace(fell, end_s=0.5, end_mm=(9.0, 9.0, 9.0))
    whole = metrics_of(RESTLESS, iron=IronUse("model", 8, 20, 0, 0), touched=("currents",))
    words = list(batch_words(batch(later, whole, fell)))
    at = "x 1.00, y 2.00, depth 3.00 mm, 13 mm/s; currents 0.5, 1.25 A"
    assert words == [
        ("value", "start.depth_mm = 3"),
        ("at rest", "x 1.000, y -2.000, depth 13.000 mm; currents 1.235, 2 A"),
        ("simulated", "3 runs of 0.04 s in 0.50 s of one processor: 6 times real time"),
        ("events", f"fell out: 2, first at 0.250 s: {at}"),
        ("events", "currents beyond those of the map, where its iron is extrapolated"),
        ("events", "touched the floor"),
        ("settling", "y does not settle within 2 % of its step: 0.3 mm RMS off over the last quarter"),
        ("largest", "lean 1.00 degrees, current 2.000 A"),
        ("iron", "solved at 8 steps, 2.50 Newton steps each; 0 did not converge"),
    ]


def test_words_about_what_is_left_what_settles_and_what_did_not_converge():
    one = metrics_of(STEP, iron=IronUse("model", 8, 20, 2, 0))
    words = dict(batch_words(batch(one, residual=1.5e-6)))
    assert words["at rest"].endswith(" A; 2e-06 of the weight left")
    assert words["events"] == "none"
    assert "settling" not in words
    assert words["iron"].startswith("WARNING: at 2 steps")
    assert "left" not in dict(batch_words(batch(one, residual=1e-6)))["at rest"]
    for lean, told in (
        (0.99, "mm; "),
        (1.01, "mm, leaning 1.0 degrees; "),
        (170.2, "mm, leaning 170.2 degrees; "),
    ):
        assert told in dict(batch_words(batch(one, lean=lean)))["at rest"]
    # The RMS over all runs that reached their end but did not settle.
    other = replace(RESTLESS, steady_rms=0.4)
    each = dict(batch_words(batch(metrics_of(RESTLESS), metrics_of(other), metrics_of(STEP))))
    assert each["settling"].endswith(" step in 2 of 3 runs: 0.354 mm RMS off over the last quarter")


def test_words_about_windings_that_warm_up():
    """The highest temperature, the earliest time above the limit, and the number of runs above it."""
    runs = [
        metrics_of(STEP, hottest_degC=hot, too_hot_s=at)
        for hot, at in ((80.04, 1.5), (91.26, 1.25), (70.0, None))
    ]
    words = [text for subject, text in batch_words(batch(*runs)) if subject == "windings"]
    assert words == ["91.3 degC at most", "WARNING: hotter than their limit from 1.25 s on in 2 of 3 runs"]
    (alone,) = [text for subject, text in batch_words(batch(runs[2])) if subject == "windings"]
    assert alone == "70.0 degC at most"
    assert "windings" not in dict(batch_words(batch(metrics_of(STEP))))


PIECES = {
    "a ramp beside it": [Step("x", 0.02, 1e-3), Ramp("x", 0.01, 1e-3, 1e-3)],
    "none": [Step("y", 0.02, 1e-3)],
    "none of its own": [Circle(1e-3, 1.0)],
}


@pytest.mark.parametrize("pieces", PIECES.values(), ids=PIECES)
def test_metrics_of_a_step_are_of_steps_alone(pieces):
    scenario = SimpleNamespace(settings=SimpleNamespace(reference=pieces))
    time = 1e-3 * np.arange(200)
    assert _step(scenario, time, time, time, "x") is None


@pytest.mark.parametrize(("samples", "there"), [(20, True), (19, False)])
def test_a_step_of_twenty_samples_has_metrics(samples, there):
    """A step of zero does not count; the first step counts, and lasts until the next."""
    still, first, later = Step("x", 0.0, 0.0), Step("x", 0.01, 2e-3), Step("x", 0.01 + 1e-3 * samples, 1e-3)
    scenario = SimpleNamespace(settings=SimpleNamespace(reference=[later, still, first]))
    time = 1e-3 * np.arange(200)
    wanted = 2.0 * (time >= 0.0095)
    found = _step(scenario, time, wanted * 1.25, wanted, "x")
    assert (found is not None) is there
    if found is not None:
        assert found.overshoot == pytest.approx(0.25)
    # In a run that begins with its step, the body was at the previous reference.
    begun = SimpleNamespace(settings=SimpleNamespace(reference=[Step("x", 0.0, 2e-3)]))
    assert _step(begun, time, 0 * time + 2.5, 0 * time + 2.0, "x").overshoot == pytest.approx(0.25)


def test_references_before_they_begin_and_after():
    time = np.array([0.0, 0.1, 0.2, 0.3, 0.35])
    assert Ramp("x", 0.1, -2e-3, 0.01).added(time) == pytest.approx([0, 0, -1e-3, -2e-3, -2e-3], abs=1e-10)
    sine = Sine("x", 3e-3, 2.5, at=0.1).added(time)
    assert sine == pytest.approx([0.0, 0.0, 3e-3, 0.0, -3e-3 * np.sqrt(0.5)], abs=1e-9)
    begin = np.array([[1.0, 2.0, 3.0]] * 5)
    circle = Circle(2e-3, -10.0, at=0.2, out_at=0.1, out=5e-3).changed(begin, time, "")
    aside = [[0.0, 0.0], [0.0, 0.0], [2e-3, 0.0], [2e-3 * np.cos(1), -2e-3 * np.sin(1)]]
    np.testing.assert_allclose(circle[:4, :2] - begin[:4, :2], aside, atol=1e-9)
    np.testing.assert_allclose(
        Circle(2e-3, 0.0, at=0.2, out_at=0.0, out=5e-3).changed(begin, time, "")[1, 0], 1.0005
    )
    np.testing.assert_array_equal(circle[:, 2], 3.0)
    assert [len(control_times(duration, 2e-3)) for duration in (1e-4, 0.0029, 0.0031, 0.02)] == [1, 1, 2, 10]
    assert (Step("x", 0.0, 1.0).times, Step("x", 0.0, 1.0).every) == (1, 1.0)


def test_signals_and_forces_last_as_long_as_they_are_told_to():
    time = np.array([0.0, 0.1, 0.2, 0.3])
    signals = [Signal("lift_V", 0.1, 2.0), Signal("y", 0.2, -0.5), Signal("lift_V", 0.3, 1.0)]
    expected = [[0, 0, 0], [2, 0, 0], [2, 0, -0.5], [3, 0, -0.5]]
    np.testing.assert_array_equal(open_loop_signals(signals, time), expected)
    forces = [Disturbance(np.array([1.0, 2.0, 3.0]), 0.1, 0.3), Disturbance(np.array([0, 0, 5.0]), 0.2, 9.0)]
    loads = [[0, 0, 0], [1, 2, 3], [1, 2, 8], [0, 0, 5]]
    np.testing.assert_array_equal(disturbances(forces, time), np.hstack([loads, np.zeros((4, 3))]))
    assert (open_loop_signals((), time), disturbances((), time)) == (None, None)


class Read(SimpleNamespace):
    """A log of signals by name."""

    def __getitem__(self, name):
        return self.signals[name]


def test_a_log_is_laid_over_a_run_at_its_own_times():
    """x and currents between rows of the run; z counts upward, the depth downward from the sensor's zero."""
    run = made()
    experiment = SimpleNamespace(scenario=SCENARIO, device=SimpleNamespace(coil_names=("a", "b")))
    time = np.array([-0.001, 0.005, 0.03, 0.031])
    log = Read(time=time, start=-0.001, signals={"x": 1e-3 * time, "z": -0.08 - time, "b": 5.0 + time})
    laid = lay_over(experiment, run, log)
    np.testing.assert_array_equal(laid.time, [0.005, 0.03])
    assert list(laid.signals) == ["x", "depth", "b"]
    places = true_places()
    half, last = 0.5 * (places[0] + places[1]), places[3]
    for name, unit, measured, simulated in (
        ("x", "mm", [0.005, 0.03], [1e3 * half[0], 1e3 * last[0]]),
        ("depth", "mm", [80 - 77 + 5, 80 - 77 + 30], [-1e3 * half[2] - 77, -1e3 * last[2] - 77]),
        ("b", "A", [5.005, 5.03], [141.5, 144.0]),
    ):
        one = laid.signals[name]
        assert one.unit == unit
        np.testing.assert_allclose(one.measured, measured, rtol=1e-9)
        np.testing.assert_allclose(one.simulated, simulated, rtol=1e-9)
    # The log's begin is moved to 4 ms of the run; at least two of its samples must remain.
    np.testing.assert_allclose(lay_over(experiment, run, log, 0.004).time, [0.004, 0.01])
    received = "0.029 to 0.061 s"
    with refused(InputError, where="lay_over(begins)", must_hold="0 to 0.03 s", received=received):
        lay_over(experiment, run, log, 0.029)
    apart = LaidSignal("A", np.array([1.0, 2.0, 3.0]), np.array([2.0, 2.0, 6.0]))
    told = {"unit": "A", "rms": np.sqrt(10 / 3), "mean": -4 / 3, "largest": 3.0}
    assert apart.to_dict() == pytest.approx(told)
    assert LaidLog(np.zeros(3), {"a": apart}).to_dict()["samples"] == 3
