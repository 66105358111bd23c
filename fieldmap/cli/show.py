"""`fieldmap show`: look at a device, a map or a run."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldmap.cli.options import (
    Changes,
    Json,
    MuR,
    Nonlinear,
    Refinement,
    changes_of_device,
    checked_iron,
    find_named,
)

if TYPE_CHECKING:
    from typing import Any

    from fieldmap.io import IronOptions
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
            help="What to draw: device, mesh, iron, lines, slices, surfaces, forces, equilibrium, difference "
            "shift or reachable; path for a run.",
        ),
    ] = "",
    currents: Annotated[
        list[str] | None,
        typer.Option(
            "--currents", metavar="A[,A...]", help="One per coil, one for all, or NAME=A. Default: 1 A."
        ),
    ] = None,
    quantity: Annotated[
        str,
        typer.Option(
            "--quantity",
            metavar="NAME",
            help="For slices, surfaces and difference: B, Bz or gradB. For shift: x or y. For reachable: "
            "force or B.",
        ),
    ] = "",
    minus: Annotated[
        str | None,
        typer.Option(
            "--minus", metavar="DEVICE_OR_MAP", help="Subtract this field, and draw the difference."
        ),
    ] = None,
    height_mm: Annotated[
        float | None,
        typer.Option(
            "--height-mm",
            metavar="MM",
            help="For shift: z of the magnet's centre. Default: where it floats at these currents.",
        ),
    ] = None,
    at_mm: Annotated[
        str | None,
        typer.Option(
            "--at-mm", metavar="X Y Z", help="For reachable: the point, mm. Default: middle of the workspace."
        ),
    ] = None,
    limit: Annotated[
        float | None,
        typer.Option(
            "--limit", metavar="A", help="For reachable: of every current. Default: the driver's, or 3 A."
        ),
    ] = None,
    save: Annotated[
        Path | None,
        typer.Option(
            "--save",
            metavar="FILE",
            help=".png, .html (for a browser, no server) or .vtm (ParaView); for a run also .gif or .mp4.",
        ),
    ] = None,
    changes: Changes = None,
    mu_r: MuR = None,
    nonlinear: Nonlinear = False,
    refinement: Refinement = 1.0,
    json: Json = False,
) -> None:
    """Draw a device, its iron, its field, or a simulated run; a window opens unless --save names a file."""
    from fieldmap.cli.printing import print_json
    from fieldmap.io import is_map_file
    from fieldmap.plot.gather import shown_run
    from fieldmap.plot.scenes import FORMATS, MOVIES, check_format, check_scene
    from fieldmap.store import is_run_file

    of_map = is_map_file(source)
    recorded = of_map and is_run_file(source)
    if save is not None:
        check_format(save, (*MOVIES, *FORMATS) if recorded else FORMATS)
    options, settings = checked_iron(mu_r, nonlinear, refinement, "auto"), changes_of_device(changes)
    chosen = what or _default_scene(of_map, recorded, minus)
    check_scene(chosen, quantity)
    if recorded:
        iron = {"--mu-r": mu_r is not None, "--nonlinear": nonlinear, "--refinement": refinement != 1.0}
        iron |= {"--set": bool(settings)}
        _refuse_for_runs(chosen, {"--currents": bool(currents), "--minus": minus is not None, **iron})
        shown = shown_run(source)
    else:
        height = None if height_mm is None else 1e-3 * height_mm
        shown = _gather(
            source, settings, chosen, currents or ["1"], options, minus, height, at_mm, limit, quantity
        )
    if save is not None and save.suffix in MOVIES:
        ranges = _animate(shown, save)
    else:
        ranges = _draw(shown, chosen, quantity, save)
    if json:
        print_json({"source": source, "what": chosen, "saved": save, "ranges": ranges} | shown.to_dict())
    elif save is not None:
        print(save)


def _gather(
    source: str,
    settings: "dict[str, Any]",
    what: str,
    currents: list[str],
    options: "IronOptions",
    minus: str | None,
    height: float | None,
    at_mm: str | None,
    limit: float | None,
    quantity: str,
) -> "Shown":
    from fieldmap.cli.arguments import parse_currents, parse_points
    from fieldmap.io import IronOptions, is_map_file, named_device
    from fieldmap.plot.gather import shown_device, shown_field, shown_mesh
    from fieldmap.progress import Progress

    if not is_map_file(source) and what == "device":
        return shown_device(named_device(source, settings))
    if not is_map_file(source) and what == "mesh":
        return shown_mesh(named_device(source, settings), options.refinement)
    with Progress("show") as progress:
        found, other = find_named(source, options, progress, settings), None
        if minus is not None and what == "difference":
            other = find_named(minus, IronOptions() if is_map_file(minus) else options, progress)
        place = parse_points([], [at_mm])[0] if at_mm else None
        amperes = parse_currents(currents, found.coil_names)
        return shown_field(found, amperes, what, other, height, place, limit, quantity)


def _default_scene(of_map: bool, recorded: bool, minus: str | None) -> str:
    """What is shown without --what."""
    if recorded:
        return "path"
    return "difference" if minus else "slices" if of_map else "device"


def _refuse_for_runs(what: str, given: dict[str, bool]) -> None:
    from fieldmap.errors import InputError, Problem

    wrong = [name for name, there in given.items() if there]
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
        save_scene(scene, save, shown.title, axes_of(what, quantity, shown))
        scene.close()
    return ranges


def _animate(shown: "Shown", save: Path) -> dict[str, list[float]]:
    from fieldmap.plot.animation import CURRENT, save_animation
    from fieldmap.progress import Progress

    assert shown.run is not None
    with Progress("show") as progress:
        save_animation(shown.run, save, progress)
    return {CURRENT: [float(shown.run.currents.min()), float(shown.run.currents.max())]}
