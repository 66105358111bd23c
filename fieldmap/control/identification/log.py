"""Logs of rigs: evenly sampled signals, read from text files whose delimiter, decimal comma, names and units are
recognised, or said by the caller; and written as CSV with units in the headings."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.arguments import LARGEST_NUMBER, check, check_positive, check_signal
from fieldmap.errors import InputError, Problem
from fieldmap.file_contents import read_text
from fieldmap.records import FrozenDict, Record
from fieldmap.typing import Array

# unit -> SI unit, factor
UNITS: dict[str, tuple[str, float]] = {
    "s": ("s", 1.0), "ms": ("s", 1e-3), "us": ("s", 1e-6), "µs": ("s", 1e-6), "min": ("s", 60.0),
    "m": ("m", 1.0), "cm": ("m", 1e-2), "mm": ("m", 1e-3), "um": ("m", 1e-6), "µm": ("m", 1e-6),
    "A": ("A", 1.0), "mA": ("A", 1e-3), "V": ("V", 1.0), "mV": ("V", 1e-3),
    "T": ("T", 1.0), "mT": ("T", 1e-3), "N": ("N", 1.0), "mN": ("N", 1e-3), "kg": ("kg", 1.0), "g": ("kg", 1e-3),
    "rad": ("rad", 1.0), "deg": ("rad", 0.017453292519943295), "1": ("1", 1.0),
}  # fmt: skip
QUANTITIES = {"s": "time", "m": "length", "A": "current", "V": "voltage", "T": "flux density", "N": "force"}
QUANTITIES |= {"kg": "mass", "rad": "angle", "1": "numbers without unit"}
"""What an SI unit measures, in words."""
DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "blanks": " "}
TIME = ("time", "t", "zeit", "timestamp", "elapsed time", "elapsed")
# Times may be off the even grid by this share of the sampling time: rounding of a log's printed times.
UNEVEN = 0.02
# Lines whose cells are counted, and problems of lines that are told one by one.
_LOOKED_AT, _MOST_TOLD = 20, 5
_IN_BRACKETS = re.compile(r"^\s*(?P<name>.*?\S)\s*[(\[](?P<unit>[^()\[\]]*)[)\]]\s*$")
_WITH_SUFFIX = re.compile(r"^\s*(?P<name>.*\S)[_/](?P<unit>[^_/\s]+)\s*$")
_OPTIONS = {"delimiter": "read_log(delimiter)", "units": "read_log(units)", "names": "read_log(names)"}


@dataclass(frozen=True, eq=False, repr=False)
class Column(Record):
    """A column of a log: its number, name, and the unit in which it is written; None where it does not say."""

    number: int
    name: str
    unit: str | None


@dataclass(frozen=True, eq=False, repr=False)
class Log(Record):
    """An evenly sampled record. Ts: sampling time, s. start: time of the first sample, s. signals: name -> values (n,)
    in SI units. units: name -> SI unit.

    Of one that was read, by the names or roles of its signals: columns, and "time"; delimiter: a name of `DELIMITERS`;
    decimal: "." or ",".
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
            Of the signal.

        Returns
        -------
        tuple[Array, str]
            The samples, and their unit: SI unless it was read.
        """
        column = self.columns.get(name)
        unit = self.units[name] if column is None else str(column.unit)
        return self[name] / UNITS[unit][1], unit

    def deviations(self, *, rest: int) -> Log:
        """The same record from the mean of its first samples, in which the rig must be at rest.

        Parameters
        ----------
        rest
            How many samples.

        Returns
        -------
        Log
            The record.
        """
        check_rest("Log.deviations(rest)", rest, self.time.size)
        moved = {name: values - np.mean(values[:rest]) for name, values in self.signals.items()}
        return replace(self, signals=moved)


def check_rest(where: str, rest: int, samples: int) -> None:
    """A number of samples at rest, with others behind them. Raises InputError."""
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


def write_log(path: str | Path, log: Log, units: Mapping[str, str] | None = None) -> None:
    """Write the record as CSV, 9 digits.

    Parameters
    ----------
    path
        Path of the file.
    log
        The record.
    units
        Name -> unit in which the signal is written; SI unless given.

    Raises
    ------
    InputError
        For a unit that does not measure the same quantity.
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
    header = ",".join(headings)
    np.savetxt(path, np.stack(columns, 1), "%.9g", ",", header=header, comments="", encoding="utf-8")


