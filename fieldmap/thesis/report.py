"""The report: index.html and report.md from templates, every number in numbers.csv, figures in plots/."""

import csv
import io
import re
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields
from datetime import date
from functools import cache
from importlib.metadata import version
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fieldmap.arguments import raise_all
from fieldmap.curves import Curves
from fieldmap.errors import InputError
from fieldmap.extras import needs
from fieldmap.records import Record
from fieldmap.store import write_whole
from fieldmap.store.output_formats import output_problems
from fieldmap.thesis import detail
from fieldmap.thesis.computation import Comparison, PartResult, agreeing
from fieldmap.thesis.printed import part_names, read_rows, row_of, thesis_figures

if TYPE_CHECKING:
    from jinja2 import Environment

Draw = Callable[[Curves, Path], Any]
Drawn = tuple[PartResult, tuple[str, ...]]
OFTEN = 2.0
"""Least time between two writings of the texts, s."""
_OF_A_NUMBER = tuple(one.name for one in fields(Comparison) if one.name not in ("id", "title", "assumptions"))
COLUMNS = ("row", *_OF_A_NUMBER, "assumptions", "command")


@dataclass(frozen=True, repr=False)
class Row(Record):
    """One section of the report: the parts of a row with the file names of their figures.

    waiting: titles of the parts that are not done yet.
    """

    id: str
    system: str
    parts: tuple[tuple[PartResult, tuple[str, ...]], ...]
    waiting: tuple[str, ...] = ()

    @property
    def numbers(self) -> list[Comparison]:
        """All numbers of the row."""
        return [number for part, _ in self.parts for number in part.comparisons]

    @property
    def sharp(self) -> str:
        """Number of sharp numbers that agree, "5 of 5", or "" without sharp numbers."""
        agree, of = agreeing(self.numbers)
        return f"{agree} of {of}" if of else ""

    @property
    def largest(self) -> Comparison | None:
        """The number farthest from the thesis, misprints and sharp numbers that agree left out."""
        rest = [n for n in self.numbers if n.deviation and not n.misprint and not n.agrees]
        return max(rest, key=lambda n: abs(n.deviation or 0.0), default=None)

    @property
    def state(self) -> str:
        """ "done", "failed", "no map", "partly" if only some parts have numbers, or "waiting" if parts are to come."""
        if self.waiting:
            return "waiting"
        states = {part.state for part, _ in self.parts}
        if len(states) == 1:
            return states.pop()
        return "partly" if "done" in states else "failed"

    @property
    def seconds(self) -> float:
        """Processor time, s."""
        return sum(part.seconds for part, _ in self.parts)

    @property
    def command(self) -> str:
        """The commands that make the maps of this row and compute the row."""
        option = next((part.option for part, _ in self.parts), "")
        maps = sorted({part.map for part, _ in self.parts if part.map})
        words = [*(f"map {recipe}" for recipe in maps), f"thesis {self.id}{option}"]
        return " && ".join(f"fieldmap {one}" for one in words)


def prepare_folder(folder: Path) -> None:
    """Make the folder of a report. Raises InputError if that fails or if the report would replace other files."""
    files = {"index.html": "report", "report.md": "report", "numbers.csv": "table of numbers"}
    problems = ((folder / name, kind) for name, kind in files.items() if folder.is_dir())
    raise_all(one for path, kind in problems for one in output_problems(str(path), path, [kind]))
    try:
        (folder / "plots").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        must_hold = "must be a folder that can be made and written"
        raise InputError.of(str(folder), must_hold, error.strerror or str(error), "choose another") from None


def write_report(
    folder: Path, results: Iterable[PartResult], draw: Draw, parts: Sequence[str] = ()
) -> list[PartResult]:
    """Write index.html, report.md, numbers.csv and plots/*.png, and return the results.

    results: used one by one, so a generator may compute them. draw(curves, path) saves a figure as PNG. parts: names
    of all parts to come. If given, the texts are written before the first result and again as parts are done;
    otherwise only at the end. Each file is replaced as a whole.
    """
    drawn: list[Drawn] = []
    waiting, written = dict.fromkeys(parts), time.monotonic()
    if waiting:
        _write(folder, drawn, parts)
    for result in results:
        names = tuple(f"plots/{result.part}_{k}.png" for k in range(1, len(result.curves) + 1))
        for curves, name in zip(result.curves, names, strict=True):
            draw(curves, folder / name)
        drawn.append((result, names))
        waiting.pop(result.part, None)
        if waiting and time.monotonic() > written + OFTEN:
            _write(folder, drawn, tuple(waiting))
            written = time.monotonic()
    _write(folder, drawn, ())
    return [result for result, _ in drawn]


