"""`fieldmap show`: look at a device or a map."""

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from fieldmap.cli.options import MuR, Nonlinear, Refinement

_SOLVED = ("iron", "lines", "slices", "surfaces", "forces", "equilibrium")


def show(
    source: Annotated[str, typer.Argument(metavar="DEVICE_OR_MAP", help="Device file or name, or map file.")],
    what: Annotated[
        str,
        typer.Option("--what", help="device, mesh, iron, lines, slices, surfaces, forces or equilibrium."),
    ] = "",
    currents: Annotated[
        list[str] | None,
        typer.Option(
            "--currents", metavar="A[,A...]", help="One per coil, or one for all; 1 A unless given."
        ),
    ] = None,
    quantity: Annotated[
        str, typer.Option("--quantity", help="Of slices and surfaces: B, Bz or gradB.")
    ] = "B",
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
    from fieldmap.view.scenes import check_format, make_scene, save_scene

    if save is not None:
        check_format(save)
    choice = checked_choice(mu_r, nonlinear, refinement, "auto")
    chosen = what or ("slices" if is_map(source) else "device")
    shown = _shown(source, chosen, currents or ["1"], choice)
    scene = make_scene(shown, chosen, quantity, off_screen=save is not None)
    if save is None:
        scene.show()
    else:
        print(save_scene(scene, save, shown.title))
        scene.close()


def _shown(source: str, what: str, currents: list[str], choice: Any) -> Any:
    from fieldmap.cli.numbers import parse_currents
    from fieldmap.cli.opening import find_source, is_map, open_device
    from fieldmap.view.shown import Shown

    device = None if is_map(source) else open_device(source)
    if device is not None and what == "device":
        return Shown(device.title, device, payload=device.payload)
    if device is not None and what == "mesh":
        return _meshed(device, choice.refinement)
    found = find_source(source, choice)
    amperes = parse_currents(currents, found.coil_names)
    corners = found.corners or (None, None)
    title = f"{found.name} ({found.kind}), {_amperes_in_words(amperes, found.coil_names)}"
    about: dict[str, Any] = {"device": device, "currents": amperes, "payload": found.payload}
    about |= {"lower": corners[0], "upper": corners[1]}
    if what not in _SOLVED:
        return Shown(title, **about)
    about["field"], assumptions = found.open(amperes)
    for text in assumptions:
        if text.startswith("warning"):
            print(text, file=sys.stderr)
    if device is not None:
        about |= _iron(about["field"], amperes)
    if what == "equilibrium":
        about["equilibrium"] = _equilibrium(found, about["field"], amperes)
    return Shown(title, **about)


def _meshed(device: Any, refinement: float) -> Any:
    """The mesh alone needs no solution."""
    from fieldmap.cli.iron import require_iron
    from fieldmap.iron import generate_mesh
    from fieldmap.view.shown import Shown

    require_iron(device)
    mesh = generate_mesh(device, refinement)
    return Shown(f"{device.name}: {len(mesh.tets)} tetrahedra", device, mesh=mesh)


def _iron(field: Any, amperes: Any) -> dict[str, Any]:
    from fieldmap.view.shown import element_flux_density

    solution = field if hasattr(field, "mesh") else field.state
    if solution.mesh is None:
        return {"everywhere": True}
    flux_density = element_flux_density(solution, amperes)
    return {"everywhere": True, "mesh": solution.mesh, "flux_density": flux_density}


def _equilibrium(found: Any, field: Any, amperes: Any) -> Any:
    from fieldmap.cli.balance import searchable
    from fieldmap.levitation import find_equilibrium

    return find_equilibrium(searchable(found, field), amperes, found.payload).position


def _amperes_in_words(amperes: Any, names: tuple[str, ...]) -> str:
    if len(set(amperes)) == 1:
        return f"{amperes[0]:g} A in {'the coil' if len(names) == 1 else f'each of {len(names)} coils'}"
    return ", ".join(f"{name}: {value:g} A" for name, value in zip(names, amperes, strict=True))