def _in_si(where: str, unit: str) -> tuple[str, float]:
    """SI unit and factor of a unit. Raises InputError for one that is not in the table."""
    must = f"must be a unit of {', '.join(UNITS)}"
    check(unit in UNITS, where, must, unit or "no unit", "convert the signal")
    return UNITS[unit]


def read_log(
    path: str | Path,
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
    """Read a text file of columns below a line of names, such as CSV; everything is SI once read.

    Lines that are not numbers, not finite, or whose times are not even need a person's decision, and are not
    mended in silence.

    Parameters
    ----------
    path
        Path of the file.
    roles
        Role -> names by which its column is recognised, in lower case; only columns with roles are read.
        Unless given every column is read, under its own name.
    required
        Roles that must be there.
    names
        Role -> name of its column, where that is not to be recognised; "time" is a role of its own.
    units
        Column -> unit, where its heading does not say, as `name (mm)`, `name [mm]`, `name_mm` or `name/mm`
        do.
    delimiter
        A name of `DELIMITERS`, recognised unless given.
    decimal
        "." or ",", recognised unless given.
    sampling_time
        s, for a log without time.
    options
        What the caller calls these in messages.
    whole_names
        Whether a name must be all of a heading, not one of its words.

    Returns
    -------
    Log
        The log.

    Raises
    ------
    InputError
        With every problem of the file.
    """
    source, told, given = Path(path), {**_OPTIONS, **(options or {})}, dict(units or {})
    if sampling_time is not None:
        check_positive("read_log", sampling_time=sampling_time)
    lines = _lines(source)
    try:
        kind = delimiter or _delimiter_of(source, lines, told)
        must = f"must be one of {', '.join(DELIMITERS)}"
        check(kind in DELIMITERS, told["delimiter"], must, kind, "choose one")
        (_, head), *rows = [(number, _cells(line, kind)) for number, line in lines]
    except csv.Error as error:
        must, remedy = "must be columns of numbers", "correct the line that is so long"
        raise InputError.of(str(source), must, str(error), remedy) from None
    columns = [_column(k, text, given) for k, text in enumerate(head)]
    timed = {"time": TIME} if sampling_time is None else {}
    known, needed = {**timed, **(roles or {})}, (*timed, *required)
    found, problems = _assigned(source, columns, known, needed, dict(names or {}), told, whole_names)
    if roles is None:
        others = [column for column in columns if column not in found.values()]
        each = [column.name for column in others]
        found |= dict(zip(each, others, strict=True))
        problems += [
            Problem(f"{source.name}:1", "must name every column once", name, "rename one")
            for name in sorted({name for name in each if each.count(name) > 1})
        ]
    wrong_units = _unit_problems(source, found, given, columns, told)
    mark = decimal or _decimal_of(rows, kind)
    numbers, wrong = _numbers(source, rows, found, len(columns), mark)
    problems += wrong_units + wrong
    start, Ts = 0.0, sampling_time or 0.0
    if "time" in found and not wrong and not any(p.where.endswith("time") for p in problems):
        time = UNITS[found["time"].unit or "s"][1] * numbers["time"]
        start, Ts = float(time[0]), float((time[-1] - time[0]) / (time.size - 1))
        problems += _sampling_problems(source, time, Ts, [number for number, _ in rows])
    if problems:
        raise InputError(*problems)
    in_si = {role: UNITS[column.unit or "1"] for role, column in found.items() if role != "time"}
    signals = {role: factor * numbers[role] for role, (_, factor) in in_si.items()}
    return Log(Ts, start, signals, {role: unit for role, (unit, _) in in_si.items()}, found, kind, mark)


def _lines(source: Path) -> list[tuple[int, str]]:
    """Lines that are neither empty nor comments, with their numbers."""
    text = read_text(source, otherwise="latin-1")
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith(("#", "%", "//"))
    ]
    must = "must hold a line of names and two samples or more"
    check(len(lines) >= 3, str(source), must, f"{len(lines)} lines", "record longer")
    return lines


