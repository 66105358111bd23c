"""Layout of printed results: one page of headings, facts and tables, or JSON."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from json import dumps
from math import isfinite
from typing import TYPE_CHECKING, SupportsFloat, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from rich import box
from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from fieldmap.plain import Result, plain
from fieldmap.typing import Array

if TYPE_CHECKING:
    from fieldmap.io.answers import ProbedPoint
    from fieldmap.iron.summary import PointField

WIDTH = 100

Section: TypeAlias = RenderableType | None
"""A part of a page; None is left out."""


def console() -> Console:
    """Stdout, at most 100 columns wide; the same width when it is not a terminal."""
    out = Console(highlight=False, markup=False, emoji=False)
    out.width = min(out.width, WIDTH) if out.is_terminal else WIDTH
    return out


def print_page(*sections: Section) -> None:
    """Print the sections that are there, with an empty line between them."""
    out = console()
    with out.capture() as page:
        for index, section in enumerate(section for section in sections if section is not None):
            if index:
                out.print()
            out.print(section, crop=False)
    # Tables are padded to their width; the trailing blanks are removed for files and pipes.
    print("\n".join(unsigned_zeros(line.rstrip()) for line in page.get().splitlines()))


_MINUS_ZERO = re.compile(r"(?P<before>^|[ ([])-(?P<zero>0(?:\.0*)?)(?![\w.])")


def unsigned_zeros(line: str) -> str:
    """The line without the sign of zeros such as "-0.00"; numbers in a column keep their position.

    >>> unsigned_zeros("Fz   -0.00 mN at (-0, -0.5, -1e-3) mm, -0.0 %")
    'Fz    0.00 mN at (0, -0.5, -1e-3) mm, 0.0 %'
    """

    def plain_zero(found: re.Match[str]) -> str:
        in_column = line[: found.start() + 1].endswith("  ")
        return found["before"] + (" " if in_column else "") + found["zero"]

    return _MINUS_ZERO.sub(plain_zero, line)


def heading(title: str, subtitle: str = "") -> Text:
    """A bold title with a plain remark."""
    return Text.assemble((title, "bold"), f"  {subtitle}" if subtitle else "")


def table(
    columns: Iterable[str], rows: Iterable[Iterable[str]], left: int = 1, words: tuple[str, ...] = ()
) -> Table:
    """A table with a rule under its head; the first `left` columns are left-justified, numbers right-justified.

    On a narrow terminal the left columns and the columns named in `words` are folded, but not numbers.
    """
    out = Table(box=box.SIMPLE_HEAD, show_edge=False, padding=(0, 1), header_style="dim")
    for index, name in enumerate(columns):
        folds = index < left or name in words
        out.add_column(name, justify="left" if index < left else "right", overflow="fold", no_wrap=not folds)
    for row in rows:
        out.add_row(*(Text(cell) for cell in row))
    return out


def facts(rows: Iterable[tuple[str, str]]) -> Table:
    """Two columns without lines: names and values."""
    out = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    out.add_column(style="dim", no_wrap=True)
    out.add_column()
    for name, value in rows:
        out.add_row(Text(name), Text(value))
    return out


def command(words: str) -> RenderableType:
    """Words for a shell, on one line for any width of the page, so that they can be pasted."""
    # Rich would join a bare Text with others and wrap it.
    return Group(Text(words, no_wrap=True, overflow="ignore"))


def remark(words: str) -> RenderableType:
    """A sentence or two below a table, indented as its cells are."""
    return Padding(Text(words, style="dim"), (0, 1))


def assumption_lines(assumptions: Iterable[str]) -> list[tuple[str, str]]:
    """The assumptions of the numbers, as rows for `facts`."""
    return [("assumes" if index == 0 else "", text) for index, text in enumerate(assumptions)]


def assumed(assumptions: Iterable[str]) -> Table:
    """The assumptions of the numbers."""
    return facts(assumption_lines(assumptions))


def written(paths: Sequence[object]) -> Table | None:
    """The files that a command has written."""
    rows = [("written" if index == 0 else "", str(path)) for index, path in enumerate(paths)]
    return facts(rows) if rows else None


def cells(values: Iterable[SupportsFloat | None], spec: str, scale: float = 1.0) -> list[str]:
    """Numbers as text, with "-" for a missing number.

    >>> cells([0.00123, None, float("nan")], ".4g", 1e3)
    ['1.23', '-', '-']
    """
    return [
        "-" if value is None or not isfinite(value) else f"{scale * float(value):{spec}}" for value in values
    ]


def place(point: Iterable[float], decimals: int = 3) -> str:
    """A point given in m as text in mm, without trailing zeros.

    >>> place([0.0, -0.0381051, -0.087])
    '(0, -38.105, -87)'
    """
    return "(" + ", ".join(f"{round(1e3 * float(x), decimals) + 0.0:g}" for x in point) + ")"


def axis_text(axis: Array | None) -> str:
    """A unit vector (3,) as text: a letter for a coordinate axis, otherwise its components; "several" for None.

    >>> axis_text(np.array([0.0, -1.0, 1e-17])), axis_text(np.array([0.0, 0.6, 0.8]))
    ('-y', '(0, 0.6, 0.8)')
    """
    if axis is None:
        return "several"
    numbers = np.round(np.asarray(axis, dtype=float), 3) + 0.0
    for letter, one in zip("xyz", np.eye(3), strict=True):
        for sign in (1, -1):
            if np.array_equal(numbers, sign * one):
                return letter if sign > 0 else f"-{letter}"
    return "(" + ", ".join(f"{number:g}" for number in numbers) + ")"


def without_noise(values: ArrayLike, beside: float = 0.0) -> Array:
    """The values, with zeros for rounding errors below 1e-9 of the largest.

    beside: a reference in the same unit, used as the largest value if the values themselves are smaller, such as the
    moment times the field for a torque.

    >>> without_noise([2.0, -1e-17]).tolist(), without_noise([1e-19, -1e-17], beside=0.1).tolist()
    ([2.0, 0.0], [0.0, 0.0])
    """
    array = np.asarray(values, dtype=float)
    return np.where(np.abs(array) <= 1e-9 * np.abs(array).max(initial=beside), 0.0, array)


def currents_text(coil_names: tuple[str, ...], currents: Iterable[float]) -> str:
    """The currents in words.

    >>> currents_text(("left", "right"), [1.5, 1.5]), currents_text(("loop",), [2.0])
    ('1.5 A in each of 2 coils', '2 A in coil loop')
    """
    values = [float(value) for value in currents]
    if len(values) == 1:
        return f"{values[0]:g} A in coil {coil_names[0]}"
    if len(set(values)) == 1:
        return f"{values[0]:g} A in each of {len(values)} coils"
    return ", ".join(f"{name}: {value:g} A" for name, value in zip(coil_names, values, strict=True))


def field_table(
    points: Iterable[ProbedPoint | PointField],
    coil_names: tuple[str, ...] = (),
    currents: Iterable[float] = (),
) -> RenderableType:
    """B and the gradient at each point, below the currents if these are given."""
    parts: list[RenderableType] = [Text(currents_text(coil_names, currents))] if coil_names else []
    for point in points:
        lines = [
            (f"B{axis}", *cells((flux, *row), ".6g", 1e3))
            for axis, flux, row in zip(
                "xyz", without_noise(point.B), without_noise(point.gradient), strict=True
            )
        ]
        parts.append(
            table((f"at {place(point.at)} mm", "mT", "d/dx  mT/m", "d/dy  mT/m", "d/dz  mT/m"), lines)
        )
    return Group(*parts)


R = TypeVar("R", bound=Result)


def print_result(result: R, layout: Callable[[R], Iterable[Section]], json: bool, **about: object) -> None:
    """Print a result: `result.to_dict()` as JSON, or the sections of its layout.

    about: entries before the result's own in JSON, such as the name of the file.
    """
    if json:
        print_json(about | result.to_dict())
    else:
        print_page(*layout(result))


def print_json(value: object) -> None:
    """Print a value that `fieldmap.plain.plain` accepts as JSON."""
    print(dumps(plain(value), indent=2, allow_nan=False))
