"""`fieldmap thesis`: the numbers that the thesis prints, beside ours."""

import math
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldmap.cli.options import Json

if TYPE_CHECKING:
    from rich.text import Text

    from fieldmap.cli.printing import Section
    from fieldmap.thesis import Comparison, PartResult
    from fieldmap.thesis.plan import Plan
    from fieldmap.typing import Progress

LONG = 20.0
"""Seconds from which on a command says first what it needs."""
MOVED_EVERY = 1.0
"""Seconds after which progress moves while a part is at work."""
TOLD_EVERY = 10.0
"""Seconds after which the time that a part has taken is told anew."""


def completed_rows(incomplete: str) -> list[str]:
    """Rows that begin like this, or parts where it goes beyond the name of a row.

    >>> completed_rows("S2"), completed_rows("S4_w")
    (['S20'], ['S4_windings'])
    """
    from fieldmap.thesis import part_names, row_names

    names = part_names() if "_" in incomplete else row_names()
    return [name for name in names if name.startswith(incomplete)]


def thesis(
    rows: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="ROW",
            help="Rows such as S7, or parts such as S14_table_6_2. Default: all.",
            autocompletion=completed_rows,
        ),
    ] = None,
    json: Json = False,
    report: Annotated[
        Path | None,
        typer.Option(
            "--report",
            metavar="FOLDER",
            help="Write index.html, report.md, numbers.csv and plots to it as rows are done; a second call continues.",
        ),
    ] = None,
    maps: Annotated[
        Path, typer.Option("--maps", metavar="FOLDER", help="Folder with the maps that rows need.")
    ] = Path("maps/out"),
    make_maps: Annotated[
        bool, typer.Option("--make-maps", help="Make the maps that are missing, when rows need them.")
    ] = False,
    quick: Annotated[
        bool, typer.Option("--quick", help="Coarse meshes and a coarse map: a first look in some minutes.")
    ] = False,
) -> None:
    """Print the numbers of the thesis beside ours: what agrees, what does not, and what was assumed.

    A row that cannot be computed is named, and the others are printed. The exit code is 1 if a row failed, or if one
    that was asked for by name lacks its map.
    """
    from fieldmap.cli.printing import print_json
    from fieldmap.progress import Progress, must_compile
    from fieldmap.thesis import detail
    from fieldmap.thesis.computation import attempt_part
    from fieldmap.thesis.kept import cached_parts
    from fieldmap.thesis.plan import planned
    from fieldmap.thesis.printed import parts_of
    from fieldmap.thesis.report import prepare_folder

    with detail.at(detail.QUICK if quick else detail.FULL):
        parts = parts_of(rows or ())
        if report is not None:
            prepare_folder(report)
        plan = planned(parts, maps, make_maps, report, must_compile())
        if Progress.shown and (report is not None or plan.seconds > LONG):
            print(plan.text, file=sys.stderr)
        with Progress("thesis", compiles=True) as progress:
            if report is not None:
                results = _reported(plan, report, computed(plan, cached_parts(report, maps), progress))
            else:
                results = list(computed(plan, partial(attempt_part, maps=maps), progress))
    if json:
        print_json([number for result in results for number in result.comparisons])
    elif report is not None:
        print(report / "index.html")
    else:
        _print_tables(results)
    _close(results, bool(rows))


def computed(
    plan: "Plan", attempt: "Callable[[str], PartResult]", progress: "Progress"
) -> "Iterator[PartResult]":
    """The parts of a plan, one by one; the maps that it asks for are made before the first part that needs one."""
    from fieldmap.thesis.computation import attempt_rows

    begun = 0.0
    for stage in plan.stages:
        what = f"map {stage.recipe}: " if stage.recipe else ""
        share = partial(_told, progress, what, begun / plan.whole, stage.seconds / plan.whole)
        if stage.recipe:
            from fieldmap.maps import generate

            stage.target.parent.mkdir(parents=True, exist_ok=True)
            generate(stage.recipe, stage.target, progress=share)
        else:
            with moving(share, stage.expected) as moved:
                yield from attempt_rows(stage.expected, moved, attempt)
        begun += stage.seconds


def _told(progress: "Progress", what: str, begun: float, of: float, message: str, fraction: float) -> None:
    """Tell progress in a step that is the share `of` of all and began at the share `begun`."""
    progress(f"{what}{message}", begun + fraction * of)


@contextmanager
def moving(
    progress: "Callable[[str, float], None]", expected: Mapping[str, float]
) -> "Iterator[Callable[[str, float], None]]":
    """Progress for `attempt_rows` that moves while a part is at work, by the seconds that are expected of it.

    A part that takes longer moves on ever more slowly and never passes its end.
    """
    from fieldmap.thesis.report import minutes

    whole, stopped = sum(expected.values()), threading.Event()
    at_work: list[tuple[str, float, float]] = []

    def begins(part: str, share: float) -> None:
        at_work[:] = [(part, share, time.monotonic())]
        progress(part, share)

    def ticks() -> None:
        while not stopped.wait(MOVED_EVERY):
            for part, share, since in tuple(at_work):
                took, usual = time.monotonic() - since, expected[part]
                inside = usual * (1.0 - math.exp(-took / usual)) / whole
                if took > TOLD_EVERY:
                    told = TOLD_EVERY * (took // TOLD_EVERY)
                    progress(f"{part}, {minutes(told)} of about {minutes(usual)}", share + inside)

    clock = threading.Thread(target=ticks, daemon=True)
    clock.start()
    try:
        yield begins
    finally:
        stopped.set()
        clock.join()


def _reported(plan: "Plan", folder: Path, results: "Iterable[PartResult]") -> "list[PartResult]":
    """Write the report of these parts into a folder as they are done, and return their results."""
    from fieldmap.plot.figures import save_curves
    from fieldmap.thesis.report import write_report

    try:
        return write_report(folder, results, save_curves, plan.parts)
    except KeyboardInterrupt:
        print("finished rows are kept; the same command continues from here", file=sys.stderr)
        raise


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
