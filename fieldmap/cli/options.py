"""Arguments and options that several commands share, with one wording each, and what the shell completes them to."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldmap.shipped import shipped_names

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from typing import Any

    from fieldmap.device.model import Device
    from fieldmap.errors import Problem
    from fieldmap.field import Field
    from fieldmap.io import FieldSource, IronOptions
    from fieldmap.typing import Progress


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

    >>> studies("pole_d")
    ['pole_disk']
    """
    return _begin([name.split("/")[-1] for name in shipped_names("maps", "studies")], incomplete)


def fits(incomplete: str) -> list[str]:
    """Names of shipped fits that begin like this.

    >>> fits("loop")
    ['loop_and_sphere']
    """
    return _begin([name.split("/")[-1] for name in shipped_names("maps", "fits")], incomplete)


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
DeviceOrMapArgument = Annotated[
    str,
    typer.Argument(
        metavar="DEVICE_OR_MAP",
        help="Device file, name of a shipped device, or map file.",
        autocompletion=devices,
    ),
]
MapArgument = Annotated[str, typer.Argument(metavar="MAP", help="Map file.")]
ScenarioArgument = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO",
        help="Scenario file, or the name of a shipped scenario: `hold` takes any map.",
        autocompletion=scenarios,
    ),
]
ScenarioMap = Annotated[
    Path | None,
    typer.Option(
        "--map", metavar="FILE", help="Map file in place of the scenario's, or a device with linear iron."
    ),
]
Changes = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Change a key of the device, such as parameters.gap=120; may be repeated.",
    ),
]
At = Annotated[list[str] | None, typer.Option("--at", metavar="X Y Z", help="Point in m; may be repeated.")]
AtMm = Annotated[
    list[str] | None, typer.Option("--at-mm", metavar="X Y Z", help="Point in mm; may be repeated.")
]
PayloadOf = Annotated[
    str | None, typer.Option("--payload-of", metavar="DEVICE", help="Take the payload from this device.")
]
Resume = Annotated[bool, typer.Option("--resume/--fresh", help="Continue a stopped run, or start again.")]
NumberOfWorkers = Annotated[
    int, typer.Option("--workers", metavar="N", min=1, help="Number of processes on this machine.")
]
Scheduler = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="ADDRESS", help="Address of a dask scheduler, whose workers solve."),
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON.")]

