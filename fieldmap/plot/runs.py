"""Pictures of simulated runs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NotRequired, TypedDict

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fieldmap.dynamics.loop_run import LevitationRun
from fieldmap.dynamics.scenario import Experiment, LaidLog, reading_mm
from fieldmap.dynamics.scenario.measured_log import AXES as MEASURED_AXES
from fieldmap.plot.figures import COLOURS
from fieldmap.typing import Array

_LABELS = ("x, mm", "y, mm", "depth, mm")
# Currents that differ by less than this share of the largest are one curve.
_SAME = 1e-3
_MEASURED = "crimson"
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
    it or "", and where there are any `coil_names`. More than one run: true positions only, one line each.
    """
    figure = Figure(figsize=(9.0, 9.0), layout="constrained")
    axes = figure.subplots(4, 1, sharex=True)
    many = len(runs) > 1
    names = runs[0].get("coil_names", range(1, runs[0]["currents"].shape[1] + 1))
    alike = _coils_alike(np.concatenate([run["currents"] for run in runs]))
    for run in runs:
        time = run["time"]
        for k, axis in enumerate(axes[:3]):
            if not many:
                axis.plot(time, run["seen"][:, k], color="0.75", linewidth=0.6, label="seen")
            axis.plot(
                time,
                run["true"][:, k],
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
            _draw_measured(axes, run["measured"], [str(name) for name in names])
        if run["event"]:
            axes[2].annotate(run["event"], (time[-1], run["true"][-1, 2]), fontsize=8, ha="right")
    for k, axis in enumerate(axes[:3]):
        axis.plot(
            runs[0]["time"],
            runs[0]["wanted"][:, k],
            color="black",
            linewidth=0.8,
            linestyle="--",
            label="asked",
        )
        axis.set_ylabel(_LABELS[k])
        axis.grid(True, alpha=0.3)
    axes[2].invert_yaxis()
    if not many:
        # Above the axes: inside there is a curve everywhere.
        axes[0].legend(**_ABOVE)
    axes[3].set_ylabel("currents, A")
    axes[3].legend(**_ABOVE)
    axes[3].set_xlabel("time, s")
    axes[3].grid(True, alpha=0.3)
    figure.suptitle(title, fontsize=10)
    return figure


def _draw_measured(axes: Sequence[Axes], log: LaidLog, coil_names: Sequence[str]) -> None:
    """The signals of a log, dots for currents, which have colours already."""
    for name, signal in log.signals.items():
        if name in MEASURED_AXES:
            axes[MEASURED_AXES.index(name)].plot(
                log.time, signal.measured, color=_MEASURED, linewidth=0.8, label="measured"
            )
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
    run_figure(title, runs).savefig(path, dpi=150)
    return Path(path)
