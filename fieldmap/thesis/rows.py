"""Which rows and parts there are, and what a part's function returns."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

from fieldmap.curves import Curves
from fieldmap.errors import InputError, Problem
from fieldmap.extras import needs
from fieldmap.records import Record
from fieldmap.thesis.printed import read_part, read_rows, row_of


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
    """The parts of these rows, or parts by their own names, in order; all if none is given. Raises InputError for
    names that are neither.

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


def function_of(part: str) -> Callable[[dict[str, Any]], Answers | Mapping[str, Any]]:
    """The function that computes a part: `ours` of its row file.

    It takes the part's inputs, name -> number or array in the units of the file, and returns the name of every printed
    number -> our number (an array for a table), or `Ours` where something is assumed; or `Answers`, which hold figures
    and facts besides. Where the file says `map = "division"`, inputs["map"] is that recipe's map, opened.
    """
    module, _, name = read_part(part).ours.partition(".")
    with needs("make", part):
        return getattr(import_module(f"fieldmap.thesis.{module}"), name)
