"""Pictures of simulated runs."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NotRequired, TypedDict

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from fieldmap.curves import percent
from fieldmap.dynamics.loop_run import LevitationRun
from fieldmap.dynamics.scenario import Experiment, LaidLog, reading_mm
from fieldmap.dynamics.scenario.measured_log import AXES as MEASURED_AXES
from fieldmap.plot.style import COLOURS, INK, add_heading, grouped, new_figure, save_figure
from fieldmap.typing import Array, PathLike

_NAMES = ("x", "y", "depth")
_SMALL = 0.5
"""Readings below this, in mm, are drawn in micrometres."""
_SETTLED = 0.05
"""Of a step: nearer than this share of it a reading has arrived."""
_TRUE, _MEASURED, *_ = COLOURS
_LINES = ("-", "--", ":", "-.")
# Currents that differ by less than this share of the largest are one curve.
_SAME = 1e-3
_ABOVE: dict[str, Any] = {
    "loc": "lower right",
    "bbox_to_anchor": (1.0, 1.0),
    "ncols": 6,
    "borderaxespad": 0.1,
}


class DrawnRun(TypedDict):
    """One run: `time` (r,), s; `wanted`, `true` and `seen` (r, 3), readings in mm; `currents` (r, n), A; `coil_names`;
    `measured`: a log over it; `event`: what ended it, or ""; `varied`: the values of the varied keys, by key."""

    time: Array
    wanted: Array
    true: Array
    seen: Array
    currents: Array
    coil_names: NotRequired[Sequence[str]]
    measured: NotRequired[LaidLog]
    event: str
    varied: NotRequired[Mapping[str, object]]


def drawn_run(
    experiment: Experiment, run: LevitationRun, event: str, varied: Mapping[str, object] | None = None
) -> DrawnRun:
    """What is drawn of a run of an experiment."""
    about: Any = {"coil_names": experiment.device.coil_names, "event": event, "varied": varied or {}}
    if not len(run.time):
        # A run that ended at once is drawn as one sample.
        names, nothing = ("wanted", "true", "seen"), np.zeros((1, 3))
        return (
            dict.fromkeys(names, nothing)
            | {"time": np.zeros(1), "currents": np.zeros((1, run.coils))}
            | about
        )
    readings = {"wanted": run.references, "true": run.sensed, "seen": run.seen}
    shown = {name: reading_mm(experiment.scenario, places) for name, places in readings.items()}
    return shown | {"time": run.time, "currents": run.currents} | about


def run_figure(title: str, runs: Sequence[DrawnRun]) -> Figure:
    """References, true and seen positions of each axis, and the currents, over time.

    Above stands what the data say (`run_message`), then the title. Readings below half a millimetre are in micrometres.

    Parameters
    ----------
    title
        Of the figure.
    runs
        One, or several, of which true positions are drawn only, one line each; those with the same values of
        varied keys in one colour, which a legend names.

    Returns
    -------
    Figure
        The figure.
    """
    with new_figure((8.0, 7.6)) as figure:
        *places, lowest = figure.subplots(4, 1, sharex=True)
        for k, axis in enumerate(places):
            factor, unit = _scale(runs, k)
            _draw_readings(axis, runs, k, factor)
            axis.set_ylabel(f"{_NAMES[k]}, {unit}")
        places[2].invert_yaxis()
        if len(runs) == 1:
            # Above the axes: inside there is a curve everywhere.
            places[0].legend(**_ABOVE)
        _draw_currents(lowest, runs)
        lowest.set(xlabel="time, s", ylabel="currents, A")
        lowest.legend(**_ABOVE)
        _add_values(figure, runs)
        add_heading(places[0], run_message(runs), title)
    return figure


def _values(run: DrawnRun) -> tuple[str, ...]:
    """The values of the varied keys, in the order of the keys."""
    return tuple(str(value) for value in run.get("varied", {}).values())


def _look_of_values(number: int) -> dict[str, Any]:
    """Colour, and where the colours are used up also the kind of line, of the runs of one combination of values."""
    return {
        "color": COLOURS[number % len(COLOURS)],
        "linestyle": _LINES[number // len(COLOURS) % len(_LINES)],
    }


def _add_values(figure: Figure, runs: Sequence[DrawnRun]) -> None:
    """A legend of the values of the varied keys below the figure, if there are several."""
    varied = list(dict.fromkeys(_values(run) for run in runs))
    if len(varied) > 1:
        figure.legend(
            [Line2D([], [], **_look_of_values(number)) for number in range(len(varied))],
            [", ".join(values) for values in varied],
            title=", ".join(runs[0].get("varied", {})),
            loc="outside lower center",
            title_fontsize=8,
            ncols=6,
        )


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


def _draw_readings(axis: Axes, runs: Sequence[DrawnRun], k: int, factor: float) -> None:
    """One coordinate: of one run what the sensor says, the truth and a log; of several the truth of each."""
    many = len(runs) > 1
    varied = list(dict.fromkeys(_values(run) for run in runs))
    for run in runs:
        look: dict[str, Any] = (
            {"linewidth": 0.8, "alpha": 0.6} if many else {"linewidth": 1.2, "color": _TRUE}
        )
        if len(varied) > 1:
            look |= _look_of_values(varied.index(_values(run)))
        if not many:
            axis.plot(run["time"], factor * run["seen"][:, k], color="0.75", linewidth=0.6, label="sensor")
        axis.plot(run["time"], factor * run["true"][:, k], label="true", **look)
        log = run.get("measured")
        if log is not None and MEASURED_AXES[k] in log.signals:
            values = factor * log.signals[MEASURED_AXES[k]].measured
            axis.plot(log.time, values, color=_MEASURED, linewidth=0.8, label="measured")
        if run["event"] and k == 2:
            axis.annotate(
                run["event"], (run["time"][-1], factor * run["true"][-1, k]), fontsize=8, ha="right"
            )
    # Values that vary may be those of the start or of the reference.
    for run in {run["wanted"].tobytes(): run for run in runs}.values():
        wanted = factor * run["wanted"][:, k]
        axis.plot(run["time"], wanted, color=INK, linewidth=0.9, linestyle="--", label="reference")


def _draw_currents(axis: Axes, runs: Sequence[DrawnRun]) -> None:
    """Coils of one current as one line; a log as dots, which have the colours of the lines."""
    currents = np.concatenate([run["currents"] for run in runs])
    names = [str(name) for name in runs[0].get("coil_names", range(1, currents.shape[1] + 1))]
    near = _SAME * np.abs(currents).max(initial=0.0)
    # Of curves that lie on each other only one would be seen.
    alike = grouped(
        range(currents.shape[1]),
        lambda one, other: bool(np.abs(currents[:, one] - currents[:, other]).max(initial=0.0) <= near),
    )
    look: dict[str, Any] = {"linewidth": 0.7, "alpha": 0.3 if len(runs) > 1 else 1.0}
    for run in runs:
        for coils in alike:
            of = [names[coil] for coil in coils]
            words = f"coil {of[0]}" if len(of) == 1 else f"coils {', '.join(of)}: the same"
            colour, label = COLOURS[coils[0] % len(COLOURS)], words if run is runs[0] else None
            axis.plot(run["time"], run["currents"][:, coils[0]], color=colour, label=label, **look)
        log = run.get("measured")
        if log is not None:
            for name in log.signals.keys() - set(MEASURED_AXES):
                colour = COLOURS[names.index(name) % len(COLOURS)]
                axis.plot(log.time, log.signals[name].measured, ".", color=colour, markersize=1.5)


def save_run_figure(path: PathLike, title: str, runs: Sequence[DrawnRun]) -> Path:
    """Draw `run_figure` and save it.

    Parameters
    ----------
    path
        Of the file; its suffix says PNG, SVG or PDF.
    title
        Of the figure.
    runs
        What was simulated or measured.

    Returns
    -------
    Path
        The path.
    """
    return save_figure(run_figure(title, runs), path)
