"""What a run of a scenario is judged by."""

from collections.abc import Iterator
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
    """Of one axis: root mean square and largest error of the true position against the reference, and of what the
    controller sees, mm; how far it moved, peak to peak, mm; its only or first step, None without one."""

    axis: str
    rms_error_mm: float
    largest_error_mm: float
    rms_seen_mm: float
    travel_mm: float
    step: StepMetrics | None


@dataclass(frozen=True, repr=False)
class RunMetrics(Record):
    """Of a run: its axes; end of it, s; name of the event, "" without one; walls that
    were met, and "currents" beyond the table or the model of the iron; largest lean, deg and current, A. At the end or
    the event: end_mm: sensed point as x, y, depth; end_mm_per_s: velocity along x, y and of the depth; end_A: currents.
    iron: what was taken for it."""

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


def reading_mm(scenario: Scenario, points: Array) -> Array:
    """x, y and depth in mm of sensed points (..., 3), m."""
    return np.asarray(points) * [1e3, 1e3, -1e3] - [0.0, 0.0, scenario.zero_depth_mm]


def run_metrics(scenario: Scenario, run: LevitationRun) -> RunMetrics:
    """The metrics of a run; those of a step are taken over the part of the run from it to the next on its axis."""
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
    )


def _of_axis(
    scenario: Scenario, time: Array, axis: str, true: Array, seen: Array, wanted: Array
) -> AxisMetrics:
    """Of one axis, whose readings are in mm; zeros for a run that ended before its first sample."""
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
    """Place and velocity in the reading of the sensors, and currents, at the event or in the last row."""
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
    """Of the first step of an axis whose reference does nothing else until the next."""
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
