"""`fieldmap thesis`: the numbers that the thesis prints, beside ours."""

import sys
from typing import Annotated, Any

import typer

from fieldmap.cli.options import Json


def thesis(
    rows: Annotated[
        list[str] | None,
        typer.Argument(metavar="[ROW]...", help="S7, for example; all rows if none is given."),
    ] = None,
    json: Json = False,
) -> None:
    """Print the numbers of the thesis beside ours: what agrees, what does not, and what was assumed.

    A row that cannot be computed is named, and the others are printed. The exit code is 1 if a row failed, or if one
    that was asked for by name lacks its map.
    """
    from fieldmap.cli.printing import print_json
    from fieldmap.cli.progress import Progress
    from fieldmap.thesis import attempt_rows

    with Progress("thesis") as progress:
        results = list(attempt_rows(rows or (), progress))
    if json:
        print_json([number for result in results for number in result.comparisons])
    else:
        _print_tables(results)
    _close(results, bool(rows))


def _close(results: list[Any], named: bool) -> None:
    """Say on stderr what is not there, and leave with the exit code that belongs to it."""
    for result in results:
        if result.problem:
            print(f"{result.part}: {result.state}: {result.problem}", file=sys.stderr)
    states = {result.state for result in results}
    if "failed" in states or (named and "no map" in states):
        raise typer.Exit(1)


def _print_tables(results: list[Any]) -> None:
    from fieldmap.cli.printing import print_page

    sections = [section for result in results if result.comparisons for section in _sections(result)]
    print_page(*sections, _verdict(results))


def _sections(result: Any) -> list[Any]:
    from rich.text import Text

    from fieldmap.cli.printing import assumption_lines, facts, heading, table

    numbers = result.comparisons
    columns = ("number", "unit", "thesis", "ours", "deviation", "kind", "place")
    parts: list[Any] = [
        heading(result.row, result.title),
        table(columns, (_cells(n) for n in numbers), left=2),
    ]
    parts += [Text(f" {n.name}: misprint: {n.misprint}") for n in numbers if n.misprint]
    parts += [Text(f" {name}: {text}" if name else f" {text}") for name, text in result.explanations.items()]
    assumptions = dict.fromkeys(text for n in numbers for text in n.assumptions)
    return [*parts, facts(assumption_lines(assumptions))] if assumptions else parts


def _cells(number: Any) -> tuple[str, ...]:
    from fieldmap.thesis.words import deviation_in_words

    kind = "misprint" if number.misprint else number.kind
    values = (f"{number.thesis:.6g}", f"{number.ours:.6g}", deviation_in_words(number))
    return (number.name, number.unit, *values, kind, number.place)


def _verdict(results: list[Any]) -> Any:
    from rich.text import Text

    from fieldmap.thesis.comparison import agreeing

    agree, sharp = agreeing(number for result in results for number in result.comparisons)
    return Text(f"{agree} of {sharp} sharp numbers agree to the printed digits.")
