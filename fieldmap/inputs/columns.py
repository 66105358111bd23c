"""Text files of columns: data sheets, logs of rigs, tables of other programs.

Delimiter, decimal comma, names and units are recognised, or given by the caller. Names stand in a line above the
numbers, in the last remark above them (COMSOL, `numpy.savetxt`), or in the list that begins a table of Opera.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fieldmap.arguments import LARGEST_NUMBER, check
from fieldmap.errors import InputError, Problem
from fieldmap.file_contents import read_text
from fieldmap.records import Record
from fieldmap.typing import Array

# unit -> SI unit, factor
UNITS: dict[str, tuple[str, float]] = {
    "s": ("s", 1.0), "ms": ("s", 1e-3), "us": ("s", 1e-6), "µs": ("s", 1e-6), "min": ("s", 60.0),
    "m": ("m", 1.0), "cm": ("m", 1e-2), "mm": ("m", 1e-3), "um": ("m", 1e-6), "µm": ("m", 1e-6), "in": ("m", 0.0254),
    "A": ("A", 1.0), "mA": ("A", 1e-3), "kA": ("A", 1e3), "V": ("V", 1.0), "mV": ("V", 1e-3),
    "T": ("T", 1.0), "mT": ("T", 1e-3), "uT": ("T", 1e-6), "µT": ("T", 1e-6), "nT": ("T", 1e-9),
    "G": ("T", 1e-4), "kG": ("T", 0.1), "mG": ("T", 1e-7), "T/m": ("T/m", 1.0), "mT/m": ("T/m", 1e-3),
    "A/m": ("A/m", 1.0), "kA/m": ("A/m", 1e3), "A/cm": ("A/m", 1e2), "Oe": ("A/m", 1e3 / (4 * np.pi)),
    "kOe": ("A/m", 1e6 / (4 * np.pi)),
    "N": ("N", 1.0), "mN": ("N", 1e-3), "kg": ("kg", 1.0), "g": ("kg", 1e-3),
    "rad": ("rad", 1.0), "deg": ("rad", 0.017453292519943295), "1": ("1", 1.0),
}  # fmt: skip
QUANTITIES = {"s": "time", "m": "length", "A": "current", "V": "voltage", "T": "flux density", "N": "force"}
QUANTITIES |= {"kg": "mass", "rad": "angle", "1": "numbers without unit", "A/m": "field strength"}
QUANTITIES |= {"T/m": "gradient"}
"""The quantity of an SI unit, in words."""
DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "blanks": " "}
# Units in words and in the capitals of Opera.
_SPELLED = {"metre": "m", "meter": "m", "micron": "um", "inch": "in", "cm": "cm", "mm": "mm", "m": "m"}
_SPELLED |= {
    "tesla": "T",
    "gauss": "G",
    "kgauss": "kG",
    "oersted": "Oe",
    "ampere": "A",
    "wb/m2": "T",
    "wb/m^2": "T",
}
_UNIT_OF_LENGTH = re.compile(r"length unit[:,]\s*(\S+)", re.IGNORECASE)
# Lines from which the format is recognised, and most lines whose problems are reported one by one.
_LOOKED_AT, _MOST_TOLD = 20, 5
_IN_BRACKETS = re.compile(r"^\s*(?P<name>.*?\S)\s*[(\[](?P<unit>[^()\[\]]*)[)\]]\s*$")
_IN_WORDS = re.compile(r"^\s*(?P<name>.*\S)\s+in\s+(?P<unit>\S+)\s*$")
_NUMBER = re.compile(r"[-+]?(\d+[.,]?\d*|[.,]\d+)([eE][-+]?\d+)?|[-+]?(nan|inf)", re.IGNORECASE)
_OF_OPERA = re.compile(r"\s*(?P<number>\d+)\s+(?P<name>[^\s\[]+)\s*(?:\[(?P<unit>[^\]]*)\])?\s*")
_RULE = re.compile(r"[\s|+;,]*(-{3,}|={3,})[-=|+;,\s]*")
_REMARKS = ("#", "%", "//")


@dataclass(frozen=True, eq=False, repr=False)
class Column(Record):
    """A column of a text file: number from 0, name, and the unit of its values; None if the file states no unit."""

    number: int
    name: str
    unit: str | None

    @property
    def quantity(self) -> str | None:
        """The SI unit of the column's quantity; None for an unknown unit."""
        return UNITS[self.unit][0] if self.unit in UNITS else None


