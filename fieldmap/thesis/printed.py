"""The printed numbers of the thesis as frozen data: the row files of printed_numbers/, and the shared numbers.

A row file (S14.toml) declares a system and its parts: printed numbers with unit and place, inputs, the function that
computes ours, its assumptions and why ours differs. numbers.toml holds, or refers to geometry/measured for, each
number that several parts read; texts.toml holds sentences that several parts use. README.md describes the keys.
"""

import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from functools import cache
from pathlib import Path
from string import Formatter
from typing import Any

import numpy as np

from fieldmap.errors import InputError, Problem
from fieldmap.records import Record
from fieldmap.shipped import shipped_folder

PRINTED_NUMBERS = Path(__file__).parent / "printed_numbers"
"""The row files."""
NUMBERS, TEXTS = "numbers", "texts"


@dataclass(frozen=True, repr=False)
class PrintedNumber(Record):
    """One printed number.

    name: "k[2]" for an entry of a table, counted from 0. text: as printed, so that its digits are kept. half_unit:
    half a unit of its last digit (or of the table's precision, if an entry is printed shorter). misprint: why the
    number cannot be right, or "".
    """

    name: str
    quantity: str
    unit: str
    text: str
    place: str
    kind: str
    half_unit: float
    misprint: str = ""

    @property
    def value(self) -> float:
        """The number."""
        return float(self.text)


@dataclass(frozen=True, repr=False)
class PrintedPart(Record):
    """A part of a row: title, inputs by name, and names of the printed quantities -> their numbers in C order.

    ours: "module.function" of this package that computes them. explanations and assumptions: name of a printed
    quantity, or "" for the part -> why ours differs, and our assumptions; templates for `filled`. map: recipe of the
    map that the part needs, or "". seconds, quick_seconds: approximate processor time at full and quick detail.
    figures: numbers of the thesis's figures that the part draws.
    """

    title: str
    inputs: dict[str, Any]
    numbers: dict[str, tuple[PrintedNumber, ...]] = field(default_factory=dict)
    explanations: dict[str, str] = field(default_factory=dict)
    assumptions: dict[str, tuple[str, ...]] = field(default_factory=dict)
    ours: str = ""
    map: str = ""
    seconds: float = 1.0
    quick_seconds: float = 1.0
    figures: tuple[str, ...] = ()


@dataclass(frozen=True, repr=False)
class PrintedRow(Record):
    """A row: a system of the thesis, and its parts by full name in order. without_numbers: why there are no parts."""

    system: str
    parts: Mapping[str, PrintedPart]
    without_numbers: str = ""


def row_of(part: str) -> str:
    """The row of a part.

    >>> row_of("S16_controller")
    'S16'
    """
    return part.partition("_")[0]


def data_files(part: str) -> tuple[Path, ...]:
    """The files that hold the data of a part."""
    folder = PRINTED_NUMBERS
    return tuple(folder / f"{name}.toml" for name in (row_of(part), NUMBERS, TEXTS))


@cache
def read_rows() -> dict[str, PrintedRow]:
    """Every row in the order of its number, from the files S*.toml."""
    names = [path.stem for path in PRINTED_NUMBERS.glob("S*.toml")]
    return {name: _row(name) for name in sorted(names, key=lambda name: int(name[1:]))}


def read_part(part: str) -> PrintedPart:
    """The data of a part."""
    return read_rows()[row_of(part)].parts[part]


def part_names() -> list[str]:
    """Every part, in the order of the row files."""
    return [part for row in read_rows().values() for part in row.parts]


def row_names() -> list[str]:
    """The rows with parts, in the order of their numbers."""
    return [name for name, row in read_rows().items() if row.parts]


