"""Pictures of docs/remembering_study.md."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from fieldmap.curves import Curves, Series
from fieldmap.plot.figures import save_curves

from .experiments import STEPS, step_run
from .places import AXES, gain
from .unit import Unit

SIZES = np.geomspace(0.005, 0.2, 9)
BEGIN, END = 0.9, 2.5


def draw(both: Mapping[str, Unit], folder: Path) -> Iterator[Path]:
    """Gain over the size of a loop, and a step of the height."""
    yield save_curves(_gains(both), folder / "remembering_gain.png")
    yield save_curves(_step(both), folder / "remembering_step.png")


def _gains(both: Mapping[str, Unit]) -> Curves:
    series = tuple(
        Series(f"{axis}, {name}", SIZES, np.array([gain(one, axis, float(size)) for size in SIZES]))
        for axis in AXES
        for name, one in both.items()
    )
    return Curves(
        "Gain by the size of a loop", "size of the loop of the signal (1)", "gain (mm per unit)", series
    )


def _step(both: Mapping[str, Unit]) -> Curves:
    runs = {name: step_run(one, STEPS[0]) for name, one in both.items()}
    series = []
    for name, run in runs.items():
        shown = run.during(BEGIN, END)
        series.append(Series(name, run.time[shown], run.true[shown, 2]))
    series.append(Series("asked for", run.time[shown], run.wanted[shown, 2], "asked"))
    peak, _, _, overshoot, _ = STEPS[0].rig
    rig = np.array([1.0 + peak]), np.array([11.0 + 0.01 * overshoot])
    series.append(Series("peak of the rig, Table 7-1", *rig, "measured", points=True))
    title = "Step of the height by 1 mm, derivative of the measurement"
    return Curves(title, "time (s)", "depth (mm)", tuple(series))