_IRON = "Iron (of a device)"
MuR = Annotated[
    float | None,
    typer.Option(
        "--mu-r",
        metavar="NUMBER",
        help="Relative permeability of all iron, in place of the file's.",
        rich_help_panel=_IRON,
    ),
]
Nonlinear = Annotated[
    bool,
    typer.Option(
        "--nonlinear",
        help="Let the iron saturate by its B-H table, at the given currents.",
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


def checked_iron(
    mu_r: float | None, nonlinear: bool, refinement: float, form: str, tolerance: float | None = None
) -> "IronOptions":
    """The options of the iron. Raises InputError for everything that is wrong with them."""
    from fieldmap.errors import InputError, Problem
    from fieldmap.io import IronOptions

    problems = []
    if mu_r is not None and not 0.0 < mu_r < float("inf"):
        remedy = "give the relative permeability"
        problems.append(Problem("--mu-r", "must be a positive number", f"{mu_r}", remedy))
    if not 0.0 < refinement < float("inf"):
        remedy = "try 1.5 for a finer mesh, 0.7 for a coarser one"
        problems.append(Problem("--refinement", "must be a positive number", f"{refinement}", remedy))
    if form != IronOptions.form:
        # Not for a map, whose lookup needs no solver.
        from fieldmap.iron.solvers.linear import FORMS

        if form not in FORMS:
            problems.append(Problem("--form", f"must be one of {', '.join(FORMS)}", form, "leave it out"))
    if nonlinear and mu_r is not None:
        remedy = "leave one of them out: nonlinear iron follows its B-H table, --mu-r makes it linear"
        problems.append(Problem("--nonlinear", "must not come with --mu-r", f"--mu-r {mu_r:g}", remedy))
    if nonlinear and form in ("flux", "surface"):
        remedy = f"leave --form out; the {form} form is for linear iron"
        problems.append(Problem("--nonlinear", "must go with the potential form", f"--form {form}", remedy))
    if tolerance is not None:
        problems += _tolerance_problems(tolerance, nonlinear, refinement, form)
    if problems:
        raise InputError(*problems)
    return IronOptions(mu_r, nonlinear, refinement, form, tolerance)


def _tolerance_problems(tolerance: float, nonlinear: bool, refinement: float, form: str) -> "list[Problem]":
    """--tolerance chooses the mesh and the form itself, and estimates the error of linear iron only."""
    from fieldmap.errors import Problem

    problems = []
    if not 0.0 < tolerance < 1.0:
        problems.append(Problem("--tolerance", "must lie between 0 and 1", f"{tolerance}", "try 1e-3"))
    others = {
        "--nonlinear": nonlinear,
        f"--refinement {refinement:g}": refinement != 1.0,
        f"--form {form}": form != "auto",
    }
    for other in (name for name, given in others.items() if given):
        remedy = "leave one of them out: --tolerance refines linear iron by itself"
        problems.append(Problem("--tolerance", "must stand alone", other, remedy))
    return problems


def require_currents(nonlinear: bool, currents: list[str] | None, where: str = "--nonlinear") -> None:
    """Currents must be given where the answer is not proportional to them. where: what is not."""
    from fieldmap.errors import InputError, Problem

    if nonlinear and not currents:
        raise InputError(
            Problem(
                where,
                "must come with --currents: how far iron saturates depends on them",
                "no --currents",
                "add --currents A (one number for all coils, or one per coil)",
            )
        )


def find_named(
    name: str,
    options: "IronOptions",
    progress: "Progress | None" = None,
    changes: "Mapping[str, Any] | None" = None,
) -> "FieldSource":
    """The map or device of this name. Raises InputError for options of a device that stand beside a map."""
    from fieldmap.io import find_source, is_map_file

    if is_map_file(name):
        refuse_iron_of_map(options, changes)
    return find_source(name, options, progress, changes)


def changes_of_device(texts: list[str] | None) -> "dict[str, Any]":
    """Values by key from the values of `--set`. Raises InputError for a text that is not KEY=VALUE."""
    from fieldmap.cli.arguments import parse_setting

    return dict(parse_setting(text, "--set", "parameters.gap=120") for text in texts or [])


def refuse_iron_of_map(options: "IronOptions", changes: "Mapping[str, Any] | None" = None) -> None:
    """Raise InputError for options of the iron and changes of the device, which a map does not take."""
    from fieldmap.errors import InputError, Problem

    changed = {
        "--mu-r": options.mu_r is not None,
        "--nonlinear": options.nonlinear,
        "--refinement": options.refinement != 1.0,
        "--form": options.form != "auto",
        "--set": bool(changes),
    }
    given = ", ".join(name for name, differs in changed.items() if differs)
    if given:
        remedy = "leave it out, or name a device"
        raise InputError(Problem(given, "must go with a device", "a map, whose iron is fixed", remedy))


def field_opener(name: Path | None) -> "Callable[[], Field] | None":
    """What opens the map of `--map`, for currents beyond its table too, or solves the device that is named there."""
    if name is None:
        return None
    given = str(name)

    def opened() -> "Field":
        from fieldmap.io import existing_map, is_map_file, open_field
        from fieldmap.lookup import open_map

        if is_map_file(given) or not _names_device(given):
            return open_map(existing_map(given), outside_currents="evaluate")
        return open_field(given)

    return opened


def device_of_option(name: Path | None) -> "Device | None":
    """The device that `--map` names in the place of a map: for scenarios that name none."""
    from fieldmap.io import is_map_file, named_device

    given = str(name)
    return None if name is None or is_map_file(given) or not _names_device(given) else named_device(given)


def _names_device(name: str) -> bool:
    return name.endswith(".toml") or name in shipped_names("geometry")
