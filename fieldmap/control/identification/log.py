"""Logs of rigs: evenly sampled signals, read from text files of columns (`fieldmap.inputs.columns`), and written as CSV
with units in the headings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check, check_positive, check_signal
from fieldmap.errors import InputError, Problem
from fieldmap.inputs.columns import (
    QUANTITIES,
    UNITS,
    Column,
    TextColumns,
    columns_of_roles,
    read_columns,
    unit_problems,
)
from fieldmap.records import FrozenDict, Record
from fieldmap.store.whole_files import whole_file
from fieldmap.typing import Array, PathLike

TIME = ("time", "t", "zeit", "timestamp", "elapsed time", "elapsed")
# Steps of time may differ from the mean by this share, because a log rounds its times.
UNEVEN = 0.02
# First line of a log that was written by `write_log`.
WRITTEN = "# Log written by fieldmap"
_OPTIONS = {"delimiter": "read_log(delimiter)", "units": "read_log(units)", "names": "read_log(names)"}


@dataclass(frozen=True, eq=False, repr=False)
class Log(Record):
    """An evenly sampled record. Ts: sampling time, s. start: time of the first sample, s. signals: name -> values (n,)
    in SI units. units: name -> SI unit.

    For a log that was read: columns: by the names or roles of its signals and "time"; delimiter: comma, semicolon, tab
    or blanks; decimal: "." or ",".
    """

    Ts: float
    start: float
    signals: Mapping[str, Array]
    units: Mapping[str, str]
    columns: Mapping[str, Column] = field(default_factory=FrozenDict)
    delimiter: str = "comma"
    decimal: str = "."

    def __getitem__(self, name: str) -> Array:
        must = f"must be one of {', '.join(self.signals)}"
        check(name in self.signals, f"Log[{name!r}]", must, name, "check the name")
        return self.signals[name]

    @property
    def time(self) -> Array:
        """Times of the samples (n,), s."""
        count = len(next(iter(self.signals.values())))
        return self.start + self.Ts * np.arange(count, dtype=np.float64)

    def shown(self, name: str) -> tuple[Array, str]:
        """A signal in the unit in which it was written.

        Parameters
        ----------
        name
            Name of the signal.

        Returns
        -------
        tuple[Array, str]
            The samples, and their unit: SI unless it was read.
        """
        column = self.columns.get(name)
        unit = self.units[name] if column is None else str(column.unit)
        return self[name] / UNITS[unit][1], unit

    def deviations(self, *, rest: int) -> Log:
        """The record minus the mean of its first samples, in which the rig must be at rest.

        Parameters
        ----------
        rest
            Number of these samples.

        Returns
        -------
        Log
            The record.
        """
        check_rest("Log.deviations(rest)", rest, self.time.size)
        moved = {name: values - np.mean(values[:rest]) for name, values in self.signals.items()}
        return replace(self, signals=moved)


def check_rest(where: str, rest: int, samples: int) -> None:
    """Raise InputError unless there is a sample at rest, and a later one."""
    check(1 <= rest < samples, where, f"must be from 1 to {samples - 1} samples", rest, "say how many")


def make_log(Ts: float, signals: Mapping[str, ArrayLike], units: Mapping[str, str]) -> Log:
    """A log of signals from time 0.

    Parameters
    ----------
    Ts
        Sampling time, s.
    signals
        Name -> samples (n,).
    units
        Name -> unit in which the signal is given, such as "mm".

    Returns
    -------
    Log
        The log, in SI units.

    Raises
    ------
    InputError
        For a sampling time that is not positive, signals that are not finite or of unequal lengths, and units
        that are not known.

    Examples
    --------
    >>> log = make_log(2e-3, {"position": [8.0, 8.1]}, {"position": "mm"})
    >>> log["position"].tolist(), log.units["position"]
    ([0.008, 0.0081], 'm')
    """
    check_positive("make_log", Ts=Ts)
    converted, bases = {}, {}
    for name, values in signals.items():
        bases[name], factor = _in_si(f"make_log(units[{name!r}])", units.get(name, ""))
        converted[name] = check_signal(f"make_log(signals[{name!r}])", values) * factor
    shapes = {values.shape for values in converted.values()}
    given = ", ".join(f"{name} {values.shape}" for name, values in converted.items()) or "none"
    must, remedy = "must be signals (n,), all of one length", "give every signal one value per sample"
    alike = len(shapes) == 1 and len(next(iter(shapes))) == 1
    check(alike, "make_log(signals)", must, given, remedy)
    return Log(Ts, 0.0, converted, bases)


def write_log(path: PathLike, log: Log, units: Mapping[str, str] | None = None) -> None:
    """Write the record as CSV with 9 digits, below a line that names fieldmap as the writer.

    Parameters
    ----------
    path
        Path of the file, in .csv. Of existing files only a log that was written here is replaced.
    log
        The record.
    units
        Name -> unit in which the signal is written; SI unless given.

    Raises
    ------
    InputError
        For a unit of another quantity, and for a path that cannot be written, has another ending, or holds a
        file of another origin.
    """
    chosen = {"time": "s", **log.units, **(units or {})}
    columns, headings = [], []
    for name, values in {"time": log.time, **log.signals}.items():
        where, expected = f"write_log(units[{name!r}])", "s" if name == "time" else log.units[name]
        base, factor = _in_si(where, chosen[name])
        check(
            base == expected, where, f"must be a unit of {QUANTITIES[expected]}", chosen[name], "choose one"
        )
        columns.append(values / factor)
        headings.append(f"{name} ({chosen[name]})")
    header = f"{WRITTEN}\n{','.join(headings)}"
    with whole_file(path, "written log") as partial:
        np.savetxt(partial, np.stack(columns, 1), "%.9g", ",", header=header, comments="", encoding="utf-8")


def _in_si(where: str, unit: str) -> tuple[str, float]:
    """SI unit and factor of a unit. Raises InputError for an unknown unit."""
    must = f"must be a unit of {', '.join(UNITS)}"
    check(unit in UNITS, where, must, unit or "no unit", "convert the signal")
    return UNITS[unit]


def read_log(
    path: PathLike,
    roles: Mapping[str, Sequence[str]] | None = None,
    *,
    required: Sequence[str] = (),
    names: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
    sampling_time: float | None = None,
    options: Mapping[str, str] | None = None,
    whole_names: bool = False,
) -> Log:
    """Read a text file of columns below a line of names, such as CSV, and convert it to SI.

    Lines that are not finite numbers, and times that are not evenly spaced, are errors: the user has to
    decide what to do with them.

    Parameters
    ----------
    path
        Path of the file.
    roles
        Role -> names by which its column is recognised, in lower case; only columns with roles are read.
        Unless given, every column is read, under its own name.
    required
        Roles that must have a column.
    names
        Role -> name of its column, instead of recognising it; "time" is a role, too.
    units
        Column -> unit, for a heading without a unit. Units are read from headings such as `name (mm)`,
        `name [mm]`, `name_mm`, `name/mm` or `name in mm`.
    delimiter
        comma, semicolon, tab or blanks; recognised unless given.
    decimal
        "." or ",", recognised unless given.
    sampling_time
        s, for a log without time.
    options
        The caller's names of these options in messages.
    whole_names
        Whether a name must match a whole heading, not only a word of it.

    Returns
    -------
    Log
        The log.

    Raises
    ------
    InputError
        With every problem of the file.
    """
    told, given = {**_OPTIONS, **(options or {})}, dict(units or {})
    if sampling_time is not None:
        check_positive("read_log", sampling_time=sampling_time)
    table = read_columns(Path(path), 2, delimiter, decimal, given, told["delimiter"])
    must, remedy = "must hold a line of names above the numbers", "add one, such as `time (s),x (mm)`"
    check(table.named, f"{table.source}:{table.rows[0][0]}", must, "numbers", remedy)
    timed = {"time": TIME} if sampling_time is None else {}
    known, needed = {**timed, **(roles or {})}, (*timed, *required)
    found, problems = columns_of_roles(table, known, needed, dict(names or {}), told, whole_names)
    if roles is None:
        others = [column for column in table.columns if column not in found.values()]
        each = [column.name for column in others]
        found |= dict(zip(each, others, strict=True))
        problems += [
            Problem(f"{table.source}:1", "must name every column once", name, "rename one")
            for name in sorted({name for name in each if each.count(name) > 1})
        ]
    remedy = "cut the record before or after it; a gap cannot be filled in"
    numbers, wrong = table.numbers(found, remedy)
    problems += unit_problems(table, found, given, told["units"])
    if "time" in found and found["time"].quantity not in (None, "s"):
        where, unit = f"{table.source}: column {found['time'].name}", str(found["time"].unit)
        problems.append(Problem(where, "must be a time", unit, "name another column, or its unit"))
    problems += wrong
    start, Ts = 0.0, sampling_time or 0.0
    if "time" in found and not wrong and not any(p.where.endswith("time") for p in problems):
        time = UNITS[found["time"].unit or "s"][1] * numbers["time"]
        start, Ts = float(time[0]), float((time[-1] - time[0]) / (time.size - 1))
        problems += _sampling_problems(table, time, Ts)
    if problems:
        raise InputError(*problems)
    in_si = {role: UNITS[column.unit or "1"] for role, column in found.items() if role != "time"}
    signals = {role: factor * numbers[role] for role, (_, factor) in in_si.items()}
    return Log(
        Ts,
        start,
        signals,
        {role: unit for role, (unit, _) in in_si.items()},
        found,
        table.delimiter,
        table.decimal,
    )


def _sampling_problems(table: TextColumns, time: Array, Ts: float) -> list[Problem]:
    """Problems of times (n,), s, which must be evenly spaced."""
    off = np.abs(time - time[0] - Ts * np.arange(time.size))
    steps = np.diff(time)
    worst = int(np.argmax(np.abs(steps - Ts)))
    uneven = off.max() > 0.5 * Ts or abs(steps[worst] - Ts) > UNEVEN * Ts
    if Ts > 0 and math.isfinite(Ts) and not uneven:
        return []
    must = f"must be evenly sampled, within {100 * UNEVEN:g} % of the mean step of {Ts:.6g} s"
    remedy = "cut the record at the gap, or resample it yourself: you decide on the values in the gap"
    return [
        Problem(f"{table.source}:{table.rows[worst + 1][0]}", must, f"a step of {steps[worst]:.6g} s", remedy)
    ]
