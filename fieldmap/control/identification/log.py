"""Units in the headings of CSV columns."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import LARGEST_NUMBER, check_positive, check_signal
from fieldmap.errors import InputError, Problem
from fieldmap.records import Record
from fieldmap.typing import Array

# unit -> SI unit, factor
UNITS: dict[str, tuple[str, float]] = {
    "s": ("s", 1.0), "ms": ("s", 1e-3), "us": ("s", 1e-6), "µs": ("s", 1e-6), "min": ("s", 60.0),
    "m": ("m", 1.0), "cm": ("m", 1e-2), "mm": ("m", 1e-3), "um": ("m", 1e-6), "µm": ("m", 1e-6),
    "A": ("A", 1.0), "mA": ("A", 1e-3), "V": ("V", 1.0), "mV": ("V", 1e-3),
    "T": ("T", 1.0), "mT": ("T", 1e-3), "N": ("N", 1.0), "mN": ("N", 1e-3), "kg": ("kg", 1.0), "g": ("kg", 1e-3),
    "rad": ("rad", 1.0), "deg": ("rad", 0.017453292519943295), "1": ("1", 1.0),
}  # fmt: skip
_QUANTITIES = {"s": "time", "m": "length", "A": "current", "V": "voltage", "T": "flux density", "N": "force"}
_QUANTITIES |= {"kg": "mass", "rad": "angle", "1": "numbers without unit"}
_HEADING = re.compile(r"^\s*(?P<name>[^()]*\S)\s*\((?P<unit>[^()]*)\)\s*$")


def in_si(where: str, unit: str) -> tuple[str, float]:
    """SI unit and factor of a unit. Raises InputError for one that is not in the table."""
    if unit not in UNITS:
        raise InputError(_unknown(where, unit))
    return UNITS[unit]


def named_unit(unit: str) -> str:
    """The quantity that an SI unit measures, in words."""
    return _QUANTITIES[unit]


def split_heading(where: str, heading: str) -> tuple[str, str, float] | Problem:
    """Name, SI unit and factor of `name (unit)`, or what is wrong with it."""
    match = _HEADING.match(heading)
    if not match:
        return Problem(
            f"{where}:1",
            "must give every column as `name (unit)`, (1) for numbers without unit",
            heading.strip() or "an empty heading",
            "write, for one: time (s),position (mm),current (A)",
        )
    unit = match["unit"].strip()
    if unit not in UNITS:
        return _unknown(f"{where}:1 column {match['name']}", unit)
    return match["name"], *UNITS[unit]


def _unknown(where: str, unit: str) -> Problem:
    return Problem(where, f"must be a unit of {', '.join(UNITS)}", unit or "no unit", "convert the column")


# Times may be off the even grid by this share of the sampling time: rounding of a log's printed times.
UNEVEN = 0.02


@dataclass(frozen=True, eq=False, repr=False)
class Log(Record):
    """An evenly sampled record. Ts: sampling time, s. start: time of the first sample, s. signals: name -> values (n,)
    in SI units. units: name -> SI unit."""

    Ts: float
    start: float
    signals: Mapping[str, Array]
    units: Mapping[str, str]

    def __getitem__(self, name: str) -> Array:
        if name not in self.signals:
            raise InputError(
                Problem(f"Log[{name!r}]", f"must be one of {', '.join(self.signals)}", name, "check the name")
            )
        return self.signals[name]

    @property
    def time(self) -> Array:
        """Times of the samples (n,), s."""
        count = len(next(iter(self.signals.values())))
        return self.start + self.Ts * np.arange(count, dtype=np.float64)

    def deviations(self, *, rest: int) -> Log:
        """The same record from the mean of its first `rest` samples, in which the rig must be at rest."""
        count = self.time.size
        if not 1 <= rest < count:
            raise InputError(
                Problem(
                    "Log.deviations(rest)",
                    f"must be from 1 to {count - 1} samples",
                    f"{rest}",
                    "say how many",
                )
            )
        moved = {name: values - np.mean(values[:rest]) for name, values in self.signals.items()}
        return Log(self.Ts, self.start, moved, self.units)


def read_log(path: str | Path) -> Log:
    """A CSV file with units in its header, converted to SI.

    Raises InputError with every problem of the header at once, or with the first lines that are not numbers, not
    finite, or whose times are not even: these need a person's decision, and are not mended in silence.
    """
    source = Path(path)
    heading, rows = _rows(source)
    columns = [split_heading(source.name, text) for text in heading]
    problems = [column for column in columns if isinstance(column, Problem)]
    names = [column[0] for column in columns if not isinstance(column, Problem)]
    if not problems and (names[0] != "time" or columns[0][1] != "s"):  # type: ignore[index]
        problems.append(
            Problem(
                f"{source.name}:1",
                "must begin with the time, as `time (s)`",
                heading[0],
                "reorder the columns",
            )
        )
    problems += [
        Problem(f"{source.name}:1", "must name every column once", name, "rename one")
        for name in sorted({name for name in names if names.count(name) > 1})
    ]
    if not problems and len(names) < 2:
        problems.append(
            Problem(f"{source.name}:1", "must hold a signal beside the time", heading[0], "add a column")
        )
    if problems:
        raise InputError(*problems)
    values = _numbers(source, rows, len(heading))
    factors = [column[2] for column in columns]  # type: ignore[index]
    table = values * np.array(factors)
    uneven = sampling_problem(source, table[:, 0], [number for number, _ in rows])
    if uneven:
        raise InputError(*uneven)
    Ts = float((table[-1, 0] - table[0, 0]) / (len(table) - 1))
    signals = {name: table[:, i] for i, name in enumerate(names) if i}
    units = {name: columns[i][1] for i, name in enumerate(names) if i}  # type: ignore[index]
    return Log(Ts, float(table[0, 0]), signals, units)


def write_log(path: str | Path, log: Log, units: Mapping[str, str] | None = None) -> None:
    """The record as CSV, each signal in its unit of `units` (name -> unit; SI unless given), 9 digits.

    Raises InputError for a unit that does not measure the same quantity.
    """
    chosen = {"time": "s", **dict(log.units), **dict(units or {})}
    columns = {"time": log.time, **log.signals}
    factors = {}
    for name in columns:
        base, factor = in_si(f"write_log(units[{name!r}])", chosen[name])
        expected = "s" if name == "time" else log.units[name]
        if base != expected:
            raise InputError(
                Problem(
                    f"write_log(units[{name!r}])",
                    f"must be a unit of {named_unit(expected)}",
                    chosen[name],
                    "choose one",
                )
            )
        factors[name] = factor
    lines = [",".join(f"{name} ({chosen[name]})" for name in columns)]
    table = np.stack([values / factors[name] for name, values in columns.items()], axis=1)
    lines += [",".join(f"{value:.9g}" for value in row) for row in table]
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")


def make_log(Ts: float, signals: Mapping[str, ArrayLike], units: Mapping[str, str]) -> Log:
    """A log of signals given in `units` (name -> unit, such as "mm"), from time 0.

    Raises InputError for a sampling time that is not positive, signals that are not finite or of unequal lengths, and
    units that are not known.

    >>> log = make_log(2e-3, {"position": [8.0, 8.1]}, {"position": "mm"})
    >>> log["position"].tolist(), log.units["position"]
    ([0.008, 0.0081], 'm')
    """
    check_positive("make_log", Ts=Ts)
    converted, bases = {}, {}
    for name, values in signals.items():
        bases[name], factor = in_si(f"make_log(units[{name!r}])", units.get(name, ""))
        converted[name] = check_signal(f"make_log(signals[{name!r}])", values) * factor
    shapes = {values.shape for values in converted.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 1:
        must = "must be signals (n,), all of one length"
        given = ", ".join(f"{name} {values.shape}" for name, values in converted.items())
        raise InputError(
            Problem("make_log(signals)", must, given or "none", "give every signal one value per sample")
        )
    return Log(Ts, 0.0, converted, bases)


def _rows(source: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    try:
        text = source.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            Problem(
                str(source),
                "must be a readable CSV file",
                f"{error}",
                "check the path and the encoding (UTF-8)",
            )
        ) from error
    try:
        lines = [
            (number, next(csv.reader([line])))
            for number, line in enumerate(text.splitlines(), start=1)
            if line.strip() and not line.startswith("#")
        ]
    except csv.Error as error:
        must = "must be a readable CSV file"
        raise InputError(Problem(str(source), must, str(error), "correct the line")) from error
    if len(lines) < 3:
        raise InputError(
            Problem(
                str(source),
                "must hold a header and two samples or more",
                f"{len(lines)} lines",
                "record longer",
            )
        )
    return lines[0][1], lines[1:]


def _numbers(source: Path, rows: list[tuple[int, list[str]]], columns: int) -> Array:
    values, problems = np.empty((len(rows), columns)), []
    for i, (number, cells) in enumerate(rows):
        try:
            values[i] = [float(cell) for cell in cells]
            good = (np.abs(values[i]) <= LARGEST_NUMBER).all()
        except ValueError:
            good = False
        if not good:
            problems.append(
                Problem(
                    f"{source.name}:{number}",
                    f"must be {columns} finite numbers",
                    ",".join(cells),
                    "cut the record before or after it; a gap cannot be filled in",
                )
            )
    if problems:
        raise InputError(*problems[:5])
    return values


def sampling_problem(source: Path, time: Array, lines: list[int]) -> list[Problem]:
    """What is wrong with times (n,), s, that must be even; lines (n,): their numbers in the file."""
    Ts = float((time[-1] - time[0]) / (time.size - 1))
    off = np.abs(time - time[0] - Ts * np.arange(time.size))
    steps = np.diff(time)
    worst = int(np.argmax(np.abs(steps - Ts)))
    if not (Ts > 0 and math.isfinite(Ts)) or off.max() > 0.5 * Ts or abs(steps[worst] - Ts) > UNEVEN * Ts:
        return [
            Problem(
                f"{source.name}:{lines[worst + 1]}",
                f"must be evenly sampled, within {100 * UNEVEN:g} % of the mean step of {Ts:.6g} s",
                f"a step of {steps[worst]:.6g} s",
                "cut the record at the gap, or resample it yourself: you decide on the values in the gap",
            )
        ]
    return []
