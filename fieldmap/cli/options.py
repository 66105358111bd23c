"""Arguments and options that several commands share: each has one name, one type and one help text.

Parameters
----------
device
    Device file, or the name of a shipped device.
source
    Device file, name of a shipped device, or map file.
file
    Study file, or the name of a shipped study.
scenario
    Scenario file, or the name of a shipped scenario; `hold` runs on any map.
map_file
    Map file, or a device with linear iron, in place of the scenario's map.
units
    Unit of a column of the log whose heading does not state it; may be repeated.
height_mm
    z of the magnet's centre; below the origin it is negative.
moment
    Moment of the magnet, A m2; one number is a moment upward.
payload_of
    Take the payload from this device.
limit
    Largest current of every coil. Default: the driver's.
scheduler
    Address of a dask scheduler, whose workers solve.
mu_r
    Relative permeability of all iron, in place of the file's.
nonlinear
    Let the iron saturate by its B-H table, at the given currents.
refinement
    Divide the mesh sizes of the file by this.
form
    potential (all mu_r >= 1), flux, surface, or auto: potential if possible, else flux.
tolerance
    Refine until the estimated error of B in the workspace is below this (linear iron).
currents
    Currents, A: one for all coils, one per coil, or NAME=A.
at
    Point in m; may be repeated.
at_mm
    Point in mm; may be repeated.
save
    Save the picture to this file.
plot
    Draw the results beside the file.
resume
    Continue a stopped run, or start again.
workers
    Number of processes on this machine.
json
    Print JSON.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, get_type_hints

import typer

from fieldmap.arguments import check, raise_all
from fieldmap.cli.arguments import parse_moment, parse_settings, positive_problems
from fieldmap.errors import InputError, Problem
from fieldmap.shipped import shipped_names

if TYPE_CHECKING:
    from fieldmap.device.model import Device, Payload
    from fieldmap.field import Field
    from fieldmap.io import FieldSource, IronOptions
    from fieldmap.lookup import MagneticBody
    from fieldmap.typing import Array, Progress


PARAMETERS = "\n\nParameters\n----------\n"


def helps(docstring: str | None) -> dict[str, str]:
    """The help of parameters, from the section Parameters of a docstring.

    >>> helps("Do it.\\n\\nParameters\\n----------\\nx\\n    A size,\\n    m.")
    {'x': 'A size, m.'}
    """
    _, _, section = (docstring or "").partition(PARAMETERS)
    _, *parts = re.split(r"^(\w+)\n", section, flags=re.MULTILINE)
    return {name: " ".join(words.split()) for name, words in zip(parts[::2], parts[1::2], strict=True)}


SHARED_HELP = helps(__doc__)


def shipped(folder: str, subfolder: str = "") -> Callable[[str], list[str]]:
    """A function that completes the names of shipped files.

    >>> shipped("geometry")("drive_unit_n"), shipped("maps", "fits")("loop")
    (['drive_unit_no_centre_core'], ['loop_and_sphere'])
    """

    def completed(incomplete: str) -> list[str]:
        names = (name.split("/")[-1] for name in shipped_names(folder, subfolder))
        return [name for name in names if name.startswith(incomplete)]

    return completed


def file_argument(metavar: str, folder: str, subfolder: str = "") -> Any:
    """An argument that is a file or the name of a shipped file."""
    return typer.Argument(metavar=metavar, autocompletion=shipped(folder, subfolder))


def option(name: str, metavar: str, **more: Any) -> Any:
    """An option that takes a value. metavar: the word for the value. The help text comes from a docstring."""
    return typer.Option(name, metavar=metavar, **more)


def output(text: str) -> Any:
    """The option `--output` of a command that writes one file."""
    return typer.Option("--output", "-o", metavar="FILE", help=text)


class Writes(NamedTuple):
    """Marks the parameter of a command that names an output.

    formats: names in `fieldmap.store.output_formats` for `check_outputs`; none for a folder, which the command itself
    checks.
    """

    formats: tuple[str, ...]


def writes(*formats: str) -> Writes:
    """The mark of a parameter that names a file to write in one of these formats, or a folder if there are none."""
    return Writes(formats)


def outputs_of(command: Callable[..., None]) -> dict[str, Writes]:
    """The parameters of a command that name an output."""
    marks = (
        (name, mark)
        for name, hint in get_type_hints(command, include_extras=True).items()
        for mark in getattr(hint, "__metadata__", ())
    )
    return {name: mark for name, mark in marks if isinstance(mark, Writes)}


def check_outputs(
    command: Callable[..., None], values: Mapping[str, Any], option_of: Mapping[str, str]
) -> None:
    """Raise InputError for outputs that cannot be written, or that another argument names.

    Parameters
    ----------
    command : function
        The command.
    values : mapping
        The values of its parameters.
    option_of : mapping
        The option of each parameter, for messages.
    """
    written = outputs_of(command)
    given = {name: values[name] for name, mark in written.items() if mark.formats and values.get(name)}
    if not given:
        return
    from fieldmap.store.output_formats import output_problems

    others = [
        word
        for name, value in values.items()
        if name not in written
        for word in (value if isinstance(value, list | tuple) else [value])
        if isinstance(word, str | Path)
    ]
    problems: list[Problem] = []
    for name, path in given.items():
        problems += output_problems(option_of[name], path, written[name].formats, others)
        others.append(path)
    raise_all(problems)


def setting(what: str, example: str) -> Any:
    """The option `--set` for the keys of a kind of file."""
    text = f"Change a key of the {what} for this run, such as {example}; may be repeated."
    return typer.Option("--set", metavar="KEY=VALUE", help=text)


DeviceArgument = Annotated[str, file_argument("DEVICE", "geometry")]
DeviceOrMapArgument = Annotated[str, file_argument("DEVICE_OR_MAP", "geometry")]
MapArgument = Annotated[str, typer.Argument(metavar="MAP", help="Map file.")]
StudyArgument = Annotated[str, file_argument("STUDY", "maps", "studies")]
ScenarioArgument = Annotated[str, file_argument("SCENARIO", "maps", "scenarios")]
ScenarioMap = Annotated[Path | None, option("--map", "FILE")]
Changes = Annotated[list[str] | None, setting("device", "parameters.gap=120")]
ScenarioChanges = Annotated[list[str] | None, setting("scenario", "control.z.Kc=0.2")]
Units = Annotated[list[str] | None, option("--unit", "NAME=UNIT")]
CURRENTS = option("--currents", "A[,A...]")
Currents = Annotated[list[str] | None, CURRENTS]
At = Annotated[list[str] | None, option("--at", "X Y Z")]
AtMm = Annotated[list[str] | None, option("--at-mm", "X Y Z")]
HeightMm = Annotated[float | None, option("--height-mm", "MM")]
Moment = Annotated[str | None, option("--moment", "X Y Z")]
PayloadOf = Annotated[str | None, option("--payload-of", "DEVICE", autocompletion=shipped("geometry"))]
Limit = Annotated[float | None, option("--limit", "A")]
SAVE = option("--save", "FILE")
Plot = Annotated[bool, typer.Option("--plot/--no-plot")]
Resume = Annotated[bool, typer.Option("--resume/--fresh")]
Workers = Annotated[int, option("--workers", "N", min=1)]
Scheduler = Annotated[str | None, option("--scheduler", "ADDRESS")]
Json = Annotated[bool, typer.Option("--json")]

iron_option = partial(option, rich_help_panel="Iron (of a device)")
MuR = Annotated[float | None, iron_option("--mu-r", "NUMBER")]
Nonlinear = Annotated[bool, iron_option("--nonlinear", "")]
Refinement = Annotated[float, iron_option("--refinement", "NUMBER")]
Form = Annotated[str, iron_option("--form", "NAME")]
Tolerance = Annotated[float | None, iron_option("--tolerance", "NUMBER")]


def checked_iron(
    mu_r: float | None, nonlinear: bool, refinement: float, form: str = "auto", tolerance: float | None = None
) -> IronOptions:
    """The options of the iron. Raises InputError with all problems."""
    from fieldmap.io import IronOptions

    problems = positive_problems("--mu-r", mu_r, "give the relative permeability")
    problems += positive_problems(
        "--refinement", refinement, "try 1.5 for a finer mesh, 0.7 for a coarser one"
    )
    if form != IronOptions.form:
        # Imported only for another form, because lookup in a map needs no solver.
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
    raise_all(problems)
    return IronOptions(mu_r, nonlinear, refinement, form, tolerance)


def of_device(
    changes: list[str] | None, mu_r: float | None, nonlinear: bool, refinement: float, form: str = "auto"
) -> tuple[IronOptions, dict[str, object]]:
    """The options of the iron, and the keys that `--set` changes."""
    return checked_iron(mu_r, nonlinear, refinement, form), parse_settings(changes)


def _tolerance_problems(tolerance: float, nonlinear: bool, refinement: float, form: str) -> list[Problem]:
    """Problems of options with --tolerance, which selects mesh and form itself, and works for linear iron only."""
    problems = []
    if not 0.0 < tolerance < 1.0:
        problems.append(Problem("--tolerance", "must lie between 0 and 1", f"{tolerance}", "try 1e-3"))
    others = {
        "--nonlinear": nonlinear,
        f"--refinement {refinement:g}": refinement != 1.0,
        f"--form {form}": form != "auto",
    }
    remedy = "leave one of them out: --tolerance refines linear iron by itself"
    for other in (name for name, given in others.items() if given):
        problems.append(Problem("--tolerance", "must stand alone", other, remedy))
    return problems


def changed_iron(options: IronOptions, changes: Mapping[str, Any]) -> list[str]:
    """Names of the options of the iron that were given, and `--set` if it was."""
    given = {
        "--mu-r": options.mu_r is not None,
        "--nonlinear": options.nonlinear,
        "--refinement": options.refinement != 1.0,
        "--form": options.form != "auto",
        "--set": bool(changes),
    }
    return [name for name, there in given.items() if there]


def refuse_iron_of_map(options: IronOptions, changes: Mapping[str, Any]) -> None:
    """Raise InputError for options of the iron or changes of the device, which a map does not accept."""
    given = ", ".join(changed_iron(options, changes))
    received, remedy = "a map, whose iron is fixed", "leave it out, or name a device"
    check(not given, given, "must go with a device", received, remedy)


def require_currents(nonlinear: bool, currents: list[str] | None, where: str = "--nonlinear") -> None:
    """Raise InputError if currents are missing where the answer is not proportional to them.

    Parameters
    ----------
    nonlinear : bool
        Whether the answer is not proportional to the currents.
    currents : list of str or None
        The values of `--currents`.
    where : str
        The option or file that makes the answer nonlinear.
    """
    must_hold = "must come with --currents: how far iron saturates depends on them"
    remedy = "add --currents A (one number for all coils, or one per coil)"
    check(bool(currents) or not nonlinear, where, must_hold, "no --currents", remedy)


def find_named(
    name: str, options: IronOptions, progress: Progress | None, changes: Mapping[str, Any]
) -> FieldSource:
    """The map or device of this name. Raises InputError if options of a device are given with a map."""
    from fieldmap.io import find_source, is_map_file

    if is_map_file(name):
        refuse_iron_of_map(options, changes)
    return find_source(name, options, progress, changes)


def payload_of_option(found: FieldSource, payload_of: str | None) -> Payload | None:
    """The payload of the device that `--payload-of` names, otherwise the payload of the source."""
    from fieldmap.io import named_device

    return found.payload if payload_of is None else named_device(payload_of).payload


def magnet_of_options(
    found: FieldSource, moment: str | None, payload_of: str | None, needed_by: str = ""
) -> Array | MagneticBody | None:
    """The magnet of `--moment` or `--payload-of`, otherwise the payload of the source.

    Parameters
    ----------
    found : FieldSource
        The map or device.
    moment, payload_of : str or None
        The values of the two options.
    needed_by : str
        The option that needs the payload of the source, for the message if there is none; empty if none does.

    Returns
    -------
    array (3,), MagneticBody or None
        For a point dipole its moment, A m^2; for any other payload its body; None if no magnet was requested.

    Raises
    ------
    InputError
        If the device has no payload.
    """
    if moment is not None:
        return parse_moment(moment)
    if not (payload_of or needed_by):
        return None
    payload = payload_of_option(found, payload_of)
    if payload is None:
        must_hold = f"must have a [payload] table for {'--payload-of' if payload_of else needed_by}"
        remedy = "add one, name a device that has one with --payload-of, or give --moment X Y Z"
        raise InputError.of(payload_of or found.name, must_hold, "none", remedy)
    if payload.extended:
        from fieldmap.lookup import magnetic_body

        return magnetic_body(payload)
    return payload.moment_vector


def field_of_option(name: Path | None) -> tuple[Callable[[], Field] | None, Device | None]:
    """A function that opens the map or solves the device of `--map`, and this device. Each is None if there is none."""
    from fieldmap.io import existing_map, is_map_file, named_device, open_field
    from fieldmap.lookup import open_map

    if name is None:
        return None, None
    given = str(name)
    names_device = given.endswith(".toml") or given in shipped_names("geometry")
    if is_map_file(given) or not names_device:
        # A controller may ask for currents beyond the map's table.
        return lambda: open_map(existing_map(given), outside_currents="evaluate"), None
    return lambda: open_field(given), named_device(given)