def _cells(line: str, kind: str) -> list[str]:
    if kind != "blanks":
        return [cell.strip() for cell in next(csv.reader([line], delimiter=DELIMITERS[kind]))]
    cells: list[str] = []
    for word in re.findall(r'"[^"]*"|[(\[][^)\]]*[)\]]|[^\s(\[]+(?:[(\[][^)\]]*[)\]])?', line):
        if word[0] in "([" and cells:
            cells[-1] += f" {word}"
        else:
            cells.append(word.strip('"'))
    return cells


def _delimiter_of(source: Path, lines: list[tuple[int, str]], told: Mapping[str, str]) -> str:
    """The one that cuts all lines looked at into as many cells, two or more; commas may be decimal."""
    looked = [line for _, line in lines[: 1 + _LOOKED_AT]]
    kinds = ("tab", "semicolon", "comma", "blanks")
    counts = {kind: [len(_cells(line, kind)) for line in looked] for kind in kinds}
    for even in (True, False):
        for kind, cells in counts.items():
            # With a line or two that is broken, which are told by their numbers, the others decide.
            same = cells.count(cells[0]) > (len(cells) - 1 if even else 0.7 * len(cells))
            if cells[0] > 1 and same:
                return kind
    must = f"must be columns between {', '.join(DELIMITERS)}, as many in every line"
    remedy = f"say which by {told['delimiter']}"
    raise InputError.of(f"{source.name}:{lines[0][0]}", must, looked[0].strip()[:80], remedy)


def _decimal_of(rows: list[tuple[int, list[str]]], kind: str) -> str:
    """A comma, where cells have commas and none has a point."""
    cells = [cell for _, row in rows[:_LOOKED_AT] for cell in row]
    commas = any(re.fullmatch(r"[-+]?\d*,\d+([eE][-+]?\d+)?", cell) for cell in cells)
    return "," if kind != "comma" and commas and not any("." in cell for cell in cells) else "."


def _column(number: int, heading: str, units: Mapping[str, str]) -> Column:
    text = heading.strip().strip('"')
    match = _IN_BRACKETS.match(text)
    if match is None:
        suffix = _WITH_SUFFIX.match(text)
        match = suffix if suffix and suffix["unit"] in UNITS and suffix["unit"] != "1" else None
    name, unit = (match["name"].strip(), match["unit"].strip() or None) if match else (text, None)
    return Column(number, name, units.get(name, units.get(text, unit)))


def _assigned(
    source: Path,
    columns: Sequence[Column],
    roles: Mapping[str, Sequence[str]],
    required: Sequence[str],
    names: Mapping[str, str],
    told: Mapping[str, str],
    whole_names: bool,
) -> tuple[dict[str, Column], list[Problem]]:
    """Role -> column, and what is wrong with it."""
    found: dict[str, Column] = {}
    problems = []
    have = ", ".join(column.name for column in columns)
    for role, known in roles.items():
        said = names.get(role)
        fitting = _fitting(columns, list(known) if said is None else [said.lower()], whole_names)
        where = told.get(role, f"{told['names']}[{role}]")
        if len(fitting) == 1:
            found[role] = fitting[0]
        elif said is not None:
            which = "no such column" if not fitting else "several of that name"
            must = f"must be a column of {source.name}: {have}"
            problems.append(Problem(where, must, f"{said}: {which}", "name one"))
        elif role in required:
            received = ", ".join(column.name for column in fitting) or f"none of {have}"
            must = f"must say which column is the {role}"
            problems.append(Problem(f"{source.name}: {role}", must, received, f"name it: {where}"))
    return found, problems


