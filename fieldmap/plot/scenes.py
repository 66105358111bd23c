"""Scenes by name, and their files: what `fieldmap show` draws."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyvista as pv

from fieldmap.errors import InputError, Problem
from fieldmap.plot.device_drawing import MM, device_scene
from fieldmap.plot.equilibrium_shift import COORDINATES, add_shift, shift_titles
from fieldmap.plot.field_lines import add_field_lines
from fieldmap.plot.forces import add_equilibrium, add_forces
from fieldmap.plot.iron_field import add_iron_field, add_mesh
from fieldmap.plot.picture import FROM_ABOVE, look_at
from fieldmap.plot.reachable_set import KINDS, add_reachable, reachable_titles
from fieldmap.plot.rendering import require_renderer
from fieldmap.plot.rulers import MILLIMETRES, add_rulers
from fieldmap.plot.shown import Shown
from fieldmap.plot.style import INK, save_screenshot
from fieldmap.plot.trajectory import add_path
from fieldmap.plot.volumes import QUANTITIES, add_difference, add_slices, add_surfaces
from fieldmap.plot.web_page import save_web_page

WINDOW = (1500, 1200)
FORMATS = (".png", ".html", ".vtm")
MOVIES = (".gif", ".mp4")


def _device(scene: pv.Plotter, shown: Shown, quantity: str) -> None:
    shown.need("device")
    assert shown.device is not None
    device_scene(shown.device, magnet_at=shown.equilibrium, axes=False, plotter=scene)


def _without_quantity(draw: Callable[[pv.Plotter, Shown], None]) -> Callable[[pv.Plotter, Shown, str], None]:
    return lambda scene, shown, quantity: draw(scene, shown)


def _lines(scene: pv.Plotter, shown: Shown, quantity: str) -> None:
    if shown.everywhere and shown.device is not None:
        device_scene(
            shown.device,
            None,
            shown.currents,
            axes=False,
            plotter=scene,
            iron_opacity=0.3,
            coil_opacity=0.3,
            names=False,
        )
    add_field_lines(scene, shown)


SCENES: dict[str, Callable[[pv.Plotter, Shown, str], None]] = {
    "device": _device,
    "mesh": _without_quantity(add_mesh),
    "iron": _without_quantity(add_iron_field),
    "lines": _lines,
    "slices": add_slices,
    "surfaces": add_surfaces,
    "forces": _without_quantity(add_forces),
    "equilibrium": _without_quantity(add_equilibrium),
    "difference": add_difference,
    "shift": add_shift,
    "reachable": _without_quantity(add_reachable),
    "path": _without_quantity(add_path),
}
"""Name -> what draws it."""
_WITHOUT_BOX = ("device", "mesh", "iron", "shift", "reachable")


def make_scene(
    shown: Shown,
    what: str = "device",
    quantity: str = "",
    off_screen: bool = True,
    window: tuple[int, int] = WINDOW,
) -> pv.Plotter:
    """Draw one of SCENES with rulers. quantity: one of `quantities_of(what)`, the first unless given.

    Returns the plotter: `.show()` looks at it, `save_scene` writes it. Raises InputError for unknown names and for
    what a scene needs and there is not, FieldmapError on a machine without OpenGL.
    """
    chosen = check_scene(what, quantity)
    require_renderer()
    scene = pv.Plotter(off_screen=off_screen, window_size=list(window))
    scene.background_color = pv.Color("white")
    SCENES[what](scene, shown, chosen)
    if what not in _WITHOUT_BOX and shown.lower is not None and shown.upper is not None:
        box = pv.Box(tuple(MM * np.column_stack([shown.lower, shown.upper]).ravel())).extract_all_edges()
        scene.add_mesh(box, color=INK, line_width=2.5, lighting=False)
    add_rulers(scene, titles=axes_of(what, chosen, shown))
    bounds = np.array(scene.bounds).reshape(3, 2)
    if what == "shift":
        look_at(scene, bounds, margin=0.6, view=FROM_ABOVE)
    else:
        look_at(scene, bounds, margin=0.5 if what in ("path", "reachable") else 0.25)
    scene.add_text(shown.title, position=(0.02, 0.95), viewport=True, font_size=13, color=INK)
    scene.enable_anti_aliasing("ssaa")
    return scene


def drawn_ranges(scene: pv.Plotter) -> dict[str, list[float]]:
    """Smallest and largest of each quantity that colours something, by its title with its unit."""
    ranges: dict[str, list[float]] = {}
    for actor in scene.actors.values():
        if not isinstance(actor, pv.Actor) or not actor.mapper.scalar_visibility:
            continue
        name, values = actor.mapper.array_name, actor.mapper.dataset.active_scalars
        if values is None or np.ndim(values) != 1 or not len(values) or not name:
            continue
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
        known = ranges.setdefault(name, [low, high])
        ranges[name] = [min(known[0], low), max(known[1], high)]
    return ranges


def check_scene(what: str, quantity: str = "") -> str:
    """The quantity that is drawn. Raises InputError for a scene or quantity that there is not."""
    _check_choice("what", what, tuple(SCENES))
    known = quantities_of(what)
    _check_choice("quantity", quantity or known[0], known)
    return quantity or known[0]


def quantities_of(what: str) -> tuple[str, ...]:
    """What a scene can show: x or y of "shift", force or B of "reachable", otherwise B, Bz or gradB (which only some
    scenes take)."""
    if what == "reachable":
        return KINDS
    return tuple(COORDINATES) if what == "shift" else tuple(QUANTITIES)


def axes_of(what: str, quantity: str = "", shown: Shown | None = None) -> tuple[str, str, str]:
    """Titles of a scene's axes; those of "reachable" depend on what is shown."""
    if what == "reachable" and shown is not None and shown.reachable is not None:
        return reachable_titles(shown.reachable)
    return shift_titles(quantity or quantities_of(what)[0]) if what == "shift" else MILLIMETRES


def save_scene(
    scene: pv.Plotter, path: str | Path, title: str = "", axes: tuple[str, str, str] = MILLIMETRES
) -> Path:
    """Save as .png (a picture), .html (to turn in a browser, with a title) or .vtm (for ParaView).

    axes: their titles in a page, `axes_of` of the scene.

    Raises InputError for other endings.
    """
    target = Path(path)
    check_format(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    if target.suffix == ".png":
        save_screenshot(scene, target)
    elif target.suffix == ".html":
        save_web_page(scene, target, title, axes)
    else:
        datasets = [actor.mapper.dataset for actor in scene.actors.values() if isinstance(actor, pv.Actor)]
        pv.MultiBlock(datasets).save(target)
    return target


def check_format(path: Path, formats: tuple[str, ...] = FORMATS) -> None:
    """The ending must be one of `formats`."""
    _check_choice("save", path.suffix, formats)


def _check_choice(name: str, given: str, known: tuple[str, ...]) -> None:
    if given not in known:
        raise InputError(
            Problem(name, f"must be one of {', '.join(known)}", given or "nothing", "choose one of these")
        )
