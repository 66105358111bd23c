"""Metrics of a run of a scenario."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fieldmap.control import StepMetrics, step_metrics
from fieldmap.core.machine import STATE, VELOCITY, sensed_point
from fieldmap.dynamics.loop_run import IronUse, LevitationRun
from fieldmap.dynamics.scenario.references import AXES, Step
from fieldmap.dynamics.scenario.schema import Scenario
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True, repr=False)
class AxisMetrics(Record):
    """Metrics of one axis.

    Attributes
    ----------
    axis : "x", "y" or "depth".
    rms_error_mm : root mean square of the true position minus the reference.
    largest_error_mm : largest absolute value of it.
    rms_seen_mm : root mean square of the measured position minus the reference.
    travel_mm : range of the true position, peak to peak.
    step : metrics of the first step of the reference; None if there is none.
    """

    axis: str
    rms_error_mm: float
    largest_error_mm: float
    rms_seen_mm: float
    travel_mm: float
    step: StepMetrics | None


@dataclass(frozen=True, repr=False)
class RunMetrics(Record):
    """Metrics of a run.

    Attributes
    ----------
    axes : metrics of x, y and depth.
    end_s : time of the end.
    event : name of the event that ended the run; "" if there was none.
    touched : walls that the body touched, and "currents" if currents left the table or the model of the iron.
    largest_lean_deg, largest_current_A : over the run.
    end_mm : sensed point at the end, as x, y, depth.
    end_mm_per_s : its velocity along x, y and depth.
    end_A : currents at the end.
    iron : how the field of the iron was computed.
    hottest_degC : highest temperature of a winding; None where windings do not warm up.
    too_hot_s : when the first winding was hotter than its limit; None if none was.
    """

    axes: tuple[AxisMetrics, ...]
    end_s: float
    event: str
    touched: tuple[str, ...]
    largest_lean_deg: float
    largest_current_A: float
    end_mm: tuple[float, float, float]
    end_mm_per_s: tuple[float, float, float]
    end_A: tuple[float, ...]
    iron: IronUse
    hottest_degC: float | None = None
    too_hot_s: float | None = None

    def __str__(self) -> str:
        return "\n".join(_lines(self))


def _lines(metrics: RunMetrics) -> Iterator[str]:
    x, y, depth = (f"{value:.3f}" for value in metrics.end_mm)
    amperes = ", ".join(f"{value:.3g}" for value in metrics.end_A)
    how = metrics.event or "its end"
    yield f"{how} at {metrics.end_s:.4g} s: x {x}, y {y}, depth {depth} mm; currents {amperes} A"
    for axis in metrics.axes:
        step = "" if axis.step is None else f"; step {_of_step(axis.step)}"
        off = f"{axis.rms_error_mm:.4f} mm rms off its reference, {axis.largest_error_mm:.4f} at most"
        yield f"{axis.axis}: {off}{step}"
    yield f"largest lean {metrics.largest_lean_deg:.2f} degrees, current {metrics.largest_current_A:.3f} A"
    if metrics.touched:
        yield f"touched: {', '.join(metrics.touched)}"
    if metrics.iron.solves:
        yield f"iron solved at {metrics.iron.solves} steps; {metrics.iron.unsolved} did not converge"


def _of_step(step: StepMetrics) -> str:
    settles = bool(np.isfinite(step.settling_time))
    settled = f"settles in {step.settling_time:.3g} s" if settles else "does not settle"
    return f"overshoots by {100.0 * step.overshoot:.1f} %, {settled}"


def over_runs(each: Sequence[float]) -> float:
    """The root mean square over several runs, from the root mean square of each."""
    return float(np.sqrt(np.mean(np.square(each))))


def reading_mm(scenario: Scenario, points: Array) -> Array:
    """x, y and depth in mm of sensed points (..., 3), m."""
    return np.asarray(points) * [1e3, 1e3, -1e3] - [0.0, 0.0, scenario.zero_depth_mm]


def run_metrics(scenario: Scenario, run: LevitationRun) -> RunMetrics:
    """The metrics of a run. The metrics of a step are those from this step to the next one on its axis.

    Parameters
    ----------
    scenario
        The scenario.
    run
        Its run.

    Returns
    -------
    RunMetrics
        The metrics.
    """
    signals = [reading_mm(scenario, points).T for points in (run.sensed, run.seen, run.references)]
    end, name = (run.event.time, run.event.name) if run.event else (run.time.max(initial=0.0), "")
    return RunMetrics(
        tuple(_of_axis(scenario, run.time, axis, *each) for axis, *each in zip(AXES, *signals, strict=True)),
        float(end),
        name,
        run.touched,
        float(np.rad2deg(run.tilt.max(initial=0.0))),
        float(np.abs(run.currents).max(initial=0.0)),
        *_end(scenario, run),
        run.iron,
        *_heat(run),
    )


def _heat(run: LevitationRun) -> tuple[float | None, float | None]:
    """Highest temperature of a winding, degC, and when the first one was too hot, s."""
    if run.windings is None or not (run.temperatures != run.temperatures[:1]).any():
        return None, None
    times = run.windings.too_hot[np.isfinite(run.windings.too_hot)]
    return float(run.temperatures.max()), float(times.min()) if len(times) else None


def _of_axis(
    scenario: Scenario, time: Array, axis: str, true: Array, seen: Array, wanted: Array
) -> AxisMetrics:
    """Metrics of one axis from its readings in mm; zeros for a run that ended before its first sample."""
    if not len(time):
        return AxisMetrics(axis, 0.0, 0.0, 0.0, 0.0, None)
    error, seen_error = true - wanted, seen - wanted
    return AxisMetrics(
        axis,
        float(np.sqrt(np.mean(error**2))),
        float(np.abs(error).max()),
        float(np.sqrt(np.mean(seen_error**2))),
        float(np.ptp(true)),
        _step(scenario, time, true, wanted, axis),
    )


def _end(scenario: Scenario, run: LevitationRun) -> tuple[Any, Any, tuple[float, ...]]:
    """Position and velocity as the sensors read them, and currents, at the event or in the last row."""
    if run.event is not None:
        state, currents = run.event.state, run.event.currents
    elif len(run.rows):
        state, currents = run.rows[-1, :STATE], run.currents[-1]
    else:
        return (0.0,) * 3, (0.0,) * 3, ()
    point = sensed_point(np.ascontiguousarray(state), run.seen_at)
    speed = state[VELOCITY : VELOCITY + 3] * [1e3, 1e3, -1e3]
    return tuple(reading_mm(scenario, point).tolist()), tuple(speed.tolist()), tuple(currents.tolist())


def _step(scenario: Scenario, time: Array, true: Array, wanted: Array, axis: str) -> StepMetrics | None:
    """Metrics of the first step of an axis; None unless all changes of its reference are steps."""
    moves = [piece for piece in scenario.settings.reference if piece.moves(axis)]
    pieces = [piece for piece in moves if getattr(piece, "by", None) != 0.0]
    steps = sorted((piece for piece in pieces if isinstance(piece, Step)), key=lambda piece: piece.at)
    if not steps or len(steps) != len(pieces):
        return None
    ends = steps[1].at if len(steps) > 1 else np.inf
    if steps[0].times > 1:
        ends = min(ends, steps[0].at + steps[0].every)
    part = (time >= steps[0].at - 1e-9) & (time < ends - 1e-9)
    before = true[time < steps[0].at - 1e-9]
    if part.sum() < 20:
        return None
    final = float(wanted[part][-1])
    initial = float(before[-1]) if len(before) else final - 1e3 * steps[0].by
    return step_metrics(time[part], true[part], initial=initial, final=final)
