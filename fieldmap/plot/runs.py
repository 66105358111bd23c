"""Pictures of simulated runs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NotRequired, TypedDict

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fieldmap.curves import percent
from fieldmap.dynamics.loop_run import LevitationRun
from fieldmap.dynamics.scenario import Experiment, LaidLog, reading_mm
from fieldmap.dynamics.scenario.measured_log import AXES as MEASURED_AXES
from fieldmap.plot.style import COLOURS, INK, QUIET, figure_style, save_figure
from fieldmap.typing import Array

_NAMES = ("x", "y", "depth")
_SMALL = 0.5
"""Readings below this, in mm, are drawn in micrometres."""
_SETTLED = 0.05
"""Of a step: nearer than this share of it a reading has arrived."""
DOTS_PER_INCH = 150
# Currents that differ by less than this share of the largest are one curve.
_SAME = 1e-3
_MEASURED = COLOURS[1]
_ABOVE: dict[str, Any] = {
    "loc": "lower right",
    "bbox_to_anchor": (1.0, 1.0),
    "fontsize": 8,
    "ncols": 6,
    "frameon": False,
    "borderaxespad": 0.1,
}


class DrawnRun(TypedDict):
    """One run: `time` (r,), s; `wanted`, `true` and `seen` (r, 3), readings in mm; `currents` (r, n), A; `coil_names`;
    `measured`: a log over it; `event`: what ended it, or ""."""

    time: Array
    wanted: Array
    true: Array
    seen: Array
    currents: Array
    coil_names: NotRequired[Sequence[str]]
    measured: NotRequired[LaidLog]
    event: str


def drawn_run(experiment: Experiment, run: LevitationRun, event: str) -> DrawnRun:
    """What is drawn of a run of an experiment."""
    scenario, empty = experiment.scenario, np.zeros((1, 3))
    some = len(run.time) > 0
    return {
        "time": run.time if some else np.zeros(1),
        "wanted": reading_mm(scenario, run.references) if some else empty,
        "true": reading_mm(scenario, run.sensed) if some else empty,
        "seen": reading_mm(scenario, run.seen) if some else empty,
        "currents": run.currents if some else np.zeros((1, run.coils)),
        "coil_names": experiment.device.coil_names,
        "event": event,
    }


def run_figure(title: str, runs: Sequence[DrawnRun]) -> Figure:
    """References, true and seen positions of each axis, and the currents, over time.

    runs: of each run `time` (r,), s, `wanted`, `true` and `seen` (r, 3), mm, `currents` (r, n), A, `event`, what ended
    it or "", and where there are any `coil_names`. More than one run: true positions only, one line each. Above stands
    what the data say (`run_message`), then the title. Readings below half a millimetre are in micrometres.
    """
    with figure_style():
        figure = Figure(figsize=(8.0, 7.6), dpi=DOTS_PER_INCH)
        FigureCanvasAgg(figure)
        _draw_runs(figure, runs)
        figure.axes[0].set_title(run_message(runs), loc="left", fontsize=11, fontweight="bold", pad=24)
        figure.axes[0].annotate(
            title,
            (0.0, 1.0),
            xycoords="axes fraction",
            xytext=(0.0, 9.0),
            textcoords="offset points",
            color=QUIET,
            annotation_clip=False,
        )
    return figure


def run_message(runs: Sequence[DrawnRun]) -> str:
    """What runs show, from their readings: how far and how fast a step was followed, or how well a place was held."""
    ended = sum(bool(run["event"]) for run in runs)
    if len(runs) > 1:
        worst = max(_largest_error(run) for run in runs)
        of = "none ended early" if not ended else f"{ended} ended early"
        return f"{len(runs)} runs, {of}; at most {_length(worst)} from what was asked"
    (run,) = runs
    if run["event"]:
        return f"Ended after {run['time'][-1]:.3g} s: {run['event']}"
    steps = run["wanted"][-1] - run["wanted"][0]
    axis = int(np.argmax(np.abs(steps)))
    moves = np.flatnonzero(np.abs(np.diff(run["wanted"][:, axis])) > 1e-9)
    if not steps[axis] or len(moves) != 1:
        return f"At most {_length(_largest_error(run))} from what was asked"
    return _step_in_words(run, axis, int(moves[0]), float(steps[axis]))


def _step_in_words(run: DrawnRun, axis: int, start: int, step: float) -> str:
    """Overshoot and settling of one step after sample `start`, mm."""
    off = (run["true"][start:, axis] - run["wanted"][-1, axis]) / step
    after = run["time"][start:] - run["time"][start]
    outside = np.flatnonzero(np.abs(off) > _SETTLED)
    arrived = "not there at the end"
    if outside.size and outside[-1] + 1 < len(after):
        arrived = f"within {percent(_SETTLED)} after {after[outside[-1] + 1]:.2g} s"
    over = percent(max(float(off.max()), 0.0))
    return f"A step of {_length(abs(step))} in {_NAMES[axis]}: overshoot {over}, {arrived}"


def _largest_error(run: DrawnRun) -> float:
    """Of the true readings, in any direction, mm."""
    return float(np.linalg.norm(run["true"] - run["wanted"], axis=1).max())


def _length(millimetres: float) -> str:
    """To two digits, in a unit that fits.

    >>> _length(0.0123), _length(1.0)
    ('12 µm', '1 mm')
    """
    factor, unit = (1e3, "µm") if millimetres < _SMALL else (1.0, "mm")
    return f"{float(f'{factor * millimetres:.2g}'):g} {unit}"


def _scale(runs: Sequence[DrawnRun], axis: int) -> tuple[float, str]:
    """Factor from millimetres, and the unit, for one axis."""
    shown = np.concatenate([values[:, axis] for run in runs for values in (run["true"], run["wanted"])])
    largest = float(np.abs(shown[np.isfinite(shown)]).max(initial=0.0))
    return (1e3, "µm") if 0.0 < largest < _SMALL else (1.0, "mm")


def _draw_runs(figure: Figure, runs: Sequence[DrawnRun]) -> None:
    axes = figure.subplots(4, 1, sharex=True)
    scales = [_scale(runs, axis) for axis in range(3)]
    many = len(runs) > 1
    names = runs[0].get("coil_names", range(1, runs[0]["currents"].shape[1] + 1))
    alike = _coils_alike(np.concatenate([run["currents"] for run in runs]))
    for run in runs:
        time = run["time"]
        for k, axis in enumerate(axes[:3]):
            if not many:
                axis.plot(time, scales[k][0] * run["seen"][:, k], color="0.75", linewidth=0.6, label="sensor")
            axis.plot(
                time,
                scales[k][0] * run["true"][:, k],
                color=None if many else COLOURS[0],
                linewidth=0.8 if many else 1.2,
                alpha=0.6 if many else 1.0,
                label="true",
            )
        for coils in alike:
            axes[3].plot(
                time,
                run["currents"][:, coils[0]],
                color=COLOURS[coils[0] % len(COLOURS)],
                linewidth=0.7,
                alpha=0.3 if many else 1.0,
                label=_label([str(names[coil]) for coil in coils]) if run is runs[0] else None,
            )
        if "measured" in run:
            _draw_measured(axes, run["measured"], [str(name) for name in names], scales)
        if run["event"]:
            axes[2].annotate(
                run["event"], (time[-1], scales[2][0] * run["true"][-1, 2]), fontsize=8, ha="right"
            )
    for k, axis in enumerate(axes[:3]):
        axis.plot(
            runs[0]["time"],
            scales[k][0] * runs[0]["wanted"][:, k],
            color=INK,
            linewidth=0.9,
            linestyle="--",
            label="reference",
        )
        axis.set_ylabel(f"{_NAMES[k]}, {scales[k][1]}")
    axes[2].invert_yaxis()
    if not many:
        # Above the axes: inside there is a curve everywhere.
        axes[0].legend(**_ABOVE)
    axes[3].set_ylabel("currents, A")
    axes[3].legend(**_ABOVE)
    axes[3].set_xlabel("time, s")


def _draw_measured(
    axes: Sequence[Axes], log: LaidLog, coil_names: Sequence[str], scales: Sequence[tuple[float, str]]
) -> None:
    """The signals of a log, dots for currents, which have colours already."""
    for name, signal in log.signals.items():
        if name in MEASURED_AXES:
            k = MEASURED_AXES.index(name)
            values = scales[k][0] * signal.measured
            axes[k].plot(log.time, values, color=_MEASURED, linewidth=0.8, label="measured")
        else:
            colour = COLOURS[coil_names.index(name) % len(COLOURS)]
            axes[3].plot(log.time, signal.measured, ".", color=colour, markersize=1.5)


def _coils_alike(currents: Array) -> list[list[int]]:
    """Coils whose currents (r, n) are the same curve, of which only one would be seen."""
    beside = _SAME * np.abs(currents).max(initial=0.0)
    groups: list[list[int]] = []
    for coil, current in enumerate(currents.T):
        for group in groups:
            if np.abs(current - currents[:, group[0]]).max(initial=0.0) <= beside:
                group.append(coil)
                break
        else:
            groups.append([coil])
    return groups


def _label(names: list[str]) -> str:
    return f"coil {names[0]}" if len(names) == 1 else f"coils {', '.join(names)}: the same"


def save_run_figure(path: str | Path, title: str, runs: Sequence[DrawnRun]) -> Path:
    """Draw `run_figure` and save it by the suffix of the path: PNG, SVG or PDF."""
    return save_figure(run_figure(title, runs), path)
