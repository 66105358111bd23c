"""`fieldmap thesis`: the numbers that the thesis prints, beside ours."""

from collections.abc import Iterable
from itertools import groupby
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
    """Print the numbers of the thesis beside ours: what agrees, what does not, and what was assumed."""
    from fieldmap.cli.printing import print_json
    from fieldmap.thesis import compare

    comparisons = compare(rows or ())
    if json:
        print_json(comparisons)
    else:
        _print_tables(comparisons)


def _print_tables(comparisons: list[Any]) -> None:
    from fieldmap.cli.printing import print_page

    sections = []
    for (row, title), group in groupby(comparisons, key=lambda c: (c.id, c.title)):
        sections += _section(row, title, list(group))
    print_page(*sections, _verdict(comparisons))


def _section(row: str, title: str, numbers: list[Any]) -> list[Any]:
    from rich.text import Text

    from fieldmap.cli.printing import assumption_lines, facts, heading, table

    columns = ("number", "unit", "thesis", "ours", "deviation", "kind", "place")
    parts: list[Any] = [heading(row, title), table(columns, (_cells(n) for n in numbers), left=2)]
    parts += [Text(f" {n.name}: misprint: {n.misprint}") for n in numbers if n.misprint]
    assumptions = dict.fromkeys(text for n in numbers for text in n.assumptions)
    return [*parts, facts(assumption_lines(assumptions))] if assumptions else parts


def _cells(number: Any) -> tuple[str, ...]:
    deviation = "agrees" if number.agrees else _percent(number.deviation)
    kind = "misprint" if number.misprint else number.kind
    return (
        number.name,
        number.unit,
        f"{number.thesis:.6g}",
        f"{number.ours:.6g}",
        deviation,
        kind,
        number.place,
    )


def _percent(deviation: float | None) -> str:
    if deviation is None:
        return ""
    percent = 100 * deviation
    return f"{percent:+.1f} %" if abs(percent) >= 0.1 else f"{percent:+.1g} %"


def _verdict(comparisons: Iterable[Any]) -> Any:
    from rich.text import Text

    sharp = [c for c in comparisons if c.kind == "sharp" and not c.misprint]
    agreeing = sum(c.agrees for c in sharp)
    return Text(f"{agreeing} of {len(sharp)} sharp numbers agree to the printed digits.")
