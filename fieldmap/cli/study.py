"""`fieldmap study`: a device with some keys varied, solved and summarised."""

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from fieldmap.cli.options import Json, studies


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
            help="NetCDF file to write; maps/out/STUDY.nc otherwise. CSV and plot beside it.",
        ),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume/--fresh", help="Keep the variants of a stopped run, or begin anew.")
    ] = True,
    retry: Annotated[bool, typer.Option("--retry", help="Solve the variants again that failed.")] = False,
    workers: Annotated[
        int, typer.Option("--workers", metavar="N", min=1, help="Processes on this machine.")
    ] = 1,
    scheduler: Annotated[
        str | None,
        typer.Option("--scheduler", metavar="ADDRESS", help="A dask scheduler, whose workers solve."),
    ] = None,
    plot: Annotated[
        bool, typer.Option("--plot/--no-plot", help="Draw every summary over the varied keys.")
    ] = True,
    json: Json = False,
) -> None:
    """Solve every variant of a study, and write what is recorded as NetCDF, CSV and a plot."""
    from fieldmap.cli.opening import refuse_directory
    from fieldmap.cli.progress import Progress
    from fieldmap.errors import FieldmapError, Problem
    from fieldmap.studies import run_study

    refuse_directory(file)
    try:
        with Progress("study") as progress:
            run = run_study(file, output, resume, retry, workers, progress, scheduler)
    except KeyboardInterrupt:
        print("the same command goes on from here; --fresh begins anew", file=sys.stderr)
        raise
    picture = _draw(run) if plot else None
    _print(run, picture, json)
    if len(run.failed) == len(run.study.variants):
        received = f"the first because of {next(iter(run.failed.values()))[0]}"
        raise FieldmapError(
            Problem(str(run.study.path), "some variant must succeed", received, "see the reasons")
        )


def _draw(run: Any) -> Path | None:
    from fieldmap.plot.studies import save_study_plot

    return save_study_plot(run.data, run.path.with_suffix(".png"))


def _print(run: Any, picture: Path | None, json: bool) -> None:
    from fieldmap.cli.printing import print_json
    from fieldmap.cli.study_text import print_study, study_rows

    files = [path for path in (run.path, run.table, picture) if path is not None]
    if json:
        print_json({"title": run.study.title, "files": files, "rows": study_rows(run), "failed": run.failed})
    else:
        print_study(run, files)
