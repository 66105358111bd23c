"""Scenes by name, and their files: what `fieldmap show` draws."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyvista as pv

from fieldmap.arguments import check_choice
from fieldmap.plot.animation import add_path
from fieldmap.plot.device_drawing import device_scene
from fieldmap.plot.equilibrium_shift import COORDINATES, add_shift, shift_titles
from fieldmap.plot.field_scenes import (
    QUANTITIES,
    add_difference,
    add_field_lines,
    add_iron_field,
    add_mesh,
    add_slices,
    add_surfaces,
)
from fieldmap.plot.forces import add_equilibrium, add_forces
from fieldmap.plot.picture import FROM_ABOVE, look_at
from fieldmap.plot.reachable_set import KINDS, add_reachable, reachable_titles
from fieldmap.plot.rendering import new_scene
from fieldmap.plot.scales import MILLIMETRES, add_rulers, add_words
from fieldmap.plot.shown import Shown
from fieldmap.plot.solids import box_edges, extent
from fieldmap.plot.style import INK, save_screenshot
from fieldmap.plot.web_page import save_web_page

WINDOW = (1500, 1200)
FORMATS = (".png", ".html", ".vtm")
MOVIES = (".gif", ".mp4")


def _device(scene: pv.Plotter, shown: Shown) -> None:
    assert shown.device is not None
    device_scene(shown.device, magnet_at=shown.equilibrium, axes=False, plotter=scene)


def _lines(scene: pv.Plotter, shown: Shown) -> None:
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


Draw = Callable[[pv.Plotter, Shown, str], None]


def _scene(draw: Callable[[pv.Plotter, Shown], None], *needs: str) -> Draw:
    """A scene that shows one quantity only; needs: what `Shown` must have for it."""
    return _of_quantity(lambda scene, shown, _: draw(scene, shown), *needs)


def _of_quantity(draw: Draw, *needs: str) -> Draw:
    def drawn(scene: pv.Plotter, shown: Shown, quantity: str) -> None:
        shown.need(*needs)
        draw(scene, shown, quantity)

    return drawn


SCENES: dict[str, Draw] = {
    "device": _scene(_device, "device"),
    "mesh": _scene(add_mesh, "mesh"),
    "iron": _scene(add_iron_field, "mesh"),
    "lines": _scene(_lines, "field", "lower"),
    "slices": _of_quantity(add_slices, "field", "lower"),
    "surfaces": _of_quantity(add_surfaces, "field", "lower"),
    "forces": _scene(add_forces, "field", "lower", "payload"),
    "equilibrium": _scene(add_equilibrium, "field", "lower", "payload", "equilibrium"),
    "difference": _of_quantity(add_difference, "field", "lower"),
    "shift": _of_quantity(add_shift, "surface"),
    "reachable": _scene(add_reachable, "reachable"),
    "path": _scene(add_path, "run"),
}
"""Name -> what draws it."""
_LEGENDS = {
    "slices": "arrows: direction of B",
    "forces": "arrows: force on the magnet, whose centre lies in their middle",
    "equilibrium": "red: the magnet in balance; arrows: magnetic force and weight together",
    "path": "red: outline of the magnet at the end; black: the path that was asked for",
}
"""What arrows and lines mean, in a scene of its first quantity."""
_WITHOUT_BOX = ("device", "mesh", "iron", "shift", "reachable")


def make_scene(
    shown: Shown,
    what: str = "device",
    quantity: str = "",
    off_screen: bool = True,
    window: tuple[int, int] = WINDOW,
) -> pv.Plotter:
    """Draw one of SCENES with rulers.

    Parameters
    ----------
    shown
        What there is to draw.
    what
        One of SCENES.
    quantity
        One of `quantities_of(what)`, the first unless given.
    off_screen
        Whether no window opens.
    window
        Size of the picture, pixels.

    Returns
    -------
    pv.Plotter
        The plotter: `.show()` looks at it, `save_scene` writes it.

    Raises
    ------
    InputError
        For unknown names, and for what the scene needs and `shown` lacks.
    FieldmapError
        On a machine without OpenGL.
    """
    chosen = check_scene(what, quantity)
    scene = new_scene(window, off_screen)
    SCENES[what](scene, shown, chosen)
    if what not in _WITHOUT_BOX and shown.lower is not None and shown.upper is not None:
        scene.add_mesh(box_edges(shown.box), color=INK, line_width=2.5, lighting=False)
    add_rulers(scene, titles=axes_of(what, chosen, shown))
    if what == "shift":
        look_at(scene, extent(scene), margin=0.4, view=FROM_ABOVE)
    else:
        look_at(scene, extent(scene), margin=0.3)
    legend = _LEGENDS.get(what, "") if chosen == quantities_of(what)[0] else ""
    words = f"{shown.title}\n{legend}".rstrip()
    add_words(scene, words, (0.02, 0.985))
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
    known = quantities_of(check_choice("what", what, SCENES))
    return check_choice("quantity", quantity or known[0], known)


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
    """Save a scene.

    Parameters
    ----------
    scene
        Of `make_scene`.
    path
        Ends in .png (a picture), .html (a page that a browser turns) or .vtm (for ParaView).
    title
        Of a page.
    axes
        Titles of a page's axes, `axes_of` of the scene.

    Returns
    -------
    Path
        The path.

    Raises
    ------
    InputError
        For another ending.
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
    check_choice("save", path.suffix, formats)
