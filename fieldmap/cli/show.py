"""`fieldmap show`: look at a device, a map or a run."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fieldmap.cli.options import Json, MuR, Nonlinear, Refinement

if TYPE_CHECKING:
    from fieldmap.plot.shown import Shown


def show(
    source: Annotated[
        str,
        typer.Argument(
            metavar="DEVICE_OR_MAP_OR_RUN",
            help="Device file or name, map file, or a run that `fieldmap simulate -o RUN.h5` wrote.",
        ),
    ],
    what: Annotated[
        str,
        typer.Option(
            "--what",
            metavar="NAME",
            help="device, mesh, iron, lines, slices, surfaces, forces, equilibrium, difference or shift; "
            "path of a run.",
        ),
    ] = "",
    currents: Annotated[
        list[str] | None,
        typer.Option(
            "--currents", metavar="A[,A...]", help="One per coil, or one for all; 1 A unless given."
        ),
    ] = None,
    quantity: Annotated[
        str,
        typer.Option(
            "--quantity",
            metavar="NAME",
            help="Of slices, surfaces and difference: B, Bz or gradB; of shift: x or y.",
        ),
    ] = "",
    minus: Annotated[
        str | None,
        typer.Option("--minus", metavar="DEVICE_OR_MAP", help="Draw the difference to this one's field."),
    ] = None,
    height_mm: Annotated[
        float | None,
        typer.Option(
            "--height-mm",
            metavar="MM",
            help="Of shift: z of the magnet's centre; where it floats at these currents unless given.",
        ),
    ] = None,
    save: Annotated[
        Path | None,
        typer.Option(
            "--save",
            metavar="FILE",
            help=".png, .html (a browser, no server) or .vtm (ParaView); .gif or .mp4 of a run.",
        ),
    ] = None,
    mu_r: MuR = None,
    nonlinear: Nonlinear = False,
    refinement: Refinement = 1.0,
    json: Json = False,
) -> None:
    """Draw a device, its iron, its field, or a simulated run; a window opens unless --save names a file."""
    from fieldmap.cli.iron import checked_choice
    from fieldmap.cli.opening import is_map
    from fieldmap.cli.shown_sources import Request, gather, gather_run
    from fieldmap.plot.scenes import FORMATS, MOVIES, check_format, check_scene
    from fieldmap.store import is_run_file

    of_map = is_map(source)
    recorded = of_map and is_run_file(source)
    if save is not None:
        check_format(save, (*MOVIES, *FORMATS) if recorded else FORMATS)
    choice = checked_choice(mu_r, nonlinear, refinement, "auto")
    chosen = what or _usual(of_map, recorded, minus)
    check_scene(chosen, quantity)
    if recorded:
        _refuse_for_runs(
            chosen, {"--currents": currents, "--minus": minus, **dict.fromkeys(choice.given, True)}
        )
        shown = gather_run(source)
    else:
        shown = gather(Request(source, chosen, tuple(currents or ["1"]), choice, minus, height_mm))
    if save is not None and save.suffix in MOVIES:
        ranges = _animate(shown, save)
    else:
        ranges = _draw(shown, chosen, quantity, save)
    if json:
        from fieldmap.cli.printing import print_json
        from fieldmap.cli.shown_json import as_json

        print_json({"source": source, "what": chosen, "saved": save, "ranges": ranges} | as_json(shown))
    elif save is not None:
        print(save)


def _usual(of_map: bool, recorded: bool, minus: str | None) -> str:
    """What is shown where --what does not say."""
    if recorded:
        return "path"
    return "difference" if minus else "slices" if of_map else "device"


def _refuse_for_runs(what: str, given: dict[str, Any]) -> None:
    from fieldmap.errors import InputError, Problem

    wrong = [name for name, value in given.items() if value is not None]
    problems = [Problem(name, "must not come with a run", "given", "leave it out") for name in wrong]
    if what != "path":
        remedy = "leave it out, or name a device or a map"
        problems.append(Problem("--what", "must be path for a run", what, remedy))
    if problems:
        raise InputError(*problems)


def _draw(shown: "Shown", what: str, quantity: str, save: Path | None) -> dict[str, list[float]]:
    """Show or save; the ranges of what is coloured, by its title."""
    from fieldmap.plot.rendering import require_window
    from fieldmap.plot.scenes import axes_of, drawn_ranges, make_scene, save_scene

    scene = make_scene(shown, what, quantity, off_screen=save is not None)
    ranges = drawn_ranges(scene)
    if save is None:
        require_window(scene)
        scene.show()
    else:
        save_scene(scene, save, shown.title, axes_of(what, quantity))
        scene.close()
    return ranges


def _animate(shown: "Shown", save: Path) -> dict[str, list[float]]:
    from fieldmap.cli.progress import Progress
    from fieldmap.plot.animation import CURRENT, save_animation

    assert shown.run is not None
    with Progress("show") as progress:
        save_animation(shown.run, save, progress)
    return {CURRENT: [float(shown.run.currents.min()), float(shown.run.currents.max())]}