def parts_of(rows: Iterable[str]) -> list[str]:
    """The parts of rows, or parts by their own names, in order; all parts if no name is given. Raises InputError for
    unknown names.

    >>> parts_of(["S4", "s14_table_6_2"])
    ['S4_windings', 'S4_levitation', 'S14_table_6_2']
    """
    wanted = {name.lower(): name for name in rows}
    known = {part.lower() for part in part_names()} | {row.lower() for row in row_names()}
    problems = [_unknown(name) for lower, name in wanted.items() if lower not in known]
    if problems:
        raise InputError(*problems)
    return [
        part for part in part_names() if not wanted or {part.lower(), row_of(part).lower()} & wanted.keys()
    ]


def _unknown(name: str) -> Problem:
    row = row_of(name).upper()
    if row in row_names():
        return Problem(
            "thesis", f"must be a part of {row}: {', '.join(read_rows()[row].parts)}", name, "or the row"
        )
    must_hold = f"must be a row of {', '.join(row_names())}, or a part of one"
    return Problem("thesis", must_hold, name, "leave the rows out to see all of them")


def _row(name: str) -> PrintedRow:
    content = _content(name)
    parts = {
        f"{name}_{one['name']}" if "name" in one else name: _part(one) for one in content.get("part", ())
    }
    return PrintedRow(content["system"], parts, content.get("without_numbers", ""))


def _part(content: dict[str, Any]) -> PrintedPart:
    inputs = {name: _input(entry) for name, entry in content.get("inputs", {}).items()}
    numbers = {entry["name"]: tuple(_entries(entry)) for entry in content["printed"]}
    entries = [content | {"name": ""}, *content["printed"]]
    return PrintedPart(
        content["title"],
        inputs,
        numbers,
        {entry["name"]: entry["explanation"].strip() for entry in entries if "explanation" in entry},
        {entry["name"]: tuple(entry["assumptions"]) for entry in entries if "assumptions" in entry},
        content["ours"],
        content.get("map", ""),
        content.get("seconds", 1.0),
        content.get("quick_seconds", content.get("seconds", 0.1)),
        tuple(content.get("figures", ())),
    )


@cache
def _content(name: str) -> dict[str, Any]:
    return tomllib.loads((PRINTED_NUMBERS / f"{name}.toml").read_text(encoding="utf-8"))


def _value_and_place(entry: Mapping[str, Any]) -> tuple[Any, str]:
    """Value and place of an entry: its own, or taken from numbers.toml by `from` and the keys that select from it."""
    if "from" not in entry:
        return entry["value"], entry["place"]
    value, place = _shared_number(entry["from"])
    if "less" in entry:
        other, _ = _shared_number(entry["less"])
        value = [str(Decimal(a) - Decimal(b)) for a, b in zip(value, other, strict=True)]
    if "column" in entry:
        value = [row[entry["column"]] for row in value]
    if "entry" in entry:
        value = value[entry["entry"]]
    if "entries" in entry:
        value = [value[k] for k in entry["entries"]]
    if "rows" in entry:
        value = [value] * entry["rows"]
    return value, entry.get("place", place)


def _shared_number(path: str) -> tuple[Any, str]:
    section, _, name = path.partition(".")
    place, found = _content(NUMBERS)[section].get("place"), _content(NUMBERS)[section][name]
    if not isinstance(found, dict):
        return found, place
    if "measured" not in found:
        return found["value"], found["place"]
    # A path of keys and numbers in geometry/measured/MACHINE.toml.
    machine, *keys = found["measured"].split(".")
    value: Any = _measured_file(machine)
    for key in keys:
        value = value[int(key)] if isinstance(value, list) else value[key]
    return value[found["from_entry"] :] if "from_entry" in found else value, found.get("place", place)


@cache
def _measured_file(machine: str) -> dict[str, Any]:
    """A measured file with its numbers as texts, which keeps their digits."""
    text = (shipped_folder("geometry") / "measured" / f"{machine}.toml").read_text(encoding="utf-8")
    return tomllib.loads(text, parse_float=str)


def shared_value(path: str) -> Any:
    """A number or array of numbers.toml, for code outside a part.

    >>> shared_value("eq_7_18.slope_A_per_mm")
    0.0343
    """
    return _input({"from": path})


