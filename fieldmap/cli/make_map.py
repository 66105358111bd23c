"""`fieldmap map`: compute the map that a recipe asks for."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from fieldmap.cli.options import Changes, NumberOfWorkers, Resume, Scheduler, changes_of_device, recipes


def make_map(
    recipe: Annotated[
        str,
        typer.Argument(
            metavar="RECIPE", help="Recipe file, or the name of a shipped recipe.", autocompletion=recipes
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="FILE", help="Map file to write. Default: maps/out/RECIPE.h5."
        ),
    ] = None,
    changes: Changes = None,
    resume: Resume = True,
    summary: Annotated[
        bool, typer.Option("--summary", help="Print a summary of the map when it is done.")
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON.")] = False,
    pictures: Annotated[
        bool | None,
        typer.Option(
            "--pictures/--no-pictures",
            help="Draw the map in two pictures beside it, NAME.png and NAME_3d.png. Default: with --summary.",
        ),
    ] = None,
    accept_error: Annotated[
        bool,
        typer.Option(
            "--accept-error",
            help="Write the map even if the error of its current model is more than twice the recipe's.",
        ),
    ] = False,
    workers: NumberOfWorkers = 1,
    scheduler: Scheduler = None,
) -> None:
    """Compute the map that a recipe describes. A stopped run continues where it was."""
    from fieldmap.io import refuse_directory
    from fieldmap.maps import generate
    from fieldmap.progress import Progress

    refuse_directory(recipe)
    settings = changes_of_device(changes)
    try:
        with Progress("map", compiles=True) as progress:
            path = generate(
                recipe,
                output,
                resume,
                progress,
                workers,
                scheduler,
                changes=settings,
                accept_error=accept_error,
            )
    except KeyboardInterrupt:
        print("the same command continues from here; --fresh begins anew", file=sys.stderr)
        raise
    _tell_what_is_missing(path)
    if summary or json or pictures:
        from fieldmap.cli.info import print_summary

        print_summary(path, json, (summary and not json) if pictures is None else pictures)
    else:
        print(path)


def _tell_what_is_missing(path: Path) -> None:
    """States that failed, and an accuracy that is not reached."""
    from fieldmap.store import read_info, warn_of_missed_accuracy

    report = read_info(path).provenance.solver_report
    for number, reason in report.get("states_failed", {}).items():
        print(f"state {number} could not be solved and was left out: {reason}", file=sys.stderr)
    warn_of_missed_accuracy(path, report)
