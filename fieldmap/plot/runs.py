"""Pictures of simulated runs."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NotRequired, TypedDict

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from fieldmap.arguments import check
from fieldmap.curves import percent
from fieldmap.dynamics.scenario import LaidLog, ScenarioRun, reading_mm
from fieldmap.dynamics.scenario.measured_log import AXES as MEASURED_AXES
from fieldmap.inputs.tables import is_number
from fieldmap.plot.style import COLOURS, INK, add_heading, grouped, new_figure, save_figure
from fieldmap.store import RunRecord, read_runs
from fieldmap.typing import Array, PathLike

_NAMES = ("x", "y", "depth")
_SMALL = 0.5
"""Readings below this, in mm, are drawn in micrometres."""
_SETTLED = 0.05
"""Share of a step within which a reading has settled."""
_TRUE, _MEASURED, *_ = COLOURS
_LINES = ("-", "--", ":", "-.")
_ASKED: dict[str, Any] = {"color": INK, "linewidth": 0.9, "linestyle": "--"}
_NO_RUN = (
    "must hold a run with samples and the zero of its depth",
    "simulate again, with -o and at most 50 runs",
)
_FEW, _NAMED = 8, 4
"""Runs whose lines are drawn at full strength; runs whose overshoots a message tells."""
# Of a path in a plane: the shorter side, at the least, of the longer one.
_LEAST_SIDE = 0.25
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


def drawn_run(run: ScenarioRun, varied: Mapping[str, object] | None = None) -> DrawnRun:
    """The drawn data of a run of a scenario. varied: the values of the varied keys."""
    about: Any = {"coil_names": run.coil_names, "event": run.metrics.event, "varied": varied or {}}
    if not len(run.time):
        # A run without samples is drawn as one sample.
        names, nothing = ("wanted", "true", "seen"), np.zeros((1, 3))
        return (
            dict.fromkeys(names, nothing)
            | {"time": np.zeros(1), "currents": np.zeros((1, run.coils))}
            | about
        )
    readings = {"wanted": run.references, "true": run.sensed, "seen": run.seen}
    shown = {name: reading_mm(run.scenario, places) for name, places in readings.items()}
    return shown | {"time": run.time, "currents": run.currents} | about


def read_drawn_runs(
    paths: Sequence[PathLike], names: Sequence[str] | None = None
) -> tuple[str, list[DrawnRun]]:
    """The runs of files that `fieldmap simulate -o` wrote, for a common figure by `run_figure`.

    Parameters
    ----------
    paths
        Paths of the files.
    names
        Name of each file's runs in the legend; by default the name of the file. Values of varied keys follow the name.

    Returns
    -------
    tuple[str, list[DrawnRun]]
        The title, which is the scenarios' own, and the runs.

    Raises
    ------
    InputError
        For a file without runs, and for another number of names than of files.
    """
    files = [Path(path) for path in paths]
    stems = [file.stem for file in files]
    usual = stems if len(set(stems)) == len(stems) else [str(file) for file in files]
    given = usual if names is None else list(names)
    must = f"must be {len(files)} names, one for each file"
    check(len(given) == len(files), "read_drawn_runs(names)", must, len(given), "name each file once")
    drawn, titles = [], []
    for file, name in zip(files, given, strict=True):
        records, about = read_runs(file)
        titles.append(about.get("title", ""))
        drawn += [_recorded_run(file, record, name) for record in records]
        check(bool(records), os.fspath(file), _NO_RUN[0], "none", _NO_RUN[1])
    return "; ".join(dict.fromkeys(title for title in titles if title)), drawn


def _recorded_run(file: Path, record: RunRecord, name: str) -> DrawnRun:
    """One recorded run. Raises InputError for a run without samples or with a missing signal."""
    columns = {"time": 0, "reference": 3, "sensed": 3, "seen": 3, "currents": 1}
    zero, samples = record.about.get("zero_depth_mm"), np.size(record.arrays.get("time", ((),))[0])
    check(
        samples > 0 and is_number(zero),
        os.fspath(file),
        _NO_RUN[0],
        "none, or one of an older version",
        _NO_RUN[1],
    )
    for signal, count in columns.items():
        shape = np.shape(record.arrays.get(signal, (0.0,))[0])
        fits = (
            shape == (samples,)
            if not count
            else len(shape) == 2 and shape[0] == samples and shape[1] >= count
        )
        check(fits, os.fspath(file), f"{signal} must have a row for each time", f"shape {shape}", _NO_RUN[1])
    signals = {"wanted": "reference", "true": "sensed", "seen": "seen"}
    shown = {
        key: record.arrays[signal][0][:, :3] * [1e3, 1e3, -1e3] - [0.0, 0.0, float(str(zero))]
        for key, signal in signals.items()
    }
    currents, _, coils = record.arrays["currents"]
    value = record.about.get("value", "")
    about: Any = {
        "time": record.arrays["time"][0],
        "currents": currents,
        "coil_names": coils.split(", "),
        "event": str(record.about.get("event", "")),
        "varied": {"run": f"{name}, {value}" if value else name},
    }
    return shown | about


def run_figure(title: str, runs: Sequence[DrawnRun | ScenarioRun]) -> Figure:
    """References, true and seen positions of each axis, and the currents, over time; of a body that moves mainly in x
    and y also its path in the plane, on the right.

    Above stands what the data say (`run_message`), then the title. Readings below half a millimetre are in micrometres.

    Parameters
    ----------
    title
        Of the figure.
    runs
        Of `simulate`, or as `read_drawn_runs` gives them: one, or several, of which true positions are drawn only, one
        line each; those with the same values of varied keys in one colour, which a legend names. Then currents have
        the colour of their run, too, and a kind of line for each coil.

    Returns
    -------
    Figure
        The figure.
    """
    drawn = [drawn_run(run) if isinstance(run, ScenarioRun) else run for run in runs]
    plane = _in_a_plane(drawn)
    with new_figure((12.0 if plane else 8.0, 7.6)) as figure:
        grid = figure.add_gridspec(4, 2 if plane else 1, width_ratios=(1.5, 1.0) if plane else None)
        first = figure.add_subplot(grid[0, 0])
        *places, lowest = first, *(figure.add_subplot(grid[row, 0], sharex=first) for row in range(1, 4))
        for axis in places:
            axis.tick_params(labelbottom=False)
        for k, axis in enumerate(places):
            factor, unit = _scale(drawn, k)
            _draw_readings(axis, drawn, k, factor)
            axis.set_ylabel(f"{_NAMES[k]}, {unit}")
        places[2].invert_yaxis()
        if len(drawn) == 1:
            # Above the axes: inside there is a curve everywhere.
            places[0].legend(**_ABOVE)
        _draw_currents(lowest, drawn)
        lowest.set(xlabel="time, s", ylabel="currents, A")
        if lowest.get_legend_handles_labels()[1]:
            lowest.legend(**_ABOVE)
        if plane:
            _draw_path(figure.add_subplot(grid[:3, 1]), drawn)
        _add_values(figure, drawn)
        add_heading(places[0], run_message(drawn), title)
    return figure


def _values(run: DrawnRun) -> tuple[str, ...]:
    """The values of the varied keys, in the order of the keys."""
    return tuple(str(value) for value in run.get("varied", {}).values())


def _look_of_values(number: int) -> dict[str, Any]:
    """Colour of the runs with one combination of values, and also a line style when all colours are used."""
    return {
        "color": COLOURS[number % len(COLOURS)],
        "linestyle": _LINES[number // len(COLOURS) % len(_LINES)],
    }


def _add_values(figure: Figure, runs: Sequence[DrawnRun]) -> None:
    """A legend of the values of the varied keys below the figure, if there are several."""
    varied = list(dict.fromkeys(_values(run) for run in runs))
    if len(varied) > 1:
        lines = [Line2D([], [], **_look_of_values(number)) for number in range(len(varied))]
        figure.legend(
            [*lines, Line2D([], [], **_ASKED)],
            [*(", ".join(values) for values in varied), "reference"],
            title=", ".join(runs[0].get("varied", {})),
            loc="outside lower center",
            title_fontsize=8,
            ncols=6,
        )


def run_message(runs: Sequence[DrawnRun]) -> str:
    """Result of the runs from their readings: overshoot and settling of a step, or the largest error at rest."""
    ended = sum(bool(run["event"]) for run in runs)
    steps = [_step_of(run) for run in runs]
    if len(runs) > 1:
        several = len({_values(run) for run in runs}) == len(runs) <= _NAMED
        if several and not ended and None not in steps and len({step and step[::2] for step in steps}) == 1:
            over = (
                f"{', '.join(_values(run))} {_over(run, *step)}"
                for run, step in zip(runs, steps, strict=True)
                if step
            )
            return f"{_step_in_words(*steps[0])}: overshoot {', '.join(over)}" if steps[0] else ""
        worst = max(_largest_error(run) for run in runs)
        of = "none ended early" if not ended else f"{ended} ended early"
        return f"{len(runs)} runs, {of}; at most {_length(worst)} from what was asked"
    (run,), (step,) = runs, steps
    if run["event"]:
        return f"Ended after {run['time'][-1]:.3g} s: {run['event']}"
    if step is None:
        return f"At most {_length(_largest_error(run))} from what was asked"
    return f"{_step_in_words(*step)}: overshoot {_over(run, *step)}, {_arrival(run, *step)}"


def _step_of(run: DrawnRun) -> tuple[int, int, float] | None:
    """Axis, sample and size, mm, of the only step of a reference; None if there is none or more than one."""
    steps = run["wanted"][-1] - run["wanted"][0]
    axis = int(np.argmax(np.abs(steps)))
    moves = np.flatnonzero(np.abs(np.diff(run["wanted"][:, axis])) > 1e-9)
    return (axis, int(moves[0]), round(float(steps[axis]), 9)) if steps[axis] and len(moves) == 1 else None


def _step_in_words(axis: int, start: int, step: float) -> str:
    return f"A step of {_length(abs(step))} in {_NAMES[axis]}"


def _off(run: DrawnRun, axis: int, start: int, step: float) -> Array:
    """Readings after a step less the reference, over the step."""
    return np.asarray((run["true"][start:, axis] - run["wanted"][-1, axis]) / step)


def _over(run: DrawnRun, axis: int, start: int, step: float) -> str:
    return percent(max(float(_off(run, axis, start, step).max()), 0.0))


def _arrival(run: DrawnRun, axis: int, start: int, step: float) -> str:
    after = run["time"][start:] - run["time"][start]
    outside = np.flatnonzero(np.abs(_off(run, axis, start, step)) > _SETTLED)
    if outside.size and outside[-1] + 1 < len(after):
        return f"within {percent(_SETTLED)} after {after[outside[-1] + 1]:.2g} s"
    return "not there at the end"


def _largest_error(run: DrawnRun) -> float:
    """Largest distance of the true readings from the reference, mm."""
    return float(np.linalg.norm(run["true"] - run["wanted"], axis=1).max())


def _length(millimetres: float) -> str:
    """A length to two digits, in a unit that fits.

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