@dataclass(frozen=True, eq=False, repr=False)
class TextColumns(Record):
    """A text file of columns. rows: line number and cells of each. named: whether the file names its columns; columns
    without names are called 1, 2, ... delimiter: a name of `DELIMITERS`. decimal: "." or ","."""

    source: Path
    columns: tuple[Column, ...]
    rows: tuple[tuple[int, list[str]], ...]
    delimiter: str
    decimal: str
    named: bool

    def numbers(
        self, found: Mapping[str, Column], remedy: str = "correct the line"
    ) -> tuple[dict[str, Array], list[Problem]]:
        """Role -> values (n,) as written, and the problems of lines that are not numbers."""
        values = np.full((len(self.rows), len(found)), np.nan)
        count = len(self.columns)
        must = f"must be {count} cells, with finite numbers in {', '.join(c.name for c in found.values())}"
        wrong = []
        for row, (line, cells) in zip(values, self.rows, strict=True):
            with suppress(ValueError, IndexError):
                texts = [cells[column.number] for column in found.values()]
                row[:] = [float(text.replace(",", ".") if self.decimal == "," else text) for text in texts]
            if len(cells) != count or not (np.abs(row) <= LARGEST_NUMBER).all():
                wrong.append(Problem(f"{self.source}:{line}", must, " | ".join(cells)[:80], remedy))
        told = wrong[:_MOST_TOLD]
        if len(wrong) > _MOST_TOLD:
            received = f"{len(wrong)} lines that are not"
            told.append(Problem(str(self.source), "must be numbers in every line", received, "as above"))
        return {role: values[:, j] for j, role in enumerate(found)}, told


def read_columns(
    source: Path,
    least: int = 1,
    delimiter: str | None = None,
    decimal: str | None = None,
    units: Mapping[str, str] | None = None,
    said_by: str = "delimiter",
) -> TextColumns:
    """Read a text file of columns.

    least: least number of rows. delimiter, decimal: recognised unless given. units: by column, in place of the units in
    the file. said_by: the caller's name of the delimiter in messages. Raises InputError for a file that cannot be read
    or has no columns.
    """
    lines, remarks = _lines(read_text(source, otherwise="latin-1"))
    must = f"must hold a line of names and {least} rows of numbers or more"
    check(len(lines) >= max(least, 1), str(source), must, f"{len(lines)} lines", "record more")
    listed = _list_of_opera(lines)
    if listed:
        lines = lines[len(listed) + 2 :]
        check(len(lines) >= least, str(source), must, f"{len(lines)} lines of numbers", "record more")
    try:
        lines = _from_names_on(lines)
        kind = delimiter or _delimiter_of(source, lines, said_by)
        check(kind in DELIMITERS, said_by, f"must be one of {', '.join(DELIMITERS)}", kind, "choose one")
        rows = [(number, _cells(line, kind)) for number, line in lines]
        head = listed or _names(rows, remarks, kind)
    except csv.Error as error:
        must, remedy = "must be columns of numbers", "correct the line that is so long"
        raise InputError.of(str(source), must, str(error), remedy) from None
    if head is rows[0][1]:
        rows = rows[1:]
        if rows and _are_units(rows[0][1], len(head)):
            head = [f"{name} [{unit.strip('()[]')}]" for name, unit in zip(head, rows[0][1], strict=True)]
            rows = rows[1:]
        check(len(rows) >= least, str(source), must, f"{len(rows) + 1} lines", "record more")
    length = next((found[1] for text in remarks if (found := _UNIT_OF_LENGTH.search(text))), None)
    named = head if head is not None else [str(k + 1) for k in range(len(rows[0][1]))]
    columns = tuple(_column(k, text, units or {}, length) for k, text in enumerate(named))
    return TextColumns(
        source, columns, tuple(rows), kind, decimal or _decimal_of(rows, kind), head is not None
    )


def _lines(text: str) -> tuple[list[tuple[int, str]], list[str]]:
    """Lines that are neither empty, remarks nor rules, with their numbers; and the remarks above them."""
    lines: list[tuple[int, str]] = []
    remarks: list[str] = []
    for number, line in enumerate(text.splitlines(), start=1):
        if line.lstrip().startswith(_REMARKS):
            remarks += [] if lines else [line.strip().lstrip("#%/").strip()]
        elif line.strip() and not _RULE.fullmatch(line):
            lines.append((number, line))
    return lines, remarks


def _list_of_opera(lines: Sequence[tuple[int, str]]) -> list[str]:
    """Names of the columns of a table of Opera: a line of counts, a line `number NAME [UNIT]` for each, a line of 0."""
    if len(lines) < 3 or not all(word.isdigit() for word in lines[0][1].split()):
        return []
    names: list[str] = []
    for _, line in lines[1:]:
        found = _OF_OPERA.fullmatch(line)
        if found is None or int(found["number"]) != len(names) + 1:
            ends = line.split()[:1] == ["0"]
            return names if ends else []
        names.append(f"{found['name']} [{found['unit']}]" if found["unit"] else found["name"])
    return []


