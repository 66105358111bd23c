"""The options that several commands share, with one wording each."""

from pathlib import Path
from typing import Annotated

import typer

from fieldmap.cli.completion import devices, scenarios

DeviceArgument = Annotated[
    str,
    typer.Argument(
        metavar="DEVICE", help="Device file, or the name of a shipped device.", autocompletion=devices
    ),
]
ScenarioArgument = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO",
        help="Scenario file, or the name of a shipped scenario: `hold` takes any map.",
        autocompletion=scenarios,
    ),
]
ScenarioMap = Annotated[
    Path | None, typer.Option("--map", metavar="FILE", help="Map file in the place of the scenario's.")
]
At = Annotated[list[str] | None, typer.Option("--at", metavar="X Y Z", help="Point in m; may be repeated.")]
AtMm = Annotated[
    list[str] | None, typer.Option("--at-mm", metavar="X Y Z", help="Point in mm; may be repeated.")
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]

_IRON = "Iron (of a device)"
MuR = Annotated[
    float | None,
    typer.Option(
        "--mu-r",
        metavar="NUMBER",
        help="Relative permeability of all iron; the file's otherwise.",
        rich_help_panel=_IRON,
    ),
]
Nonlinear = Annotated[
    bool,
    typer.Option(
        "--nonlinear",
        help="Iron that saturates, by its B-H table, at the given currents.",
        rich_help_panel=_IRON,
    ),
]
Refinement = Annotated[
    float,
    typer.Option(
        "--refinement",
        metavar="NUMBER",
        help="Divide the mesh sizes of the file by this.",
        rich_help_panel=_IRON,
    ),
]
Form = Annotated[
    str,
    typer.Option(
        "--form",
        metavar="NAME",
        help="potential, flux (any mu_r), or auto: potential where all mu_r >= 1.",
        rich_help_panel=_IRON,
    ),
]