def _input(entry: Mapping[str, Any] | str) -> Any:
    """A number or an array; a text is returned as it is."""
    if isinstance(entry, str):
        return entry
    value, _ = _value_and_place(entry)
    if isinstance(value, list):
        return np.array([float(v) if isinstance(v, str) else v for v in value])
    return float(value) if isinstance(value, str) else value


def _entries(entry: dict[str, Any]) -> list[PrintedNumber]:
    """The numbers of one [[part.printed]] table."""
    value, place = _value_and_place(entry)
    texts = np.array(value, dtype=object)
    misprints = {tuple(m.get("index", ())): m["why"] for m in entry.get("misprints", ())}
    return [
        PrintedNumber(
            name=entry["name"] + (f"[{','.join(map(str, index))}]" if index else ""),
            quantity=entry["quantity"],
            unit=entry["unit"],
            text=str(texts[index]),
            place=place,
            kind=entry["kind"],
            half_unit=entry.get("half_unit", half_unit(str(texts[index]))),
            misprint=misprints.get(index, ""),
        )
        for index in np.ndindex(texts.shape)
    ]


def half_unit(text: str) -> float:
    """Half a unit of the last printed digit.

    >>> half_unit("0.00706"), half_unit("1.942e-6"), half_unit("1850")
    (5e-06, 5e-10, 0.5)
    """
    exponent = Decimal(text).as_tuple().exponent
    return float(Decimal(5).scaleb(int(exponent) - 1))


class _Filler(Formatter):
    """`str.format` with two extensions: names may be sentences of texts.toml, and arrays are listed by entry."""

    def get_value(self, key: int | str, args: Sequence[Any], kwargs: Mapping[str, Any]) -> Any:
        if key not in kwargs and key in _content(TEXTS):
            return self.vformat(_content(TEXTS)[str(key)].strip(), args, kwargs)
        return super().get_value(key, args, kwargs)

    def format_field(self, value: Any, format_spec: str) -> str:
        if isinstance(value, list | tuple | np.ndarray) and np.ndim(value):
            return ", ".join(self.format_field(one, format_spec) for one in value)
        text = format(value, format_spec)
        # A blank before the per cent sign, as in all texts of the rows.
        return text.replace("%", " %") if format_spec.endswith("%") else text


def filled(template: str, values: Mapping[str, Any]) -> str:
    """A text with `{name:spec}` replaced by values, or by the sentence of that name in texts.toml.

    >>> filled("for h = {offsets_mm:g} mm, {share:.0%}", {"offsets_mm": [10.0, 15.0], "share": 0.5})
    'for h = 10, 15 mm, 50 %'
    """
    return _Filler().vformat(template, (), values)


def figure_numbers(title: str) -> tuple[str, ...]:
    """Numbers of the thesis's figures at the beginning of the title of a figure, if any.

    >>> figure_numbers("Figs 2-9, 6-5 to 6-7: shift")
    ('2-9', '6-5', '6-6', '6-7')
    """
    led = re.match(r"Figs?\.? ([\d, to-]+):", title)
    numbers: list[str] = []
    for part in led[1].split(", ") if led else ():
        first, _, last = part.partition(" to ")
        chapter, begin = first.split("-")
        end = (last or first).split("-")[1]
        numbers += [f"{chapter}-{number}" for number in range(int(begin), int(end) + 1)]
    return tuple(numbers)


@dataclass(frozen=True, repr=False)
class ThesisFigure(Record):
    """One figure. number: "2-4"; shows: its content; drawn_by: the parts that draw it; not_drawn: why none does."""

    number: str
    shows: str
    drawn_by: tuple[str, ...]
    not_drawn: str = ""


@cache
def thesis_figures() -> dict[str, ThesisFigure]:
    """Number -> figure, in the order of the thesis.

    >>> thesis_figures()["2-4"].drawn_by
    ('S4_levitation',)
    """
    drawn = [(number, part) for part in part_names() for number in read_part(part).figures]
    return {
        number: ThesisFigure(number, drawn_by=tuple(part for of, part in drawn if of == number), **entry)
        for number, entry in _content("figures").items()
    }