def _from_names_on(lines: list[tuple[int, str]]) -> list[tuple[int, str]]:
    """The lines from the line of names on. Names are the first line above the first numbers that has the same number of
    cells as these and no number."""
    for k, (_, line) in enumerate(lines[:_LOOKED_AT]):
        for kind in DELIMITERS:
            cells = _cells(line, kind)
            if len(cells) < 2 or not all(map(_NUMBER.fullmatch, cells)):
                continue
            above = [_cells(text, kind) for _, text in lines[:k]]
            words = [j for j, row in enumerate(above) if not any(map(_NUMBER.fullmatch, row))]
            return lines[next((j for j in words if len(above[j]) == len(cells)), 0) :]
    return lines


def _are_units(cells: Sequence[str], count: int) -> bool:
    """Whether a line has `count` cells that are units or empty."""
    units = [unit_of(cell.strip("()[]")) for cell in cells if cell]
    return len(cells) == count and bool(units) and all(unit in UNITS and unit != "1" for unit in units)


def _names(rows: Sequence[tuple[int, list[str]]], remarks: Sequence[str], kind: str) -> list[str] | None:
    """The first row if it is not all numbers, else the last remark if it has the same number of cells, else None."""
    first = rows[0][1]
    if not all(_NUMBER.fullmatch(cell) for cell in first):
        return first
    words = _cells(remarks[-1], kind) if remarks else []
    return words if len(words) == len(first) and not any(map(_NUMBER.fullmatch, words)) else None


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


def _delimiter_of(source: Path, lines: Sequence[tuple[int, str]], said_by: str) -> str:
    """The delimiter that cuts the first lines into equal numbers of cells, two or more; commas may be decimal."""
    looked = [line for _, line in lines[: 1 + _LOOKED_AT]]
    kinds = ("tab", "semicolon", "comma", "blanks")
    cells = {kind: [_cells(line, kind) for line in looked] for kind in kinds}
    counts = {kind: [len(row) for row in rows] for kind, rows in cells.items()}
    fitting = []
    for even in (True, False):
        for kind, lengths in counts.items():
            # The second round allows for some broken lines, which are reported later by their numbers.
            same = lengths.count(lengths[0]) > (len(lengths) - 1 if even else 0.7 * len(lengths))
            if lengths[0] > 1 and same:
                fitting.append(kind)
    # A decimal comma may also cut all lines alike, but its cells are not numbers.
    for kind in fitting:
        below = cells[kind][1:]
        if sum(all(map(_NUMBER.fullmatch, row)) for row in below) > 0.7 * len(below):
            return kind
    if fitting:
        return fitting[0]
    # If most lines are broken, the line of names decides; the broken lines are reported by their numbers.
    most = max(kinds, key=lambda kind: counts[kind][0])
    if counts[most][0] > 2:
        return most
    must = f"must be columns between {', '.join(DELIMITERS)}, as many in every line"
    remedy = f"say which by {said_by}"
    raise InputError.of(f"{source}:{lines[0][0]}", must, looked[0].strip()[:80], remedy)


def _decimal_of(rows: Sequence[tuple[int, list[str]]], kind: str) -> str:
    """The decimal mark: a comma if cells have commas and none has a point."""
    cells = [cell for _, row in rows[:_LOOKED_AT] for cell in row]
    commas = any(re.fullmatch(r"[-+]?\d*,\d+([eE][-+]?\d+)?", cell) for cell in cells)
    return "," if kind != "comma" and commas and not any("." in cell for cell in cells) else "."


def _column(number: int, heading: str, units: Mapping[str, str], length: str | None) -> Column:
    """A column by its heading. length: unit of columns x, y and z without a unit."""
    text = heading.strip().strip('"')
    name, unit = _name_and_unit(text)
    if unit is None and name.lower() in ("x", "y", "z"):
        unit = length
    said = units.get(name, units.get(text))
    return Column(number, name, unit_of(unit) if said is None and unit is not None else said)


def _name_and_unit(text: str) -> tuple[str, str | None]:
    match = _IN_BRACKETS.match(text)
    if match is not None:
        return match["name"].strip(), match["unit"].strip() or None
    match = _IN_WORDS.match(text)
    if match is not None and unit_of(match["unit"]) in UNITS:
        return match["name"], match["unit"]
    # The longest unit that ends the heading, as in H/kA/m or H_A_per_m. In u_1 the 1 is a channel, not a unit.
    for place in re.finditer(r"(?<=\S)[_/]", text):
        unit = unit_of(text[place.end() :].strip())
        if unit in UNITS and unit != "1":
            return text[: place.start()].strip(), unit
    return text, None


