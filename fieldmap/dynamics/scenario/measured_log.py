"""A measured log compared with a run: both at the times of the log and in the same units, and their differences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fieldmap.arguments import check
from fieldmap.control.identification import Log, read_log
from fieldmap.dynamics.loop_run import LevitationRun
from fieldmap.dynamics.scenario.experiment import Experiment
from fieldmap.dynamics.scenario.metrics import reading_mm
from fieldmap.dynamics.scenario.references import AXES as AXES
from fieldmap.errors import InputError, Problem
from fieldmap.inputs.columns import quantity_problems
from fieldmap.plain import Plain, plain_items
from fieldmap.records import Record
from fieldmap.typing import Array, PathLike

ROLES: dict[str, tuple[str, ...]] = {
    "x": ("x", "seen x", "sensed x", "position x"),
    "y": ("y", "seen y", "sensed y", "position y"),
    "depth": ("depth", "reading", "position"),
    "z": ("z", "seen z", "sensed z", "position z"),
}
"""Names of columns that are recognised. x, y and depth are readings of the sensors; z is in the frame of the map."""


@dataclass(frozen=True, eq=False, repr=False)
class LaidSignal(Record):
    """One signal of a log and of a run, (n,) each, at the times of the log."""

    unit: str
    measured: Array
    simulated: Array

    @property
    def difference(self) -> Array:
        """Measured minus simulated."""
        return self.measured - self.simulated

    def to_dict(self) -> dict[str, Plain]:
        """Root mean square, mean, and largest absolute value of the difference, as plain Python."""
        apart = self.difference
        rms, largest = np.sqrt(np.mean(apart**2)), np.abs(apart).max()
        return plain_items(unit=self.unit, rms=float(rms), mean=float(apart.mean()), largest=float(largest))


@dataclass(frozen=True, eq=False, repr=False)
class LaidLog(Record):
    """A log laid over a run.

    Attributes
    ----------
    time : (n,), time of the run, s.
    signals : the signals that the log holds, by name: x, y, depth in mm, and currents by the names of the coils in A.
    """

    time: Array
    signals: Mapping[str, LaidSignal]

    def to_dict(self) -> dict[str, Plain]:
        """Number of samples, and the difference of every signal, as plain Python."""
        apart = {name: signal.to_dict() for name, signal in self.signals.items()}
        return plain_items(samples=len(self.time), differences=apart)


def read_measured_log(
    path: PathLike,
    coil_names: tuple[str, ...],
    names: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    options: Mapping[str, str] | None = None,
) -> Log:
    """Read a log with some of x, y, depth, z and currents of the coils.

    Columns of currents are "current NAME", "currents NAME", "I_NAME", "coil NAME" or the coil's name.

    Parameters
    ----------
    path
        Path of the file.
    coil_names
        Names of the coils.
    names
        Columns by role, for columns that are not recognised.
    units
        Units by column, if the file does not state them.
    options
        Names of these two arguments in messages: see `read_log`.

    Raises
    ------
    InputError
        With every problem of the file.
    """
    known = dict(ROLES)
    for coil in coil_names:
        lower = coil.lower()
        known[coil] = tuple(f"{word}{lower}" for word in ("currents ", "current ", "i_", "coil ", ""))
    found = read_log(path, known, names=names, units=units, options=options, whole_names=True)
    wanted = {role: "m" if role in ROLES else "A" for role in found.signals}
    columns = {role: found.columns[role] for role in found.signals}
    problems = quantity_problems(Path(path), columns, wanted)
    if not found.signals:
        must = f"must hold one of {', '.join(known)}"
        problems.append(Problem(str(path), must, "none of these columns", "say which: ROLE=NAME"))
    if problems:
        raise InputError(*problems)
    return found


def lay_over(experiment: Experiment, run: LevitationRun, log: Log, begins: float | None = None) -> LaidLog:
    """Lay a log over a run: compare it with the true signals of the run, at the times of the log.

    Samples before or after the run are left out.

    Parameters
    ----------
    experiment
        The experiment of the run.
    run
        The simulated run.
    log
        The measured log.
    begins
        Time of the run, s, at which the log begins; the log's own times are used unless given.

    Returns
    -------
    LaidLog
        The signals that both have.

    Raises
    ------
    InputError
        If fewer than two samples are left.
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
        if axis in log.signals:
            values = 1e3 * log[axis]
        elif axis == "depth" and "z" in log.signals:
            values = -1e3 * log["z"] - scenario.zero_depth_mm
        else:
            continue
        signals[axis] = LaidSignal("mm", values[within], np.interp(now, run.time, truth[:, k]))
    for k, coil in enumerate(experiment.device.coil_names):
        if coil in log.signals:
            flowing = np.interp(now, run.time, run.currents[:, k])
            signals[coil] = LaidSignal("A", log[coil][within], flowing)
    return LaidLog(now, signals)