def _fitting(columns: Sequence[Column], wanted: Sequence[str], whole: bool) -> list[Column]:
    """The columns of the first of these names that any has; else those that have one of them as a word."""
    for name in wanted:
        exact = [column for column in columns if column.name.lower() == name]
        if exact:
            return exact
    words = set() if whole else set(wanted)
    return [column for column in columns if words & set(re.split(r"[\s_.\-]+", column.name.lower()))]


def _unit_problems(
    source: Path,
    found: Mapping[str, Column],
    units: Mapping[str, str],
    columns: Sequence[Column],
    told: Mapping[str, str],
) -> list[Problem]:
    problems = [
        Problem(f"{told['units']} {name}", "must be of a column", name, "name a column of the file")
        for name in units
        if name not in {column.name for column in columns}
    ]
    for role, column in found.items():
        where, must = f"{source.name}: column {column.name}", f"must be a unit of {', '.join(UNITS)}"
        if column.unit is None:
            remedy = f"say it: {told['units']} '{column.name}=mm', 1 for numbers without unit"
            problems.append(Problem(where, "must say its unit, as `name (mm)` does", "no unit", remedy))
        elif column.unit not in UNITS:
            problems.append(Problem(where, must, column.unit, "convert the column"))
        elif role == "time" and UNITS[column.unit][0] != "s":
            problems.append(Problem(where, "must be a time", column.unit, "name another column, or its unit"))
    return problems


def _numbers(
    source: Path, rows: list[tuple[int, list[str]]], found: Mapping[str, Column], count: int, decimal: str
) -> tuple[dict[str, Array], list[Problem]]:
    """Role -> values (n,) as written, and lines that are not numbers."""
    values: NDArray[np.float64] = np.full((len(rows), len(found)), np.nan)
    must = f"must be {count} cells, with finite numbers in {', '.join(c.name for c in found.values())}"
    remedy = "cut the record before or after it; a gap cannot be filled in"
    wrong = []
    for row, (number, cells) in zip(values, rows, strict=True):
        with suppress(ValueError, IndexError):
            texts = [cells[column.number] for column in found.values()]
            row[:] = [float(text.replace(",", ".") if decimal == "," else text) for text in texts]
        if len(cells) != count or not (np.abs(row) <= LARGEST_NUMBER).all():
            wrong.append(Problem(f"{source.name}:{number}", must, " | ".join(cells)[:80], remedy))
    told = wrong[:_MOST_TOLD]
    if len(wrong) > _MOST_TOLD:
        received = f"{len(wrong)} lines that are not"
        told.append(Problem(source.name, "must be numbers in every line", received, "as above"))
    return {role: values[:, j] for j, role in enumerate(found)}, told


def _sampling_problems(source: Path, time: Array, Ts: float, lines: list[int]) -> list[Problem]:
    """What is wrong with times (n,), s, that must be even; lines (n,): their numbers in the file."""
    off = np.abs(time - time[0] - Ts * np.arange(time.size))
    steps = np.diff(time)
    worst = int(np.argmax(np.abs(steps - Ts)))
    uneven = off.max() > 0.5 * Ts or abs(steps[worst] - Ts) > UNEVEN * Ts
    if Ts > 0 and math.isfinite(Ts) and not uneven:
        return []
    must = f"must be evenly sampled, within {100 * UNEVEN:g} % of the mean step of {Ts:.6g} s"
    remedy = "cut the record at the gap, or resample it yourself: you decide on the values in the gap"
    return [Problem(f"{source.name}:{lines[worst + 1]}", must, f"a step of {steps[worst]:.6g} s", remedy)]