def _look_of_true(runs: Sequence[DrawnRun]) -> list[dict[str, Any]]:
    """Of the lines of true positions, one for each run."""
    varied = list(dict.fromkeys(_values(run) for run in runs))
    thin = len(runs) > (_FEW if len(varied) > 1 else 1)
    look: dict[str, Any] = {"linewidth": 0.8, "alpha": 0.6} if thin else {"linewidth": 1.2, "color": _TRUE}
    numbers = [varied.index(_values(run)) for run in runs]
    return [look | (_look_of_values(number) if len(varied) > 1 else {}) for number in numbers]


def _asked(runs: Sequence[DrawnRun]) -> list[DrawnRun]:
    """A run for each reference: values that vary may be those of the start or of the reference."""
    return list({run["wanted"].tobytes(): run for run in runs}.values())


def _in_a_plane(runs: Sequence[DrawnRun]) -> bool:
    """Whether the references go to and fro in x and in y, and in the depth less; where none moves, the bodies."""
    asked = np.max([np.ptp(run["wanted"], axis=0) for run in runs], axis=0)
    moved = np.max([np.ptp(run["true"], axis=0) for run in runs], axis=0)
    x, y, depth = asked if asked.max() > 1e-9 else moved * (moved > _SMALL)
    return bool(min(x, y) > max(depth, _LEAST_SIDE * max(x, y)))


