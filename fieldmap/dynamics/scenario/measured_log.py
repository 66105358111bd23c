"""A measured log laid over a run: the same times, the same readings, and how far they are apart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fieldmap.arguments import check
from fieldmap.control.identification import Log, read_log
from fieldmap.control.identification.log import QUANTITIES
from fieldmap.dynamics.loop_run import LevitationRun
from fieldmap.dynamics.scenario.experiment import Experiment
from fieldmap.dynamics.scenario.metrics import reading_mm
from fieldmap.dynamics.scenario.references import AXES as AXES
from fieldmap.errors import InputError, Problem
from fieldmap.plain import Plain, plain_items
from fieldmap.records import Record
from fieldmap.typing import Array

ROLES: dict[str, tuple[str, ...]] = {
    "x": ("x", "seen x", "sensed x", "position x"),
    "y": ("y", "seen y", "sensed y", "position y"),
    "depth": ("depth", "reading", "position"),
    "z": ("z", "seen z", "sensed z", "position z"),
}
"""Names by which columns are recognised: x, y and depth as the sensors read; z in the frame of the map."""


@dataclass(frozen=True, eq=False, repr=False)
class LaidSignal(Record):
    """One signal of a log and of a run at the log's times (n,): measured, simulated, in a unit."""

    unit: str
    measured: Array
    simulated: Array

    @property
    def difference(self) -> Array:
        """Measured less simulated."""
        return self.measured - self.simulated

    def to_dict(self) -> dict[str, Plain]:
        """How far they are apart: root of the mean square, mean, largest."""
        apart = self.difference
        rms, largest = np.sqrt(np.mean(apart**2)), np.abs(apart).max()
        return plain_items(unit=self.unit, rms=float(rms), mean=float(apart.mean()), largest=float(largest))


@dataclass(frozen=True, eq=False, repr=False)
class LaidLog(Record):
    """A log over a run. time (n,), s, of the run; signals: x, y, depth in mm, and coils by their names in A, those of
    them that the log holds."""

    time: Array
    signals: Mapping[str, LaidSignal]

    def to_dict(self) -> dict[str, Plain]:
        """Samples, and of every signal how far it is apart."""
        apart = {name: signal.to_dict() for name, signal in self.signals.items()}
        return plain_items(samples=len(self.time), differences=apart)


def read_measured_log(
    path: str | Path,
    coil_names: tuple[str, ...],
    names: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    options: Mapping[str, str] | None = None,
) -> Log:
    """A log with any of x, y, depth, z (m, mm ...) and currents of the coils, whose columns are "current NAME",
    "currents NAME", "I_NAME" or the coil's name.

    names: role -> column; units: column -> unit; options: what the caller calls these, as of `read_log`. Raises
    InputError with every problem of the file.
    """
    known = dict(ROLES)
    for coil in coil_names:
        lower = coil.lower()
        known[coil] = tuple(f"{word}{lower}" for word in ("currents ", "current ", "i_", "coil ", ""))
    found = read_log(path, known, names=names, units=units, options=options, whole_names=True)
    problems = []
    for role, unit in found.units.items():
        wanted = "m" if role in ROLES else "A"
        if unit != wanted:
            column = found.columns[role]
            must = f"must be a unit of {QUANTITIES[wanted]}"
            remedy = f"name another column for {role}, or its unit"
            where = f"{Path(path).name}: column {column.name}"
            problems.append(Problem(where, must, str(column.unit), remedy))
    if not found.signals:
        must = f"must hold one of {', '.join(known)}"
        problems.append(Problem(str(path), must, "none of these columns", "say which: ROLE=NAME"))
    if problems:
        raise InputError(*problems)
    return found


def lay_over(experiment: Experiment, run: LevitationRun, log: Log, begins: float | None = None) -> LaidLog:
    """A log over a run: signals of the run, as they truly were, at the times of the log.

    Samples before or behind the run are left out.

    Parameters
    ----------
    experiment : of the run.
    run : what was simulated.
    log : what was measured.
    begins : time of the run, s, of the log's first sample; its own time unless given.

    Returns
    -------
    The signals that both have.

    Raises
    ------
    InputError
        Where fewer than two samples are left.
    """
    scenario = experiment.scenario
    time = log.time + (0.0 if begins is None else begins - log.start)
    end = run.time[-1] if len(run.time) else 0.0
    within = (time >= -1e-9) & (time <= end + 1e-9)
    must = f"must have two samples or more within the run, 0 to {end:g} s"
    received, remedy = f"{time[0]:g} to {time[-1]:g} s", "say when the log begins in the run"
    check(bool(within.sum() >= 2), "lay_over(begins)", must, received, remedy)
    now, truth = time[within], reading_mm(scenario, run.sensed)
    signals = {}
    for k, axis in enumerate(AXES):
        values = _reading(log.signals, axis, scenario.zero_depth_mm)
        if values is not None:
            signals[axis] = LaidSignal("mm", values[within], np.interp(now, run.time, truth[:, k]))
    for k, coil in enumerate(experiment.device.coil_names):
        if coil in log.signals:
            flowing = np.interp(now, run.time, run.currents[:, k])
            signals[coil] = LaidSignal("A", log[coil][within], flowing)
    return LaidLog(now, signals)


def _reading(signals: Mapping[str, Array], axis: str, zero_mm: float) -> Array | None:
    """x, y or depth in mm; the depth from z where the log has that."""
    if axis in signals:
        return np.asarray(1e3 * signals[axis])
    if axis == "depth" and "z" in signals:
        return np.asarray(-1e3 * signals["z"] - zero_mm)
    return None
