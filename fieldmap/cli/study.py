"""`fieldmap study`: a device with some keys varied, solved and summarised."""

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldmap.cli.options import Json, NumberOfWorkers, Resume, Scheduler, studies

if TYPE_CHECKING:
    from collections.abc import Iterator

    from fieldmap.cli.printing import Section
    from fieldmap.studies.quantities import Quantity
    from fieldmap.studies.run import StudyRow, StudyRun
    from fieldmap.studies.study import Record


def study(
    file: Annotated[
        str,
        typer.Argument(
            metavar="STUDY", help="Study file, or the name of a shipped study.", autocompletion=studies
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="NetCDF file to write, with CSV and plot beside it. Default: maps/out/STUDY.nc.",
        ),
    ] = None,
    resume: Resume = True,
    retry: Annotated[bool, typer.Option("--retry", help="Solve failed variants again.")] = False,
    workers: NumberOfWorkers = 1,
    scheduler: Scheduler = None,
    plot: Annotated[
        bool, typer.Option("--plot/--no-plot", help="Plot every summary over the varied keys.")
    ] = True,
    json: Json = False,
) -> None:
    """Solve every variant of a study, and write what is recorded as NetCDF, CSV and a plot."""
    from fieldmap.cli.printing import print_result
    from fieldmap.cli.problems import print_problems
    from fieldmap.errors import FieldmapError, Problem
    from fieldmap.io import refuse_directory
    from fieldmap.progress import Progress
    from fieldmap.studies import run_study

    refuse_directory(file)
    try:
        with Progress("study", compiles=True) as progress:
            run = run_study(file, output, resume, retry, workers, progress, scheduler)
    except KeyboardInterrupt:
        print("the same command continues from here; --fresh begins anew", file=sys.stderr)
        raise
    files = [run.path, run.table]
    if plot:
        from fieldmap.plot.studies import save_study_plot

        picture = save_study_plot(run.data, run.path.with_suffix(".png"))
        files += [] if picture is None else [picture]
    print_result(run, partial(_page, files), json, files=files)
    if len(run.failed) == len(run.study.variants):
        received = f"the first because of {next(iter(run.failed.values()))[0]}"
        problem = Problem(str(run.study.path), "some variant must succeed", received, "see the reasons")
        if not json:
            raise FieldmapError(problem)
        # The result has been printed, and says why each failed.
        print_problems(FieldmapError(problem))
        raise typer.Exit(FieldmapError.exit_code)


# Head of each column and its significant digits; quantities without a head are in the data set only.
_HEADS = {
    "common_current": ("current", 4),
    "equilibrium_x": ("x", 3),
    "equilibrium_y": ("y", 3),
    "stiffness_x": ("k_x", 3),
    "stiffness_z": ("k_z", 3),
    "equilibrium_area": ("area", 3),
    "reach_height": ("reach", 4),
    "reachable_share": ("reachable", 3),
    "largest_flux_density": ("B iron", 3),
    "error_flux_density": ("error", 2),
}
_UNITS = {"N m-1": "N/m", "mm2": "mm^2", "1": ""}


def _page(files: list[Path], run: "StudyRun") -> "Iterator[Section]":
    from fieldmap.cli.printing import assumption_lines, facts, heading, table
    from fieldmap.studies.quantities import recorded

    study, rows = run.study, run.rows()
    summaries = [quantity for quantity in recorded(study.record.groups) if quantity.name in _HEADS]
    shown = [q for q in summaries if any(_cell(q, row) not in ("-", "0") for row in rows)]
    axes = [f"{axis.name}\n{_UNITS.get(axis.unit, axis.unit)}" for axis in study.axes] or ["variant"]
    several = len(study.current_sets) > 1
    columns = [*axes, *(["currents"] if several else []), *(_head(quantity) for quantity in shown)]
    cells = (
        [
            *(value if isinstance(value, str) else f"{value:g}" for value in row.settings.values()),
            *([row.currents] if several else []),
            *(_cell(quantity, row) for quantity in shown),
        ]
        for row in rows
    )
    failed = [("failed", f"{name}: {text}") for name, reasons in run.failed.items() for text in reasons]
    variants = f"{len(study.variants)} variants of {study.device_document.data.get('name', 'a device')}"
    yield heading(study.title, variants)
    yield table(columns, cells, left=len(axes) + several)
    yield facts(failed) if failed else None
    yield facts([*_limits(study.record), *assumption_lines(str(run.data.attrs["assumptions"]).split("\n"))])
    yield facts([("written" if k == 0 else "", str(path)) for k, path in enumerate(files)])


def _head(quantity: "Quantity") -> str:
    unit = _UNITS.get(quantity.printed_unit, quantity.printed_unit)
    return f"{_HEADS[quantity.name][0]}\n{unit}"


def _cell(quantity: "Quantity", row: "StudyRow") -> str:
    from math import isfinite

    number = quantity.printed[0] * float(row.numbers[quantity.name])
    number = 0.0 if abs(number) < 1e-6 else number  # rounding
    return f"{number:.{_HEADS[quantity.name][1]}g}" if isfinite(number) else "-"


def _limits(record: "Record") -> "Iterator[tuple[str, str]]":
    if "equilibrium_area" in record.groups:
        yield "eq. area", f"horizontal force below {100 * record.force_share:g} % of the weight"
    if record.current_limit is not None and {"reach", "reachable_share"} & set(record.groups):
        yield "reach", f"with at most {record.current_limit:g} A in every coil"
