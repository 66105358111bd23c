"""The commands of the program, and the layout of their help."""

import inspect
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer
import typer.main
from rich.markup import escape
from typer.core import TyperCommand, TyperGroup

from fieldmap.arguments import raise_all
from fieldmap.cli import answers, check, exchange, identify, maps, pictures, scenario, solve, studies, thesis
from fieldmap.cli.messages import log_to_file, log_to_stderr, map_warnings_as_lines
from fieldmap.cli.options import PARAMETERS, SHARED_HELP, check_outputs, helps
from fieldmap.errors import Problem
from fieldmap.progress import Progress

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
    """The parameters, without a metavar for flags, which take no value."""
    for parameter in parameters:
        if getattr(parameter, "is_flag", False):
            parameter.metavar = ""
    return parameters


class Command(TyperCommand):
    """A command whose outputs are checked before it begins; its help names no value for a flag, and puts no braces
    around an argument."""

    def invoke(self, ctx: "CoreContext") -> Any:
        """Run the command. Raises InputError for an output that must not be written."""
        options = {str(one.name): one.opts[0] for one in self.params}
        check_outputs(COMMANDS[str(self.name)].call, ctx.params, options)
        return super().invoke(ctx)

    def get_params(self, ctx: "CoreContext") -> "list[CoreParameter]":
        """The parameters, --help among them."""
        return _without_metavar(super().get_params(ctx))

    def parse_args(self, ctx: "CoreContext", args: list[str]) -> list[str]:
        """Raises InputError for a repeated option of one value, of which only the last would count."""
        *_, given = self.make_parser(ctx).parse_args(list(args))
        once = [
            one for one in given if not (getattr(one, "multiple", False) or getattr(one, "is_flag", False))
        ]
        repeated = {one.opts[0]: once.count(one) for one in once if once.count(one) > 1}
        raise_all(
            Problem(name, "may be given once", f"{count} times", "keep one of them")
            for name, count in repeated.items()
        )
        return super().parse_args(ctx, args)

    def collect_usage_pieces(self, ctx: "CoreContext") -> list[str]:
        """The words of the usage line."""
        return [piece.replace("{", "").replace("}", "") for piece in super().collect_usage_pieces(ctx)]


class Group(TyperGroup):
    """The program itself, with the same layout of its help."""

    def get_params(self, ctx: "CoreContext") -> "list[CoreParameter]":
        """The parameters, --help among them."""
        return _without_metavar(super().get_params(ctx))


class Entry(NamedTuple):
    """A command: its function, whose docstring is the help; the section of the list of commands; and its line there."""

    call: Callable[..., None]
    part: str
    line: str


COMMANDS: dict[str, Entry] = {
    "check": Entry(check.check, DEVICES, "Is this device or map file sound?"),
    "solve": Entry(solve.solve, DEVICES, "The field of a device, beside known values."),
    "show": Entry(pictures.show, DEVICES, "Pictures of a device, its iron, its field, or a run."),
    "schema": Entry(check.schema, DEVICES, "JSON Schema of a kind of file, for editors."),
    "map": Entry(maps.make_map, MAPS, "Compute the map that a recipe describes."),
    "info": Entry(maps.info, MAPS, "The contents of a map."),
    "probe": Entry(answers.probe, MAPS, "Field, gradient and force at points."),
    "import": Entry(exchange.import_map, MAPS, "A table of flux densities becomes a map."),
    "export": Entry(exchange.export, MAPS, "A map for C, FMI or mag_manip; a field as CSV, for ParaView."),
    "app": Entry(pictures.app, MAPS, "A window with sliders for the currents of a map."),
    "equilibrium": Entry(
        answers.equilibrium, MAGNETS, "Where a magnet floats, or the current that lifts it."
    ),
    "currents": Entry(answers.currents, MAGNETS, "The least currents for a force or a field at a point."),
    "simulate": Entry(scenario.simulate, MAGNETS, "Run a closed loop from a scenario file."),
    "linearise": Entry(scenario.linearise, MAGNETS, "Poles, coupling and margins by height."),
    "tune": Entry(scenario.tune, MAGNETS, "PID controllers of a scenario's axes, by margins."),
    "identify": Entry(identify.identify, MAGNETS, "A model with its errors from a log of a rig."),
    "study": Entry(studies.study, STUDIES, "A device with some keys varied."),
    "optimise": Entry(studies.optimise, STUDIES, "The best values of keys, within limits."),
    "fit": Entry(studies.fit, STUDIES, "Unknown numbers of a device, from measurements."),
    "thesis": Entry(thesis.thesis, STUDIES, "The numbers of the thesis beside ours."),
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
        # Words in square brackets must not become markup.
        text, example = map(escape, described(entry.call))
        about: dict[str, Any] = {"help": text, "short_help": entry.line, "epilog": example}
        commands.command(name=name, cls=Command, rich_help_panel=entry.part, **about)(entry.call)
    program = typer.main.get_command(commands)
    assert isinstance(program, TyperGroup)
    for name, command in program.commands.items():
        own = helps(inspect.getdoc(COMMANDS[name].call))
        parameters: Any = command.params
        for parameter in parameters:
            parameter.help = escape(
                own.get(parameter.name) or parameter.help or SHARED_HELP.get(parameter.name) or ""
            )
    return program


def described(function: Callable[..., None]) -> tuple[str, str]:
    """From the docstring of a command its help and the last paragraph before the parameters, which is an example; each
    paragraph in one line.

    >>> def f(): "One\\n    two.\\n\\n    Example: f 3"
    >>> described(f)
    ('One two.', 'Example: f 3')
    """
    text, _, _ = (inspect.getdoc(function) or "").partition(PARAMETERS)
    *paragraphs, example = (" ".join(part.split()) for part in text.split("\n\n"))
    return "\n\n".join(paragraphs), example


def _print_version(wanted: bool) -> None:
    if wanted:
        import fieldmap

        print(f"fieldmap {fieldmap.__version__}")
        raise typer.Exit


def _common(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print results and problems only.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Print every step with its time.")] = False,
    log: Annotated[
        Path | None, typer.Option("--log", metavar="FILE", help="Append every step with its time to a file.")
    ] = None,
) -> None:
    """Fields, gradients and forces of coils with soft iron. Only the iron is meshed, never the air."""
    Progress.shown = not (quiet or verbose)
    if verbose:
        log_to_stderr()
    if log is not None:
        log_to_file(log)
    # After the options, because a log also redirects warnings.
    context.with_resource(map_warnings_as_lines())
