"""`fieldmap simulate`: run a scenario, once or many times."""

from pathlib import Path
from typing import Annotated

import typer

from fieldmap.cli.options import Json, ScenarioArgument, ScenarioMap


def simulate(
    scenario: ScenarioArgument,
    map_file: ScenarioMap = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="Write the runs: .h5, or .csv of a single run."),
    ] = None,
    save: Annotated[
        Path | None, typer.Option("--save", metavar="FILE", help="Save a plot: .png, .svg or .pdf.")
    ] = None,
    runs: Annotated[
        int, typer.Option("--runs", metavar="N", help="How many runs, each with noise of its own.")
    ] = 1,
    seed: Annotated[
        int | None, typer.Option("--seed", metavar="N", help="In the place of the scenario's.")
    ] = None,
    threads: Annotated[int, typer.Option("--threads", metavar="N", help="0: one per processor.")] = 0,
    changes: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="Change a key, such as control.z.Kc=0.2; may be repeated."
        ),
    ] = None,
    vary: Annotated[
        str | None,
        typer.Option("--vary", metavar="KEY=A,B,...", help="The same runs for each value of a key."),
    ] = None,
    json: Json = False,
) -> None:
    """Run a scenario: a levitated magnet with coils, sensors and controllers in closed loop on a map.

    A run that fails (falls out, leaves the map, hits a wall, saturates) ends with the name of what happened; the exit
    code is 1 if all runs do.
    """
    from fieldmap.cli.progress import Progress
    from fieldmap.cli.simulate_text import as_json, print_runs
    from fieldmap.cli.simulating import Wanted, check_wanted, simulate_all

    wanted = Wanted(scenario, map_file, output, save, runs, seed, threads, tuple(changes or ()), vary)
    check_wanted(wanted)
    with Progress("simulate", kernels="motion") as progress:
        outcome = simulate_all(wanted, progress)
    if json:
        from fieldmap.cli.printing import print_json

        print_json(as_json(outcome))
    else:
        print_runs(outcome)
    if all(result.metrics.event for batch in outcome.batches for result in batch.results):
        raise typer.Exit(1)
