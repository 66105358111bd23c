"""Which commands there are."""

from collections.abc import Callable
from typing import Annotated, Any

import typer

from fieldmap.cli import (
    check,
    equilibrium,
    export,
    info,
    linearise,
    make_map,
    probe,
    schema,
    show,
    simulate,
    solve,
    study,
    thesis,
)

COMMANDS: dict[str, tuple[Callable[..., Any], str]] = {
    "check": (check.check, "fieldmap check drive_unit"),
    "solve": (solve.solve, "fieldmap solve loop_and_sphere"),
    "map": (make_map.make_map, "fieldmap map maps/workspace.toml -o maps/out/workspace.h5 --summary"),
    "info": (info.info, "fieldmap info maps/out/workspace.h5"),
    "probe": (probe.probe, "fieldmap probe drive_unit --at 0 0 -0.1 --currents 1.5 --payload"),
    "equilibrium": (equilibrium.equilibrium, "fieldmap equilibrium maps/out/workspace.h5 --sensor-mm 10"),
    "export": (export.export, "fieldmap export maps/out/workspace.h5 --to c -o workspace.fmap"),
    "show": (show.show, "fieldmap show drive_unit --what iron --currents 1.5 --save iron.png"),
    "simulate": (simulate.simulate, "fieldmap simulate vertical_step --save vertical_step.png"),
    "linearise": (linearise.linearise, "fieldmap linearise vertical_step --depths 5,10,15"),
    "study": (study.study, "fieldmap study pole_disk"),
    "thesis": (thesis.thesis, "fieldmap thesis S7 S20"),
    "schema": (schema.schema, "fieldmap schema > device.schema.json"),
}


def application() -> typer.Typer:
    """A new application with every command; each help text ends with an example."""
    app = typer.Typer(
        name="fieldmap",
        help="Fields, gradients and forces of coils with soft iron, without finite elements.",
        epilog="Start with: fieldmap check drive_unit",
        no_args_is_help=True,
        add_completion=True,
        pretty_exceptions_enable=False,
        rich_markup_mode="rich",
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_common)
    for name, (function, example) in COMMANDS.items():
        app.command(name=name, epilog=f"Example: {example}")(function)
    return app


def _print_version(wanted: bool) -> None:
    if wanted:
        import fieldmap

        print(f"fieldmap {fieldmap.__version__}")
        raise typer.Exit


def _be_quiet(wanted: bool) -> None:
    from fieldmap.cli.progress import Progress

    Progress.shown = not wanted


def _common(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
    quiet: Annotated[
        bool,
        typer.Option("--quiet", "-q", callback=_be_quiet, help="No progress; results and problems only."),
    ] = False,
) -> None:
    """Fields, gradients and forces of coils with soft iron, without finite elements."""
