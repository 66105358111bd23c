"""The commands of the program, and how their help looks."""

import inspect
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer
import typer.main
from typer.core import TyperCommand, TyperGroup

from fieldmap.cli import (
    app,
    check,
    currents,
    equilibrium,
    export,
    fit,
    identify,
    import_map,
    info,
    linearise,
    make_map,
    optimise,
    probe,
    schema,
    show,
    simulate,
    solve,
    study,
    thesis,
)

if TYPE_CHECKING:
    from typer._click import Context as CoreContext
    from typer._click import Parameter as CoreParameter

FIRST_STEPS = """[bold]First steps[/bold]
  fieldmap check drive_unit                 a machine: iron, coils, magnet
  fieldmap solve loop_and_sphere            the solver beside a closed form
  fieldmap map quick -o quick.h5 --summary  a map of field and gradient
  fieldmap probe quick.h5 --at 0 0 -0.1 --currents 1
  fieldmap show drive_unit --save unit.png  a picture
In any command: --quiet, --verbose, --log FILE. The program ends with 0 (done), 1 (failed) or 2 (bad input)."""

DEVICES, MAPS, MAGNETS, STUDIES = "Machines", "Maps", "Levitated magnets", "Studies and results"


def _without_metavar(parameters: "list[CoreParameter]") -> "list[CoreParameter]":
    """The parameters; a flag takes no value, so the help names none."""
    for parameter in parameters:
        if getattr(parameter, "is_flag", False):
            parameter.metavar = ""
    return parameters


class Command(TyperCommand):
    """A command whose help names no value for a flag, and puts no braces around an argument."""

    def get_params(self, ctx: "CoreContext") -> "list[CoreParameter]":
        """The parameters, --help among them."""
        return _without_metavar(super().get_params(ctx))

    def collect_usage_pieces(self, ctx: "CoreContext") -> list[str]:
        """The words of the usage line."""
        return [piece.replace("{", "").replace("}", "") for piece in super().collect_usage_pieces(ctx)]


class Group(TyperGroup):
    """The program itself, likewise."""

    def get_params(self, ctx: "CoreContext") -> "list[CoreParameter]":
        """The parameters, --help among them."""
        return _without_metavar(super().get_params(ctx))


class Entry(NamedTuple):
    """A command: what it calls, an example, its line in the list of commands, and the part of that list."""

    call: Callable[..., None]
    example: str
    line: str
    part: str


COMMANDS: dict[str, Entry] = {
    "check": Entry(check.check, "fieldmap check drive_unit", "Is this device or map file sound?", DEVICES),
    "solve": Entry(
        solve.solve, "fieldmap solve loop_and_sphere", "The field of a device, beside known values.", DEVICES
    ),
    "show": Entry(
        show.show,
        "fieldmap show drive_unit --what iron --currents 1.5 --save iron.png",
        "Pictures of a device, its iron, its field, or a run.",
        DEVICES,
    ),
    "schema": Entry(
        schema.schema,
        "fieldmap schema > device.schema.json",
        "JSON Schema of device files, for editors.",
        DEVICES,
    ),
    "map": Entry(
        make_map.make_map,
        "fieldmap map maps/workspace.toml -o maps/out/workspace.h5 --summary",
        "Compute the map that a recipe describes.",
        MAPS,
    ),
    "info": Entry(info.info, "fieldmap info maps/out/workspace.h5", "What a map holds.", MAPS),
    "probe": Entry(
        probe.probe,
        "fieldmap probe drive_unit --at 0 0 -0.1 --currents 1.5 --payload",
        "Field, gradient and force at points.",
        MAPS,
    ),
    "import": Entry(
        import_map.import_map,
        "fieldmap import readings.csv -o maps/out/measured.h5 --spacing-mm 5",
        "A table of flux densities becomes a map.",
        MAPS,
    ),
    "export": Entry(
        export.export,
        "fieldmap export maps/out/linear.h5 --to c -o linear.fmap",
        "A map for C or mag_manip; any field as CSV or for ParaView.",
        MAPS,
    ),
    "app": Entry(
        app.app,
        "fieldmap app maps/out/workspace.h5",
        "A window with sliders for the currents of a map.",
        MAPS,
    ),
    "equilibrium": Entry(
        equilibrium.equilibrium,
        "fieldmap equilibrium maps/out/workspace.h5 --sensor-mm 5",
        "Where a magnet floats, or the current that lifts it.",
        MAGNETS,
    ),
    "currents": Entry(
        currents.currents,
        "fieldmap currents eight_coils_bead --at-mm 0 0 0 --lift",
        "The least currents for a force or a field at a point.",
        MAGNETS,
    ),
    "simulate": Entry(
        simulate.simulate,
        "fieldmap simulate hold --map square.h5 --save held.png",
        "Run a closed loop from a scenario file.",
        MAGNETS,
    ),
    "linearise": Entry(
        linearise.linearise,
        "fieldmap linearise hold --map square.h5 --depths 40,50,60",
        "Poles, coupling and margins by height.",
        MAGNETS,
    ),
    "identify": Entry(
        identify.identify,
        "fieldmap identify rig.csv --from control --to position",
        "A model with its errors from a log of a rig.",
        MAGNETS,
    ),
    "study": Entry(study.study, "fieldmap study pole_disk", "A device with some keys varied.", STUDIES),
    "optimise": Entry(
        optimise.optimise, "fieldmap optimise pole_piece", "The best values of keys, within limits.", STUDIES
    ),
    "fit": Entry(
        fit.fit,
        "fieldmap fit loop_and_sphere -o fitted.toml",
        "Unknown numbers of a device, from measurements.",
        STUDIES,
    ),
    "thesis": Entry(
        thesis.thesis, "fieldmap thesis S7 S20", "The numbers of the thesis beside ours.", STUDIES
    ),
}