def _draw_path(axis: Axes, runs: Sequence[DrawnRun]) -> None:
    """x and y of the true positions and of the references, from a dot at the start, both in one unit and scale."""
    factor, unit = min(_scale(runs, 0), _scale(runs, 1))
    for run, look in zip(runs, _look_of_true(runs), strict=True):
        x, y, _ = factor * run["true"].T
        axis.plot(x, y, label="true", **look)
        axis.plot(x[:1], y[:1], "o", color=look.get("color", INK), markersize=5, label="start")
    for run in _asked(runs):
        x, y, _ = factor * run["wanted"].T
        axis.plot(x, y, label="reference", **_ASKED)
    axis.set(xlabel=f"x, {unit}", ylabel=f"y, {unit}", aspect="equal")
    axis.set_title("path from the dot", loc="left")


def _draw_readings(axis: Axes, runs: Sequence[DrawnRun], k: int, factor: float) -> None:
    """One coordinate: of one run what the sensor says, the truth and a log; of several the truth of each."""
    many = len(runs) > 1
    for run, look in zip(runs, _look_of_true(runs), strict=True):
        if not many:
            axis.plot(run["time"], factor * run["seen"][:, k], color="0.75", linewidth=0.6, label="sensor")
        axis.plot(run["time"], factor * run["true"][:, k], label="true", **look)
        log = run.get("measured")
        if log is not None and MEASURED_AXES[k] in log.signals:
            values = factor * log.signals[MEASURED_AXES[k]].measured
            axis.plot(log.time, values, color=_MEASURED, linewidth=0.8, label="measured")
        if run["event"] and k == 2:
            # Above the panel, away from the lines.
            at = (run["time"][-1], 1.02)
            axis.annotate(run["event"], at, xycoords=("data", "axes fraction"), fontsize=8, ha="right")
    for run in _asked(runs):
        axis.plot(run["time"], factor * run["wanted"][:, k], label="reference", **_ASKED)