def unit_of(text: str) -> str:
    """The name in `UNITS` of a unit that is spelled in words, with per, or with another letter mu."""
    plain = text.replace("\u03bc", "\u00b5").replace("_per_", "/")
    return plain if plain in UNITS else _SPELLED.get(plain.lower(), text)


def columns_of_roles(
    table: TextColumns,
    roles: Mapping[str, Sequence[str]],
    required: Sequence[str],
    names: Mapping[str, str],
    said_by: Mapping[str, str],
    whole_names: bool = False,
) -> tuple[dict[str, Column], list[Problem]]:
    """Role -> column, and the problems.

    roles: lower-case names by which each is recognised; whole_names: whether a name must match a whole heading, not
    only a word of it. names: names of columns given by the caller, by role. said_by: the caller's name of the argument
    that names a role; "names" for all other roles.
    """
    found: dict[str, Column] = {}
    problems = []
    have = ", ".join(column.name for column in table.columns)
    for role, known in roles.items():
        said = names.get(role)
        fitting = _fitting(table.columns, list(known) if said is None else [said.lower()], whole_names)
        where = said_by.get(role, f"{said_by['names']}[{role}]")
        if len(fitting) == 1:
            found[role] = fitting[0]
        elif said is not None:
            which = "no such column" if not fitting else "several of that name"
            must = f"must be a column of {table.source.name}: {have}"
            problems.append(Problem(where, must, f"{said}: {which}", "name one"))
        elif role in required:
            received = ", ".join(column.name for column in fitting) or f"none of {have}"
            must = f"must say which column is the {role}"
            problems.append(Problem(f"{table.source}: {role}", must, received, f"name it: {where}"))
    return found, problems


def _fitting(columns: Sequence[Column], wanted: Sequence[str], whole: bool) -> list[Column]:
    """The columns with the first of these names that occurs; else the columns that have one of the names as a word."""
    for name in wanted:
        exact = [column for column in columns if column.name.lower() == name]
        if exact:
            return exact
    words = set() if whole else set(wanted)
    return [column for column in columns if words & set(re.split(r"[\s_.\-]+", column.name.lower()))]


def unit_problems(
    table: TextColumns, found: Mapping[str, Column], units: Mapping[str, str], said_by: str
) -> list[Problem]:
    """Problems of units: given for a missing column, not stated, or unknown."""
    problems = [
        Problem(f"{said_by} {name}", "must be of a column", name, "name a column of the file")
        for name in units
        if name not in {column.name for column in table.columns}
    ]
    for column in found.values():
        where, must = f"{table.source}: column {column.name}", f"must be a unit of {', '.join(UNITS)}"
        if column.unit is None:
            remedy = f"say it: {said_by} '{column.name}=mm', 1 for numbers without unit"
            problems.append(Problem(where, "must say its unit, as `name (mm)` does", "no unit", remedy))
        elif column.unit not in UNITS:
            problems.append(Problem(where, must, column.unit, "convert the column"))
    return problems


def quantity_problems(source: Path, found: Mapping[str, Column], wanted: Mapping[str, str]) -> list[Problem]:
    """Problems of columns with the unit of another quantity than their role's. wanted: SI unit of each role."""
    return [
        Problem(
            f"{source}: column {column.name}",
            f"must be a unit of {QUANTITIES[wanted[role]]}",
            str(column.unit),
            f"name another column for {role}, or its unit",
        )
        for role, column in found.items()
        if column.quantity not in (None, wanted[role])
    ]


def si_values(
    table: TextColumns,
    found: Mapping[str, Column],
    wanted: Mapping[str, str],
    assumed: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
) -> tuple[dict[str, Array], list[Problem]]:
    """Role -> values (n,) in SI units, and all problems of numbers and units.

    wanted: SI unit of each role. assumed: unit of roles whose columns state none. units: as for `read_columns`.
    """
    stated = {
        role: column if column.unit else replace(column, unit=(assumed or {}).get(role))
        for role, column in found.items()
    }
    values, wrong = table.numbers(stated)
    problems = unit_problems(table, stated, units or {}, "units")
    problems += quantity_problems(table.source, stated, wanted) + wrong
    factors = {role: UNITS.get(str(column.unit), ("", np.nan))[1] for role, column in stated.items()}
    return {role: factors[role] * values[role] for role in values}, problems
