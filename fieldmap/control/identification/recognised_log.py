"""Logs of other programs: delimiter, decimal comma, names and units recognised, or said by the caller."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fieldmap.arguments import LARGEST_NUMBER, check_positive
from fieldmap.control.identification.log import UNITS, Log, sampling_problem
from fieldmap.errors import InputError, Problem
from fieldmap.records import Record
from fieldmap.typing import Array

DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "blanks": " "}
TIME = ("time", "t", "zeit", "timestamp", "elapsed time", "elapsed")
# Lines whose cells are counted, and problems of lines that are told one by one.
_LOOKED_AT, _MOST_TOLD = 20, 5
_IN_BRACKETS = re.compile(r"^\s*(?P<name>.*?\S)\s*[(\[](?P<unit>[^()\[\]]*)[)\]]\s*$")
_WITH_SUFFIX = re.compile(r"^\s*(?P<name>.*\S)[_/](?P<unit>[^_/\s]+)\s*$")


@dataclass(frozen=True, eq=False, repr=False)
class Column(Record):
    """A column of a log: its number, name, and the unit in which it is written; None where it does not say."""

    number: int
    name: str
    unit: str | None


@dataclass(frozen=True, eq=False, repr=False)
class RecognisedLog(Record):
    """A log whose columns have roles. log: its signals by role, SI; columns: role -> column; delimiter: a name of
    `DELIMITERS`; decimal: "." or ","."""

    log: Log
    columns: Mapping[str, Column]
    delimiter: str
    decimal: str

    def shown(self, role: str) -> tuple[Array, str]:
        """The signal of a role in the unit in which it was written, and that unit."""
        unit = self.columns[role].unit or "1"
        return self.log[role] / UNITS[unit][1], unit


def recognise_log(
    path: str | Path,
    roles: Mapping[str, Sequence[str]],
    *,
    required: Sequence[str] = (),
    names: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
    sampling_time: float | None = None,
    options: Mapping[str, str] | None = None,
    whole_names: bool = False,
) -> RecognisedLog:
    """Read a text file of columns below a line of names.

    roles: role -> names by which its column is recognised, in lower case. required: roles that must be there. names:
    role -> name of its column, where that is not to be recognised; "time" is a role of its own. units: column -> unit,
    where its heading does not say, as `name (mm)`, `name [mm]`, `name_mm` or `name/mm` do. delimiter: a name of
    `DELIMITERS`, recognised unless given, and so is decimal, "." or ",". sampling_time: s, for a log without time.
    options: what the caller calls these in messages. whole_names: whether a name must be all of a heading, not one of
    its words.

    Only columns with roles are read. Raises InputError with every problem of the file.
    """
    source, said, told = Path(path), dict(names or {}), {**_OPTIONS, **(options or {})}
    if sampling_time is not None:
        check_positive("recognise_log", sampling_time=sampling_time)
    lines = _lines(source)
    try:
        kind = delimiter or _delimiter_of(source, lines, told)
        if kind not in DELIMITERS:
            must = f"must be one of {', '.join(DELIMITERS)}"
            raise InputError(Problem(told["delimiter"], must, kind, "choose one"))
        rows = [(number, _cells(line, kind)) for number, line in lines]
    except csv.Error as error:
        must, remedy = "must be columns of numbers", "correct the line that is so long"
        raise InputError(Problem(str(source), must, str(error), remedy)) from None
    columns = [_column(k, text, units or {}) for k, text in enumerate(rows[0][1])]
    timed = {} if sampling_time is not None else {"time": TIME}
    found, problems = _assigned(
        source, columns, {**timed, **roles}, (*timed, *required), said, told, whole_names
    )
    problems += _unit_problems(source, found, said, units or {}, columns, told)
    mark = decimal or _decimal_of(rows[1:], kind)
    numbers, wrong = _numbers(source, rows, found, len(columns), mark)
    problems += wrong
    if "time" in found and not wrong and not any(p.where.endswith("time") for p in problems):
        factor = UNITS[found["time"].unit or "s"][1]
        problems += sampling_problem(source, factor * numbers["time"], [number for number, _ in rows[1:]])
    if problems:
        raise InputError(*problems)
    return RecognisedLog(_log(found, numbers, sampling_time), found, kind, mark)


_OPTIONS = {"delimiter": "recognise_log(delimiter)", "units": "units", "names": "names"}


def _log(found: Mapping[str, Column], numbers: Mapping[str, Array], sampling_time: float | None) -> Log:
    signals, units = {}, {}
    for role, column in found.items():
        units[role], factor = UNITS[column.unit or "1"]
        signals[role] = factor * numbers[role]
    Ts, start = sampling_time or 0.0, 0.0
    if sampling_time is None:
        time = signals.pop("time")
        units.pop("time")
        Ts, start = float((time[-1] - time[0]) / (time.size - 1)), float(time[0])
    return Log(Ts, start, signals, units)


def _lines(source: Path) -> list[tuple[int, str]]:
    """Lines that are neither empty nor comments, with their numbers."""
    try:
        text = source.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        text = source.read_text(encoding="latin-1")
    except OSError as error:
        received = error.strerror or str(error)
        raise InputError(
            Problem(str(source), "must be a file that can be read", received, "check the name")
        ) from None
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith(("#", "%", "//"))
    ]
    if len(lines) < 3:
        must, remedy = "must hold a line of names and two samples or more", "record longer"
        raise InputError(Problem(str(source), must, f"{len(lines)} lines", remedy))
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
    counts = {
        kind: [len(_cells(line, kind)) for line in looked] for kind in ("tab", "semicolon", "comma", "blanks")
    }
    for even in (True, False):
        for kind, cells in counts.items():
            # With a line or two that is broken, which are told by their numbers, the others decide.
            same = cells.count(cells[0]) > (len(cells) - 1 if even else 0.7 * len(cells))
            if cells[0] > 1 and same:
                return kind
    must = f"must be columns between {', '.join(DELIMITERS)}, as many in every line"
    remedy = f"say which by {told['delimiter']}"
    raise InputError(Problem(f"{source.name}:{lines[0][0]}", must, looked[0].strip()[:80], remedy))


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
    for role, known in roles.items():
        said = names.get(role)
        wanted = [said.lower()] if said is not None else list(known)
        fitting = _fitting(columns, wanted, whole_names)
        where = told.get(role, f"{told['names']}[{role}]")
        have = ", ".join(column.name for column in columns)
        if len(fitting) == 1:
            found[role] = fitting[0]
        elif said is not None:
            which = "no such column" if not fitting else "several of that name"
            problems.append(
                Problem(where, f"must be a column of {source.name}: {have}", f"{said}: {which}", "name one")
            )
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
    names: Mapping[str, str],
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
        where = f"{source.name}: column {column.name}"
        if column.unit is None:
            must = "must say its unit, as `name (mm)` does"
            remedy = f"say it: {told['units']} '{column.name}=mm', 1 for numbers without unit"
            problems.append(Problem(where, must, "no unit", remedy))
        elif column.unit not in UNITS:
            problems.append(
                Problem(where, f"must be a unit of {', '.join(UNITS)}", column.unit, "convert the column")
            )
        elif role == "time" and UNITS[column.unit][0] != "s":
            problems.append(Problem(where, "must be a time", column.unit, "name another column, or its unit"))
    return problems


def _numbers(
    source: Path, rows: list[tuple[int, list[str]]], found: Mapping[str, Column], count: int, decimal: str
) -> tuple[dict[str, Array], list[Problem]]:
    """Role -> values (n,) as written, and lines that are not numbers."""
    values: NDArray[np.float64] = np.full((len(rows) - 1, len(found)), np.nan)
    problems, more = [], 0
    for i, (number, cells) in enumerate(rows[1:]):
        good = len(cells) == count
        if good:
            for j, column in enumerate(found.values()):
                text = cells[column.number]
                try:
                    values[i, j] = float(text.replace(",", ".") if decimal == "," else text)
                except ValueError:
                    good = False
            good = good and bool((np.abs(values[i]) <= LARGEST_NUMBER).all())
        if not good:
            more += 1
            if more <= _MOST_TOLD:
                must = f"must be {count} cells, with finite numbers in {', '.join(c.name for c in found.values())}"
                remedy = "cut the record before or after it; a gap cannot be filled in"
                problems.append(Problem(f"{source.name}:{number}", must, " | ".join(cells)[:80], remedy))
    if more > _MOST_TOLD:
        problems.append(
            Problem(source.name, "must be numbers in every line", f"{more} lines that are not", "as above")
        )
    return {role: values[:, j] for j, role in enumerate(found)}, problems
