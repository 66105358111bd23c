"""`fieldmap show`: look at a device or a map."""

from pathlib import Path
from typing import Annotated

import typer

from fieldmap.cli.options import MuR, Nonlinear, Refinement


def show(
    source: Annotated[str, typer.Argument(metavar="DEVICE_OR_MAP", help="Device file or name, or map file.")],
    what: Annotated[
        str,
        typer.Option(
            "--what",
            help="device, mesh, iron, lines, slices, surfaces, forces, equilibrium, difference or shift.",
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
            "--quantity", help="Of slices, surfaces and difference: B, Bz or gradB; of shift: x or y."
        ),
    ] = "",
    minus: Annotated[
        str | None,
        typer.Option("--minus", metavar="DEVICE_OR_MAP", help="Draw the difference to this one's field."),
    ] = None,
    height_mm: Annotated[
        float | None, typer.Option("--height-mm", help="Of shift: z of the magnet's centre.")
    ] = None,
    save: Annotated[
        Path | None,
        typer.Option("--save", metavar="FILE", help=".png, .html (a browser, no server) or .vtm (ParaView)."),
    ] = None,
    mu_r: MuR = None,
    nonlinear: Nonlinear = False,
    refinement: Refinement = 1.0,
) -> None:
    """Draw a device, its iron, or its field; a window opens unless --save names a file."""
    from fieldmap.cli.iron import checked_choice
    from fieldmap.cli.opening import is_map
    from fieldmap.cli.shown_sources import Request, gather
    from fieldmap.view.scenes import axes_of, check_format, check_scene, make_scene, save_scene

    if save is not None:
        check_format(save)
    choice = checked_choice(mu_r, nonlinear, refinement, "auto")
    chosen = what or ("difference" if minus else "slices" if is_map(source) else "device")
    check_scene(chosen, quantity)
    shown = gather(Request(source, chosen, tuple(currents or ["1"]), choice, minus, height_mm))
    scene = make_scene(shown, chosen, quantity, off_screen=save is not None)
    if save is None:
        scene.show()
    else:
        print(save_scene(scene, save, shown.title, axes_of(chosen, quantity)))
        scene.close()