@cache
def application() -> TyperGroup:
    """The program with every command, built once in a process; each help text ends with an example."""
    commands = typer.Typer(
        name="fieldmap",
        cls=Group,
        help="Fields, gradients and forces of coils with soft iron. Only the iron is meshed, never the air.",
        epilog=FIRST_STEPS,
        no_args_is_help=True,
        add_completion=True,
        pretty_exceptions_enable=False,
        rich_markup_mode="rich",
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    commands.callback()(_common)
    for name, entry in COMMANDS.items():
        commands.command(
            name=name,
            cls=Command,
            help=paragraphs(entry.call),
            short_help=entry.line,
            epilog=f"Example: {entry.example}",
            rich_help_panel=entry.part,
        )(entry.call)
    program = typer.main.get_command(commands)
    assert isinstance(program, TyperGroup)
    return program


def paragraphs(function: Callable[..., None]) -> str:
    """The docstring of a function with one line per paragraph.

    >>> def f(): "One\\n    two.\\n\\n    Three."
    >>> paragraphs(f)
    'One two.\\n\\nThree.'
    """
    text = inspect.getdoc(function) or ""
    return "\n\n".join(" ".join(part.split()) for part in text.split("\n\n"))


def _print_version(wanted: bool) -> None:
    if wanted:
        import fieldmap

        print(f"fieldmap {fieldmap.__version__}")
        raise typer.Exit


def _be_quiet(wanted: bool) -> None:
    from fieldmap.progress import Progress

    Progress.shown = not wanted


def _be_verbose(wanted: bool) -> None:
    if wanted:
        from fieldmap.cli.log import log_to_stderr
        from fieldmap.progress import Progress

        Progress.shown = False
        log_to_stderr()


def _keep_log(path: Path | None) -> None:
    if path is not None:
        from fieldmap.cli.log import log_to_file

        log_to_file(path)


def _common(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", callback=_be_quiet, help="Print results and problems only.")
    ] = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", callback=_be_verbose, help="Print every step with its time.")
    ] = False,
    log: Annotated[
        Path | None,
        typer.Option("--log", metavar="FILE", callback=_keep_log, help="Append the same to a file."),
    ] = None,
) -> None:
    """Fields, gradients and forces of coils with soft iron. Only the iron is meshed, never the air."""
    from fieldmap.cli.map_warnings import map_warnings_as_lines

    # After the options: a log takes over all warnings.
    context.with_resource(map_warnings_as_lines())