def _write(folder: Path, drawn: Sequence[Drawn], waiting: Sequence[str]) -> None:
    """Write the texts with the results so far. waiting: parts to come."""
    rows = _rows(drawn, waiting)
    numbers = [number for row in rows for number in row.numbers]
    agree, sharp = agreeing(numbers)
    known = {
        "rows": rows,
        "planned": {
            name: ": ".join(filter(None, (row.system, row.without_numbers)))
            for name, row in read_rows().items()
            if not row.parts
        },
        "problems": [part for part, _ in drawn if part.problem],
        "agree": agree,
        "sharp": sharp,
        "numbers": len(numbers),
        "seconds": sum(row.seconds for row in rows),
        "version": version("fieldmap"),
        "today": date.today().isoformat(),
        "waiting": len(waiting),
        "parts": len(drawn) + len(waiting),
        "quick": detail.current().is_quick,
        "coarse": detail.COARSE,
    }
    for template, name in (("report.md.j2", "report.md"), ("report.html.j2", "index.html")):
        write_whole(folder / name, _environment().get_template(template).render(known), "report")
    write_whole(folder / "numbers.csv", _csv(rows), "table of numbers")


def _rows(drawn: Sequence[Drawn], waiting: Sequence[str]) -> list[Row]:
    """The rows in order, with the parts of each in the order of its file."""
    order = part_names()
    done = sorted(drawn, key=lambda pair: order.index(pair[0].part))
    rows = [
        Row(
            name,
            row.system,
            tuple(pair for pair in done if pair[0].row == name),
            tuple(row.parts[part].title for part in waiting if row_of(part) == name),
        )
        for name, row in read_rows().items()
    ]
    return [row for row in rows if row.parts or row.waiting]


def _csv(rows: Iterable[Row]) -> str:
    text = io.StringIO(newline="")
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    for row in rows:
        for n in row.numbers:
            values = [getattr(n, name) for name in _OF_A_NUMBER]
            plain = [str(value).lower() if isinstance(value, bool) else value for value in values]
            table.writerow((row.id, *plain, "; ".join(n.assumptions), row.command))
    return text.getvalue()


def minutes(seconds: float) -> str:
    """A time for people.

    >>> minutes(0.04), minutes(75.0)
    ('under 0.1 s', '1 min 15 s')
    """
    if seconds < 0.1:
        return "under 0.1 s"
    if seconds < 60.0:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    return f"{whole // 60} min {whole % 60} s"


def resting_on(numbers: Iterable[Comparison]) -> list[tuple[str, str]]:
    """Each assumption once, with the names of the numbers that depend on it, or "" if all do."""
    users: dict[str, dict[str, None]] = {}
    every: dict[str, None] = {}
    for number in numbers:
        name = number.name.partition("[")[0]
        every[name] = None
        for text in number.assumptions:
            users.setdefault(text, {})[name] = None
    return [(text, "" if len(names) == len(every) else ", ".join(names)) for text, names in users.items()]


def powers(unit: str) -> str:
    """A unit with its exponents raised.

    >>> powers("A m2"), powers("1/s2"), powers("m3")
    ('A m²', '1/s²', 'm³')
    """
    return re.sub(r"(?<=[A-Za-z])[23]\b", lambda found: "²³"[int(found[0]) - 2], unit)


def figure_page() -> str:
    """docs/thesis_figures.md: a table for each chapter."""
    chapters = groupby(thesis_figures().values(), key=lambda figure: figure.number.partition("-")[0])
    found = [{"number": number, "figures": list(figures)} for number, figures in chapters]
    return _environment().get_template("figures.md.j2").render(chapters=found)


# Cached, so that the templates are compiled only once.
@cache
def _environment() -> "Environment":
    with needs("cli", "the pages of the thesis"):
        from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("fieldmap.thesis"),
        autoescape=lambda name: bool(name and name.endswith(".html.j2")),
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    environment.filters |= {
        "number": lambda value: f"{value:.6g}",
        "minutes": minutes,
        "resting": resting_on,
        "powers": powers,
        "cell": lambda text: str(text).replace("|", "\\|"),
        "code": "`{}`".format,
    }
    return environment
