"""`fieldmap thesis`: the numbers that the thesis prints, compared with ours."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from fieldmap.cli import options, page
from fieldmap.cli.options import option
from fieldmap.progress import Progress, must_compile

if TYPE_CHECKING:
    from fieldmap.thesis import Comparison, PartResult
    from fieldmap.thesis.plan import Plan

LONG = 20.0
"""Expected time, s, from which on the command first prints its plan."""


def completed_rows(incomplete: str) -> list[str]:
    """Rows that begin with a text, or parts if the text is longer than the name of a row.

    >>> completed_rows("S2"), completed_rows("S4_w")
    (['S20'], ['S4_windings'])
    """
    from fieldmap.thesis import part_names, row_names

    names = part_names() if "_" in incomplete else row_names()
    return [name for name in names if name.startswith(incomplete)]


def thesis(
    rows: Annotated[list[str] | None, typer.Argument(metavar="ROW", autocompletion=completed_rows)] = None,
    json: options.Json = False,
    report: Annotated[Path | None, option("--report", "FOLDER"), options.writes()] = None,
    maps: Annotated[Path, option("--maps", "FOLDER")] = Path("maps/out"),
    make_maps: Annotated[bool, typer.Option("--make-maps")] = False,
    quick: Annotated[bool, typer.Option("--quick")] = False,
) -> None:
    """Print the numbers of the thesis beside ours: what agrees, what does not, and what was assumed.

    A row that cannot be computed is named, and the others are printed. The exit code is 1 if a row failed, or if one
    that was asked for by name lacks its map.

    Example: fieldmap thesis S7 S20

    Parameters
    ----------
    rows
        Rows such as S7, or parts such as S14_table_6_2. Default: all.
    report
        Write index.html, report.md, numbers.csv and plots to it as rows are done; a second call continues.
    maps
        Folder with the maps that rows need.
    make_maps
        Make the maps that are missing, when rows need them.
    quick
        Coarse meshes and a coarse map: a first look in some minutes.
    """
    from fieldmap.thesis import detail
    from fieldmap.thesis.computation import agreeing, attempt_part
    from fieldmap.thesis.kept import cached_parts
    from fieldmap.thesis.plan import computed, planned
    from fieldmap.thesis.printed import parts_of
    from fieldmap.thesis.report import prepare_folder

    with detail.at(detail.QUICK if quick else detail.FULL):
        parts = parts_of(rows or ())
        if report is not None:
            prepare_folder(report)
        plan = planned(parts, maps, make_maps, report, must_compile())
        if Progress.shown and (report is not None or plan.seconds > LONG):
            print(plan.text, file=sys.stderr)
        with Progress("thesis", compiles=True, timed=True) as progress:
            if report is not None:
                results = _reported(plan, report, computed(plan, cached_parts(report, maps), progress))
            else:
                results = list(computed(plan, partial(attempt_part, maps=maps), progress))
    if json:
        page.print_json([number for result in results for number in result.comparisons])
    elif report is not None:
        print(report / "index.html")
    else:
        agree, sharp = agreeing(number for result in results for number in result.comparisons)
        sections = [section for result in results if result.comparisons for section in _sections(result)]
        page.print_page(*sections, Text(f"{agree} of {sharp} sharp numbers agree to the printed digits."))
    for result in results:
        if result.problem:
            print(f"{result.part}: {result.state}: {result.problem}", file=sys.stderr)
    states = {result.state for result in results}
    if "failed" in states or (rows and "no map" in states):
        raise typer.Exit(1)


def _reported(plan: Plan, folder: Path, results: Iterable[PartResult]) -> list[PartResult]:
    """Write the report of a plan's parts into a folder as they are done, and return the results."""
    from fieldmap.plot.figures import save_curves
    from fieldmap.thesis.report import write_report

    try:
        return write_report(folder, results, save_curves, plan.parts)
    except KeyboardInterrupt:
        print("finished rows are kept; the same command continues from here", file=sys.stderr)
        raise


def _sections(result: PartResult) -> Iterator[page.Section]:
    numbers = result.comparisons
    columns = ("number", "unit", "thesis", "ours", "deviation", "kind", "place")
    yield page.heading(result.row, result.title)
    yield page.table(columns, map(_cells, numbers), left=2, words=("place",))
    for number in numbers:
        yield Text(f" {number.name}: misprint: {number.misprint}") if number.misprint else None
    for name, text in result.explanations.items():
        yield Text(f" {name}: {text}" if name else f" {text}")
    assumptions = dict.fromkeys(text for number in numbers for text in number.assumptions)
    yield page.assumed(assumptions) if assumptions else None


def _cells(number: Comparison) -> tuple[str, ...]:
    kind = "misprint" if number.misprint else number.kind
    values = (f"{number.thesis:.6g}", f"{number.ours:.6g}", number.verdict)
    # Spaces let a narrow terminal fold the name between words.
    return (number.name.replace("_", " "), number.unit, *values, kind, number.place)
