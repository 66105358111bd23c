"""Runs of the shipped scenarios for rows S16 to S19: simulation, readings in mm, metrics, figures."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.control import PID, StepMetrics, TransferFunction, simulate_loop
from fieldmap.curves import Curves, Series
from fieldmap.dynamics import ScenarioRun, simulate
from fieldmap.dynamics.scenario import reading_mm
from fieldmap.records import Record
from fieldmap.thesis.computation import Ours
from fieldmap.thesis.printed import shared_value
from fieldmap.typing import Array

X, Y, DEPTH = 0, 1, 2
LABELS = ("x (mm)", "y (mm)", "depth (mm)")
VERTICAL_PID: dict[str, Any] = {
    "kind": "pid",
    "Kc": shared_value("section_7_2_1.Kc"),
    "Ti_s": 0.42,
    "Td_s": 0.06,
    "lower": 0.0,
    "upper": 10.0,
}
"""The controller of 7.2.1, with its printed times taken as minutes."""
# Largest number of points of a line in a figure, about the width of the picture in pixels.
_MOST_POINTS = 700


@dataclass(frozen=True, eq=False, repr=False)
class Readings(Record):
    """A run as in the thesis's figures: time (r,), s; true, measured and reference x, y and depth (r, 3), mm."""

    run: ScenarioRun
    time: Array
    true: Array
    seen: Array
    wanted: Array

    def during(self, begin: float, end: float = np.inf) -> NDArray[np.bool_]:
        """Rows (r,) from `begin` to `end`, s."""
        return (self.time >= begin - 1e-9) & (self.time < end)

    def rms(self, axis: int, begin: float, end: float = np.inf) -> float:
        """Root mean square of the measured position less the reference, mm."""
        rows = self.during(begin, end)
        return float(np.sqrt(np.mean((self.seen - self.wanted)[rows, axis] ** 2)))

    def departure(self, axis: int, begin: float, end: float = np.inf) -> float:
        """Largest distance of the measured position from the reference at `begin`, mm."""
        rows = self.during(begin, end)
        return float(np.abs(self.seen[rows, axis] - self.wanted[rows, axis][0]).max())

    def mean(self, axis: int, begin: float, end: float) -> float:
        """Mean of the measured position, mm."""
        return float(self.seen[self.during(begin, end), axis].mean())

    def time_to_reference(self, axis: int, at: float) -> float:
        """Time from a step at `at`, s, until the true position first reaches the reference, s; infinite if never."""
        final, begin = self.wanted[-1, axis], self.wanted[0, axis]
        there = self.during(at) & ((self.true[:, axis] - final) * np.sign(final - begin) >= 0.0)
        return float(self.time[np.argmax(there)] - at) if there.any() else np.inf

    def step(self, axis: int) -> StepMetrics:
        """Metrics of the first step of an axis, from the true position."""
        found = self.run.metrics.axes[axis].step
        assert found is not None
        return found

    def column(self, axis: int) -> list[float]:
        """Peak, rise and settling time of the first step, s, and overshoot, %, as the thesis's tables have them."""
        step = self.step(axis)
        return [step.peak_time, step.rise_time, step.settling_time, 100 * step.overshoot]


def run_of(inputs: Mapping[str, Any], scenario: str, changes: Mapping[str, Any] | None = None) -> Readings:
    """Run a shipped scenario on the row's map; inputs["simulate"] may replace `simulate`."""
    run = inputs.get("simulate", simulate)(scenario, dict(changes or {}), field_map=inputs["map"])
    true, seen, wanted = (reading_mm(run.scenario, p) for p in (run.sensed, run.seen, run.references))
    return Readings(run, run.time, true, seen, wanted)


def runs_of(
    inputs: Mapping[str, Any], scenario: str, changes: Mapping[str, Mapping[str, Any]]
) -> dict[str, Readings]:
    """Run a scenario with each of several named changes."""
    return {name: run_of(inputs, scenario, one) for name, one in changes.items()}


def ours(value: Any, *readings: Readings) -> Ours:
    """A number with all assumptions of its runs."""
    names = dict.fromkeys(f"`{one.run.scenario.path.stem}`" for one in readings)
    word = "scenario" if len(names) == 1 else "scenarios"
    texts = [f"{word} {', '.join(names)}, whose files name every choice; controller times taken as minutes"]
    return Ours(value, tuple(dict.fromkeys([*texts, *(a for one in readings for a in one.run.assumptions)])))


def over_time(
    title: str,
    axis: int,
    readings: Mapping[str, Readings],
    *,
    begin: float = 0.0,
    end: float = np.inf,
    remark: str = "",
    asked: bool = True,
    models: Mapping[str, Array] | None = None,
) -> Curves:
    """Measured position along one axis in one or more runs, and the references. models: responses (r,), mm, of the
    thesis's models at the times of the first run."""
    series: list[Series] = []
    for name, one in readings.items():
        rows = _thinned(one.during(begin, end))
        series.append(Series(name, one.time[rows], one.seen[rows, axis]))
    first = next(iter(readings.values()))
    rows = _thinned(first.during(begin, end))
    series += [Series(name, first.time[rows], y[rows], "published") for name, y in (models or {}).items()]
    if asked:
        series += _asked(axis, readings, begin, end)
    return Curves(title, "time (s)", LABELS[axis], tuple(series), remark)


def _asked(axis: int, readings: Mapping[str, Readings], begin: float, end: float) -> list[Series]:
    """The references, each drawn once."""
    series: dict[bytes, Series] = {}
    for one in readings.values():
        rows = _thinned(one.during(begin, end))
        line = Series("asked for", one.time[rows], one.wanted[rows, axis], "asked")
        series.setdefault(line.y.tobytes(), line)
    return list(series.values())


def with_measured(curves: Curves, name: str, x: ArrayLike, y: ArrayLike, *, points: bool = True) -> Curves:
    """The same figure with values measured on the thesis's rig: markers, or a level from x[0] to x[1]."""
    rig = Series(name, np.asarray(x, dtype=float), np.asarray(y, dtype=float), "measured", points=points)
    return replace(curves, series=(*curves.series, rig))


def beside_models(
    title: str, axis: int, run: Readings, models: Mapping[str, tuple[TransferFunction, PID]], **shown: Any
) -> Curves:
    """A run, and responses of closed-loop models (plant, controller) to its reference; shown: as in `over_time`."""
    begin = run.wanted[0, axis]
    asked = run.wanted[:, axis] - begin
    answers = {name: begin + simulate_loop(*model, asked).y[0] for name, model in models.items()}
    return over_time(title, axis, {"coupled machine": run}, models=answers, **shown)


def in_the_plane(title: str, run: Readings, begin: float) -> Curves:
    """Measured path in the x-y plane, and its reference."""
    rows = _thinned(run.during(begin))
    series = (
        Series("path", run.seen[rows, X], run.seen[rows, Y]),
        Series("asked for", run.wanted[rows, X], run.wanted[rows, Y], "asked"),
    )
    return Curves(title, LABELS[X], LABELS[Y], series, equal=True)


def _thinned(rows: NDArray[np.bool_]) -> NDArray[np.intp]:
    chosen = np.flatnonzero(rows)
    return chosen[:: max(1, -(-len(chosen) // _MOST_POINTS))]
