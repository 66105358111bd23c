"""What the thesis prints: the data files of thesis/ as frozen data."""

import re
import tomllib
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from fieldmap.shipped import shipped_folder

KINDS = ("sharp", "model", "measured")


@dataclass(frozen=True)
class PrintedNumber:
    """One printed number.

    name: "k[2]" for an entry of a table, counted from 0. text: as printed, so that its digits are kept. half_unit:
    half a unit of its last digit (of the table's precision, where an entry is printed shorter). misprint: why it
    cannot be right, or "".
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


@dataclass(frozen=True)
class PrintedPart:
    """One data file: title, inputs by name, and names of the printed quantities -> their numbers in C order.

    explanations: name of a printed quantity, or "" for the part -> why ours differs. map: the recipe whose map it
    needs, or "". seconds: of processor time that the part takes, about. figures: of the thesis, by number, that
    the part draws.
    """

    title: str
    inputs: dict[str, Any]
    numbers: dict[str, tuple[PrintedNumber, ...]] = field(default_factory=dict)
    explanations: dict[str, str] = field(default_factory=dict)
    map: str = ""
    seconds: float = 1.0
    figures: tuple[str, ...] = ()


def data_file(part: str) -> Path:
    """Where the data of a part lie."""
    return shipped_folder("thesis") / f"{part}.toml"


def read_part(part: str) -> PrintedPart:
    """The data of a part, from thesis/PART.toml."""
    content = tomllib.loads(data_file(part).read_text(encoding="utf-8"))
    inputs = {name: _number_or_array(entry["value"]) for name, entry in content.get("inputs", {}).items()}
    numbers = {entry["name"]: tuple(_entries(entry)) for entry in content["printed"]}
    entries = [{"name": ""} | content, *content["printed"]]
    explanations = {entry["name"]: entry["explanation"] for entry in entries if "explanation" in entry}
    return PrintedPart(
        content["title"],
        inputs,
        numbers,
        explanations,
        content.get("map", ""),
        content.get("seconds", 1.0),
        tuple(content.get("figures", ())),
    )


def _number_or_array(value: Any) -> Any:
    return np.array(value) if isinstance(value, list) else value


def _entries(entry: dict[str, Any]) -> list[PrintedNumber]:
    """The numbers of one [[printed]] table."""
    texts = np.array(entry["value"], dtype=object)
    misprints = {tuple(m.get("index", ())): m["why"] for m in entry.get("misprints", ())}
    return [
        PrintedNumber(
            name=entry["name"] + (f"[{','.join(map(str, index))}]" if index else ""),
            quantity=entry["quantity"],
            unit=entry["unit"],
            text=str(texts[index]),
            place=entry["place"],
            kind=entry["kind"],
            half_unit=entry.get("half_unit", half_unit(str(texts[index]))),
            misprint=misprints.get(index, ""),
        )
        for index in np.ndindex(texts.shape)
    ]


def figure_numbers(title: str) -> tuple[str, ...]:
    """Numbers of the thesis's figures that the title of a figure begins with; none where it begins with something else.

    >>> figure_numbers("Figs 2-9, 6-5 to 6-7: shift")
    ('2-9', '6-5', '6-6', '6-7')
    """
    led = re.match(r"Figs?\.? ([\d, to-]+):", title)
    return tuple(number for part in led[1].split(", ") for number in _each_figure(part)) if led else ()


def _each_figure(part: str) -> list[str]:
    """ "5-6 to 5-8" as single numbers."""
    first, _, last = part.partition(" to ")
    if not last:
        return [first]
    chapter, begin = first.split("-")
    return [f"{chapter}-{number}" for number in range(int(begin), int(last.split("-")[1]) + 1)]


def half_unit(text: str) -> float:
    """Half a unit of the last printed digit.

    >>> half_unit("0.00706"), half_unit("1.942e-6"), half_unit("1850")
    (5e-06, 5e-10, 0.5)
    """
    exponent = Decimal(text).as_tuple().exponent
    return float(Decimal(5).scaleb(int(exponent) - 1))
