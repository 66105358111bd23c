"""`fieldmap optimise`: the best values of keys of a device, within limits."""

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldmap.cli.options import Json, NumberOfWorkers, Resume, Scheduler, studies

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from fieldmap.cli.printing import Section
    from fieldmap.studies import LimitAtOptimum, Optimum

# Variables that a picture of the device names.
_LINES = 4


def optimise(
    file: Annotated[
        str,
        typer.Argument(
            metavar="STUDY",
            help="Study file with [optimise], or the name of a shipped one.",
            autocompletion=studies,
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="NetCDF file of all designs, with CSV and pictures beside it. Default: maps/out/STUDY.nc.",
        ),
    ] = None,
    resume: Resume = True,
    workers: NumberOfWorkers = 1,
    scheduler: Scheduler = None,
    plot: Annotated[
        bool,
        typer.Option("--plot/--no-plot", help="Draw the path, and the device at the start and at the best."),
    ] = True,
    json: Json = False,
) -> None:
    """Find the best values of a device's keys within limits, and check them on a finer mesh."""
    from fieldmap.cli.printing import print_result
    from fieldmap.io import refuse_directory
    from fieldmap.progress import Progress
    from fieldmap.studies import read_design_problem, solve_problem
    from fieldmap.studies.reading import STUDY
    from fieldmap.studies.run import output_file

    refuse_directory(file)
    problem = read_design_problem(file)
    target = output_file(STUDY.find(file), output)
    try:
        with Progress("optimise", compiles=True) as progress:
            found = solve_problem(problem, target, resume, workers, progress, scheduler)
    except KeyboardInterrupt:
        print("the same command continues from here; --fresh begins anew", file=sys.stderr)
        raise
    device = str(problem.document.data.get("name", "a device"))
    files = [*found.written, *(_pictures(found, found.written[0]) if plot else ())]
    print_result(found, partial(_page, device, files), json, files=files)


def _pictures(found: "Optimum", written: Path) -> "Iterator[Path]":
    from fieldmap.plot.optimum import save_before_and_after, save_optimum_plot
    from fieldmap.plot.rendering import can_render

    yield save_optimum_plot(found, written.with_suffix(".png"))
    # Where nothing draws in space, the numbers must not be lost for it.
    if can_render():
        target = written.with_name(f"{written.stem}_device.png")
        captions = (
            _values("start", {one.key: one.start for one in found.variables}),
            _values("best", found.values),
        )
        yield save_before_and_after(found.start_device, found.device, target, captions)


def _values(heading: str, values: "Mapping[str, float | None]") -> str:
    """A heading and the values of the first variables, a line each."""
    lines = [f"{key} = {value:.5g}" for key, value in list(values.items())[:_LINES] if value is not None]
    return "\n".join([heading, *lines])


def _page(device: str, files: list[Path], found: "Optimum") -> "Iterator[Section]":
    from fieldmap.cli.printing import assumption_lines, facts, heading, table

    yield heading(found.title, f"{_count(len(found.values), 'variable')} of {device}")
    rows = [
        (one.key, f"{one.lower:g}", f"{one.start:.5g}", f"{found.values[one.key]:.5g}", f"{one.upper:g}")
        for one in found.variables
    ]
    yield table(["variable", "lower", "start", "best", "upper"], rows)
    check = found.verified
    finer = "-" if check is None or check.failure else f"{check.objective:.5g}"
    numbers = [(found.objective, "-", f"{found.value:.5g}", finer, f"{found.start_value:.5g} at the start")]
    numbers += [
        (
            one.number,
            _bounds(one),
            f"{one.value:.5g}",
            "-" if one.finer is None else f"{one.finer:.5g}",
            _state(one),
        )
        for one in found.limits
    ]
    yield table(["number, SI units", "limit", "best", "finer mesh", ""], numbers, left=2)
    yield facts(list(_facts(found)))
    yield facts(assumption_lines(found.assumptions))
    yield facts([("written" if k == 0 else "", str(path)) for k, path in enumerate(files)])


def _facts(found: "Optimum") -> "Iterator[tuple[str, str]]":
    solved = f"{_count(found.solves, 'design')} solved"
    yield "search", f"{found.method}, {solved}" + (f", {found.kept} kept from before" if found.kept else "")
    yield "ended", found.ended
    yield from _derivatives(found)
    check = found.verified
    if check is not None:
        said = check.failure or ("every limit holds" if check.holds else "a limit does not hold, see above")
        yield "check", f"on a mesh {check.times_finer:g} times finer: {said}"
    for words, why in found.failed.items():
        yield "failed", f"{words}: {why}"


def _derivatives(found: "Optimum") -> "Iterator[tuple[str, str]]":
    every = {kind for by in found.derivatives.values() for kind in by.values()}
    first = "derivatives"
    for kind in sorted(every - {"none"}, reverse=True):
        parts = []
        for label, by in found.derivatives.items():
            keys = [key for key, own in by.items() if own == kind]
            parts += [f"{label} by {', '.join(keys)}"] if keys else []
        yield first, f"{kind}: " + ("all" if every == {kind} else "; ".join(parts))
        first = ""


def _bounds(limit: "LimitAtOptimum") -> str:
    from math import isfinite

    parts = [f">= {limit.lower:g}"] if isfinite(limit.lower) else []
    parts += [f"<= {limit.upper:g}"] if isfinite(limit.upper) else []
    return ", ".join(parts)


def _state(limit: "LimitAtOptimum") -> str:
    held = "holds" if limit.holds else "does not hold"
    return f"{held}, active" if limit.active else held


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
