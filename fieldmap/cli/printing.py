"""Tables and JSON on stdout."""

import dataclasses
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console, RenderableType
from rich.table import Table
from rich.text import Text

WIDTH = 100


def console() -> Console:
    """Stdout, at most 100 columns wide; the same width when it is not a terminal."""
    out = Console(highlight=False, markup=False, emoji=False)
    out.width = min(out.width, WIDTH) if out.is_terminal else WIDTH
    return out


def print_page(*sections: RenderableType | None) -> None:
    """Print the sections that are there, with an empty line between them."""
    out = console()
    with out.capture() as page:
        for index, section in enumerate(section for section in sections if section is not None):
            if index:
                out.print()
            out.print(section)
    # Tables are padded to their width; a file or a pipe should not get the blanks.
    print("\n".join(line.rstrip() for line in page.get().splitlines()))


def heading(title: str, subtitle: str = "") -> Text:
    """A bold title with a plain remark."""
    return Text.assemble((title, "bold"), f"  {subtitle}" if subtitle else "")


def table(
    columns: Iterable[str], rows: Iterable[Iterable[str]], left: int = 1, words: tuple[str, ...] = ()
) -> Table:
    """A table with a rule under its head; the first `left` columns are left-justified, numbers stand
    right.

    On a narrow terminal the left columns fold, and those named in `words`; numbers stay whole.
    """
    out = Table(box=box.SIMPLE_HEAD, show_edge=False, padding=(0, 1), header_style="dim")
    for index, name in enumerate(columns):
        folds = index < left or name in words
        out.add_column(name, justify="left" if index < left else "right", overflow="fold", no_wrap=not folds)
    for row in rows:
        out.add_row(*(Text(cell) for cell in row))
    return out


def facts(rows: Iterable[tuple[str, str]]) -> Table:
    """Two columns without lines: what, and its value."""
    out = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    out.add_column(style="dim", no_wrap=True)
    out.add_column()
    for name, value in rows:
        out.add_row(Text(name), Text(value))
    return out


def assumption_lines(assumptions: Iterable[str]) -> list[tuple[str, str]]:
    """The things the numbers rest on, as rows for `facts`."""
    return [("assumes" if index == 0 else "", text) for index, text in enumerate(assumptions)]


def millimetres(point: Any) -> str:
    """A point in mm, to 1 um: (0.000, 0.000, -87.000) mm."""
    return "(" + ", ".join(f"{1e3 * x + 0.0:.3f}" for x in point) + ") mm"


def place(point: Any, decimals: int = 3) -> str:
    """A point that was given, in mm, without digits that say nothing.

    >>> place([0.0, -0.0381051, -0.087])
    '(0, -38.105, -87) mm'
    """
    return "(" + ", ".join(f"{round(1e3 * float(x), decimals) + 0.0:g}" for x in point) + ") mm"


def count_of(number: int, singular: str, plural: str) -> str:
    """A number with its noun: "1 body", "2 bodies".

    >>> count_of(1, "body", "bodies"), count_of(0, "body", "bodies")
    ('1 body', '0 bodies')
    """
    return f"{number:,} {singular if number == 1 else plural}"


def without_noise(values: Any) -> np.ndarray:
    """The values with what rounding left, below 1e-9 of the largest, as zeros.

    >>> without_noise([2.0, -1e-17]).tolist()
    [2.0, 0.0]
    """
    array = np.asarray(values, dtype=float)
    return np.where(np.abs(array) <= 1e-9 * np.abs(array).max(initial=0.0), 0.0, array)


def print_json(value: Any) -> None:
    """Print a value made of dictionaries, lists, numpy arrays and dataclasses as JSON."""
    print(json_text(value))


def json_text(value: Any) -> str:
    """That JSON."""
    return json.dumps(plain(value), indent=2, allow_nan=False)


def plain(value: Any) -> Any:
    """Turn numpy arrays, dataclasses and paths into what JSON knows; a number that is not finite becomes
    null."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple, set)):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
