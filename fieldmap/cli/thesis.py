"""`fieldmap thesis`: the numbers that the thesis prints, beside ours."""

import sys
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldmap.cli.options import Json

if TYPE_CHECKING:
    from rich.text import Text

    from fieldmap.cli.printing import Section
    from fieldmap.thesis import Comparison, PartResult
    from fieldmap.typing import Progress


def completed_rows(incomplete: str) -> list[str]:
    """Rows that begin like this.

    >>> completed_rows("S2")
    ['S20']
    """
    from fieldmap.thesis import row_names

    return [name for name in row_names() if name.startswith(incomplete)]


def thesis(
    rows: Annotated[
        list[str] | None,
        typer.Argument(metavar="ROW", help="Rows such as S7. Default: all.", autocompletion=completed_rows),
    ] = None,
    json: Json = False,
    report: Annotated[
        Path | None,
        typer.Option(
            "--report",
            metavar="FOLDER",
            help="Write index.html, report.md, numbers.csv and plots to it; a second call adds what is missing.",
        ),
    ] = None,
    maps: Annotated[
        Path, typer.Option("--maps", metavar="FOLDER", help="Folder with the maps that rows need.")
    ] = Path("maps/out"),
) -> None:
    """Print the numbers of the thesis beside ours: what agrees, what does not, and what was assumed.

    A row that cannot be computed is named, and the others are printed. The exit code is 1 if a row failed, or if one
    that was asked for by name lacks its map.
    """
    from fieldmap.cli.printing import print_json
    from fieldmap.cli.progress import Progress
    from fieldmap.thesis import attempt_rows
    from fieldmap.thesis.computation import attempt_part

    with Progress("thesis") as progress:
        if report is not None:
            results = reported(rows or (), report, maps, progress)
        else:
            results = list(attempt_rows(rows or (), progress, partial(attempt_part, maps=maps)))
    if json:
        print_json([number for result in results for number in result.comparisons])
    elif report is not None:
        print(report / "index.html")
    else:
        _print_tables(results)
    _close(results, bool(rows))


def reported(rows: Iterable[str], folder: Path, maps: Path, progress: "Progress") -> "list[PartResult]":
    """Write the report of these rows into a folder, and return the results of their parts."""
    from fieldmap.plot.figures import save_curves
    from fieldmap.thesis import attempt_rows
    from fieldmap.thesis.finished_parts import cached_parts
    from fieldmap.thesis.report import prepare_folder, write_report
    from fieldmap.thesis.rows import parts_of

    parts_of(rows)
    prepare_folder(folder)
    results: list[PartResult] = []

    def collected() -> "Iterator[PartResult]":
        for result in attempt_rows(rows, progress, cached_parts(folder, maps)):
            results.append(result)
            yield result

    try:
        write_report(folder, collected(), save_curves)
    except KeyboardInterrupt:
        print("finished rows are kept; the same command goes on from here", file=sys.stderr)
        raise
    return results


def _close(results: "list[PartResult]", named: bool) -> None:
    """Name on stderr the parts without numbers, and end with exit code 1 if one failed."""
    for result in results:
        if result.problem:
            print(f"{result.part}: {result.state}: {result.problem}", file=sys.stderr)
    states = {result.state for result in results}
    if "failed" in states or (named and "no map" in states):
        raise typer.Exit(1)


def _print_tables(results: "list[PartResult]") -> None:
    from fieldmap.cli.printing import print_page

    sections = [section for result in results if result.comparisons for section in _sections(result)]
    print_page(*sections, _verdict(results))


def _sections(result: "PartResult") -> "list[Section]":
    from rich.text import Text

    from fieldmap.cli.printing import assumption_lines, facts, heading, table

    numbers = result.comparisons
    columns = ("number", "unit", "thesis", "ours", "deviation", "kind", "place")
    parts: list[Section] = [
        heading(result.row, result.title),
        table(columns, (_cells(n) for n in numbers), left=2, words=("place",)),
    ]
    parts += [Text(f" {n.name}: misprint: {n.misprint}") for n in numbers if n.misprint]
    parts += [Text(f" {name}: {text}" if name else f" {text}") for name, text in result.explanations.items()]
    assumptions = dict.fromkeys(text for n in numbers for text in n.assumptions)
    return [*parts, facts(assumption_lines(assumptions))] if assumptions else parts


def _cells(number: "Comparison") -> tuple[str, ...]:
    kind = "misprint" if number.misprint else number.kind
    values = (f"{number.thesis:.6g}", f"{number.ours:.6g}", number.verdict)
    # With spaces, so that a narrow terminal folds it between words.
    return (number.name.replace("_", " "), number.unit, *values, kind, number.place)


def _verdict(results: "list[PartResult]") -> "Text":
    from rich.text import Text

    from fieldmap.thesis.computation import agreeing

    agree, sharp = agreeing(number for result in results for number in result.comparisons)
    return Text(f"{agree} of {sharp} sharp numbers agree to the printed digits.")
