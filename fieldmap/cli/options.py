"""Arguments and options that several commands share, with one wording each, and what the shell completes them to."""

from pathlib import Path
from typing import Annotated

import typer

from fieldmap.shipped import shipped_names


def devices(incomplete: str) -> list[str]:
    """Names of shipped devices that begin like this.

    >>> devices("drive_unit_n")
    ['drive_unit_no_centre_core']
    """
    return _begin(shipped_names("geometry"), incomplete)


def recipes(incomplete: str) -> list[str]:
    """Names of shipped recipes that begin like this.

    >>> recipes("qu")
    ['quick']
    """
    return _begin(shipped_names("maps"), incomplete)


def studies(incomplete: str) -> list[str]:
    """Names of shipped studies that begin like this.

    >>> studies("po")
    ['pole_disk']
    """
    return _begin([name.split("/")[-1] for name in shipped_names("maps", "studies")], incomplete)


def scenarios(incomplete: str) -> list[str]:
    """Names of shipped scenarios that begin like this.

    >>> scenarios("vertical_r")
    ['vertical_ramp']
    """
    return _begin([name.split("/")[-1] for name in shipped_names("maps", "scenarios")], incomplete)


def _begin(names: list[str], start: str) -> list[str]:
    return [name for name in names if name.startswith(start)]


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
