"""Which rows and parts there are, and what a part's function returns."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

from fieldmap.curves import Curves
from fieldmap.errors import InputError, Problem
from fieldmap.records import Record
from fieldmap.thesis.printed import read_part, read_rows


@dataclass(frozen=True, repr=False)
class Ours(Record):
    """Our number or array, and what the computation itself says it rests on (a solver's report, for example)."""

    value: Any
    assumptions: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, repr=False)
class Answers(Record):
    """What a part computes, where it is more than numbers.

    numbers: name of every printed number -> our number or `Ours`. curves: figures. facts: name -> value, for the
    explanations and assumptions of the row file, which may also name the part's inputs.
    """

    numbers: Mapping[str, Any]
    curves: tuple[Curves, ...] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)


def part_names() -> list[str]:
    """Every part, in the order of the row files."""
    return [part for row in read_rows().values() for part in row.parts]


def row_names() -> list[str]:
    """The rows that can be asked for, in the order of their numbers."""
    return [name for name, row in read_rows().items() if row.parts]


def parts_of(rows: Iterable[str]) -> list[str]:
    """The parts of these rows, in order; of all rows if none is given. Raises InputError for unknown rows."""
    wanted = [name.upper() for name in rows]
    known = row_names()
    problems = [
        Problem(
            "thesis", f"must be a row of {', '.join(known)}", name, "leave the rows out to see all of them"
        )
        for name in wanted
        if name not in known
    ]
    if problems:
        raise InputError(*problems)
    return [part for name in known if not wanted or name in wanted for part in read_rows()[name].parts]


def function_of(part: str) -> Callable[[dict[str, Any]], Answers | Mapping[str, Any]]:
    """The function that computes a part: `ours` of its row file.

    It takes the part's inputs, name -> number or array in the units of the file, and returns the name of every printed
    number -> our number (an array for a table), or `Ours` where something is assumed; or `Answers`, which hold figures
    and facts besides. Where the file says `map = "division"`, inputs["map"] is that recipe's map, opened.
    """
    module, _, name = read_part(part).ours.partition(".")
    return getattr(import_module(f"fieldmap.thesis.{module}"), name)
