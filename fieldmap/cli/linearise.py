"""`fieldmap linearise`: the machine of a scenario as a linear model."""

from pathlib import Path
from typing import Annotated

import typer

from fieldmap.cli.options import Json, ScenarioArgument, ScenarioMap


def linearise(
    scenario: ScenarioArgument,
    map_file: ScenarioMap = None,
    depths: Annotated[
        str | None,
        typer.Option(
            "--depths", metavar="A,B,...", help="Readings of the vertical sensor, mm; the start's otherwise."
        ),
    ] = None,
    changes: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="Change a key, such as control.z.Kc=0.2; may be repeated."
        ),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="Write the models: .json or .npz.")
    ] = None,
    json: Json = False,
) -> None:
    """Linearise the machine of a scenario about its rest: poles, coupling of the axes, loop and margins, by height.

    The exit code is 1 if the loop is unstable at any of the depths.
    """
    from fieldmap.cli.linearise_text import as_json, print_points
    from fieldmap.cli.linearising import Wanted, check_wanted, linearise_all

    wanted = Wanted(scenario, map_file, depths, tuple(changes or ()), output)
    check_wanted(wanted)
    outcome = linearise_all(wanted)
    if json:
        from fieldmap.cli.printing import print_json

        print_json(as_json(outcome))
    else:
        print_points(outcome)
    if not all(point.loop.stable for point in outcome.points):
        raise typer.Exit(1)
