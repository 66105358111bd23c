"""Experiments of chapters 5 to 7 on the unit: steps, rests under PD control, and parts of `fieldmap thesis`."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fieldmap.thesis.computation import compared, function_of
from fieldmap.thesis.coupled_runs import Readings, run_of
from fieldmap.thesis.horizontal import fitted_times
from fieldmap.thesis.printed import read_part
from fieldmap.thesis.vertical_records import identified
from fieldmap.typing import Array

from .unit import Unit

FIGURES = ("peak, s", "rise, s", "settling, s", "overshoot, %", "RMS at rest, mm")
RUNS = 4


@dataclass(frozen=True)
class Step:
    """A step in a table of the thesis: scenario, changes, axis, and values of the rig (NaN: not stated)."""

    name: str
    scenario: str
    changes: dict[str, str]
    axis: int
    rig: tuple[float, ...]


STEPS = (
    Step("Table 7-1", "vertical_step", {}, 2, (0.2, 0.102, 0.846, 50.0, 0.0182)),
    Step("Table 7-2, x", "horizontal_pid", {}, 0, (np.nan, 0.7, np.nan, 0.0, 0.00823)),
    Step(
        "Table 7-2, y",
        "horizontal_pid",
        {"reference.0.axis": "y"},
        1,
        (np.nan, 0.9, np.nan, 0.0, 0.00812),
    ),
)


def step_figures(unit: Unit, step: Step) -> Array:
    """FIGURES (RUNS, 5) of runs with different noise."""
    rows = []
    for seed in range(RUNS):
        run = step_run(unit, step, seed)
        rows.append([*run.column(step.axis), run.rms(step.axis, 0.75 * run.time[-1])])
    return np.array(rows, dtype=float)


def step_run(unit: Unit, step: Step, seed: int = 0) -> Readings:
    """One run."""
    given = {"map": unit.field, "simulate": unit.simulate}
    return run_of(given, step.scenario, {**step.changes, "noise.seed": seed})


# 6.5: from 0 to 1 mm, to -1 mm and back to 0, in steps of 0.1 mm: begin, s, step, mm, and number of steps.
ROUND = ((2.0, 0.1, 10), (17.0, -0.1, 20), (47.0, 0.1, 10))
EVERY_S, END_S = 1.5, 62.0
ASKED = {0: 0.0, 1: 0.1, 9: 0.9, 10: 1.0, 11: 0.9, 19: 0.1, 20: 0.0, 29: -0.9, 30: -1.0, 31: -0.9, 40: 0.0}
"""Number of steps -> reference, mm."""
RESTS = {
    "x": {0: -0.01, 9: 0.792, 10: 0.882, 11: 0.809, 20: 0.03, 29: -0.778, 30: -0.870, 31: -0.778},
    "y": {1: 0.0618, 19: 0.008},
}
"""Number of steps -> rest position of the rig, mm, by axis."""


def rests(unit: Unit, axis: str) -> list[float]:
    """Rest positions under PD control of an axis at the references ASKED: means of the last 0.7 s, mm."""
    keys, pid = (
        ("at_s", "by_mm", "times"),
        {"kind": "pid", "Kc": 1.0, "Td_s": 6e-5, "lower": -0.4, "upper": 0.4},
    )
    way = [
        {"kind": "step", "axis": axis, "every_s": EVERY_S, **dict(zip(keys, each, strict=True))}
        for each in ROUND
    ]
    free = {f"control.{one}": pid if one == axis else {"kind": "constant"} for one in "xy"}
    start = {f"start.{axis}_mm": 0.0, "duration_s": END_S}
    given = {"map": unit.field, "simulate": unit.simulate}
    run = run_of(given, "horizontal_pd", {**free, **start, "reference": way})
    ends = [ROUND[0][0] + EVERY_S * steps for steps in ASKED]
    return [run.mean("xy".index(axis), end - 0.7, end - 0.01) for end in ends]


def poles(unit: Unit) -> tuple[Array, Array, Array]:
    """Gains of Table 5-2, slowest pair and zero of (5-15) from steps of the unit."""
    steps, pairs, zeros = identified(unit.inputs("S16_records"))
    return np.array(list(steps)), pairs, zeros


def integral_times(unit: Unit) -> list[float]:
    """Integral times, s, with which the thesis's first-order model responds as the unit does: Figs 6-20, 6-24, 6-25."""
    return fitted_times(unit.inputs("S17_records"))[2]


def rows(unit: Unit, part: str) -> Iterator[tuple[str, float, float]]:
    """Quantities of a part of `fieldmap thesis`, the thesis's numbers, and the numbers of this unit."""
    printed = read_part(part)
    answers = function_of(part)(unit.inputs(part))
    for one in compared(part, printed, answers):
        yield f"{one.name}: {one.quantity}", one.thesis, one.ours
    for name, fact in answers.facts.items():
        for k, value in enumerate(np.ravel(np.array(fact, dtype=object))):
            if isinstance(value, int | float):
                yield f"{name}[{k}]", np.nan, float(value)
            else:
                yield f"{name}[{k}]: {value}", np.nan, np.nan