def _draw_currents(axis: Axes, runs: Sequence[DrawnRun]) -> None:
    """Coils of one current as one line; a log as dots, which have the colours of the lines. Runs of several values of
    varied keys have their colours, and kinds of lines for the coils."""
    varied = list(dict.fromkeys(_values(run) for run in runs))
    if len(varied) > 1:
        # The roughest run is drawn first, so that it does not hide others.
        for run in sorted(runs, key=_roughness, reverse=True):
            look = {"color": _look_of_values(varied.index(_values(run)))["color"], "linewidth": 0.8}
            for number, coils in enumerate(_alike(run["currents"])):
                kind = _LINES[number % len(_LINES)]
                axis.plot(run["time"], run["currents"][:, coils[0]], linestyle=kind, **look)
        return
    names = [str(name) for name in runs[0].get("coil_names", range(1, runs[0]["currents"].shape[1] + 1))]
    look = {"linewidth": 0.7, "alpha": 0.3 if len(runs) > 1 else 1.0}
    alike = _alike(np.concatenate([run["currents"] for run in runs]))
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


def _roughness(run: DrawnRun) -> float:
    return float(np.abs(np.diff(run["currents"], axis=0)).mean()) if len(run["time"]) > 1 else 0.0


def _alike(currents: Array) -> list[list[int]]:
    """Groups of coils with equal currents, whose curves would hide each other."""
    near = _SAME * np.abs(currents).max(initial=0.0)
    return grouped(
        range(currents.shape[1]),
        lambda one, other: bool(np.abs(currents[:, one] - currents[:, other]).max(initial=0.0) <= near),
    )


def save_run_figure(path: PathLike, title: str, runs: Sequence[DrawnRun | ScenarioRun]) -> Path:
    """Draw `run_figure` and save it.

    Parameters
    ----------
    path
        Of the file; its suffix says PNG, SVG or PDF.
    title
        Of the figure.
    runs
        Of `simulate`, or as `read_drawn_runs` gives them.

    Returns
    -------
    Path
        The path.
    """
    return save_figure(run_figure(title, runs), path)
