"""Scenes by name, and their files: what `fieldmap show` draws."""

import html
import io
import json
import re
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pyvista as pv

from fieldmap.arguments import check_choice, raise_all
from fieldmap.device.payload import Magnet, shape_text
from fieldmap.extras import require
from fieldmap.plot import field_scenes, forces
from fieldmap.plot.animation import add_path
from fieldmap.plot.device_drawing import device_scene
from fieldmap.plot.picture import FROM_ABOVE, look_at
from fieldmap.plot.rendering import new_scene
from fieldmap.plot.scales import AS_THEY_ARE, MILLIMETRES, add_rulers, add_words
from fieldmap.plot.shown import Shown
from fieldmap.plot.solids import box_edges, extent, payload_surface
from fieldmap.plot.style import INK, save_screenshot
from fieldmap.records import Record
from fieldmap.store.output_formats import output_problems
from fieldmap.store.whole_files import write_whole
from fieldmap.typing import PathLike

WINDOW = (1500, 1200)
FORMATS = (".png", ".html", ".vtm")
MOVIES = (".gif", ".mp4")
Axes: TypeAlias = tuple[tuple[str, str, str], Sequence[float]]
"""Titles of three axes, and the factor by which each axis is stretched."""


def _device(scene: pv.Plotter, shown: Shown, _: str) -> None:
    assert shown.device is not None
    device_scene(shown.device, magnet_at=shown.payload_at, axes=False, plotter=scene)


def _payload_in_words(shown: Shown) -> str:
    """Where a picture of a device shows the payload, and what its arrows mean; empty where it shows none."""
    payload = None if shown.device is None else shown.device.payload
    if payload is None or shown.payload_at is None or payload_surface(payload) is None:
        return ""
    shapes = [piece.shape for piece in payload.pieces]
    if payload.magnet is not None:
        shapes.append(payload.magnet)
    what = "payload" if len(shapes) > 1 else shape_text(shapes[0])
    where = "in balance" if shown.equilibrium is not None else "in the middle of the workspace"
    magnets = sum(isinstance(shape, Magnet) for shape in shapes)
    return f"{what} {where}{('', '; red arrow: its moment', '; red arrows: moments of its magnets')[min(magnets, 2)]}"


def _lines(scene: pv.Plotter, shown: Shown, _: str) -> None:
    if shown.everywhere and shown.device is not None:
        look: dict[str, Any] = {"iron_opacity": 0.3, "coil_opacity": 0.3, "names": False}
        device_scene(shown.device, None, shown.currents, axes=False, plotter=scene, **look)
    field_scenes.add_field_lines(scene, shown, _)


@dataclass(frozen=True, repr=False)
class Scene(Record):
    """A scene: the function that draws it, and the fields of `Shown` that it needs.

    quantities: it shows one of these, the first by default. legend: what arrows and lines mean for the first quantity,
    or what says so of what is shown.
    boxed: whether the edges of the field's box are drawn.
    """

    draw: Callable[[pv.Plotter, Shown, str], None]
    needs: tuple[str, ...]
    legend: str | Callable[[Shown], str] = ""
    quantities: tuple[str, ...] = tuple(field_scenes.QUANTITIES)
    boxed: bool = True


_ARROWS_OF_FORCE = "arrows: force on the magnet, whose centre lies in their middle"
_IN_BALANCE = "red: the magnet in balance; arrows: magnetic force and weight together"
_PATH = "red: outline of the magnet at the end; black: the path that was asked for"
_FIELD = ("field", "lower")
SCENES: dict[str, Scene] = {
    "device": Scene(_device, ("device",), _payload_in_words, boxed=False),
    "mesh": Scene(field_scenes.add_mesh, ("mesh",), boxed=False),
    "iron": Scene(field_scenes.add_iron_field, ("mesh",), boxed=False),
    "lines": Scene(_lines, _FIELD),
    "slices": Scene(field_scenes.add_slices, _FIELD, "arrows: direction of B"),
    "surfaces": Scene(field_scenes.add_surfaces, _FIELD),
    "forces": Scene(forces.add_forces, (*_FIELD, "payload"), _ARROWS_OF_FORCE),
    "equilibrium": Scene(forces.add_equilibrium, (*_FIELD, "payload", "equilibrium"), _IN_BALANCE),
    "difference": Scene(field_scenes.add_difference, _FIELD),
    "shift": Scene(forces.add_shift, ("surface",), quantities=tuple(forces.COORDINATES), boxed=False),
    "reachable": Scene(forces.add_reachable, ("reachable",), quantities=forces.KINDS, boxed=False),
    "path": Scene(add_path, ("run",), _PATH),
}
"""All scenes by name."""


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
        Contents of the scene.
    what
        One of SCENES.
    quantity
        One of the quantities of the scene; by default the first.
    off_screen
        Whether to draw without a window.
    window
        Size of the picture, pixels.

    Returns
    -------
    pv.Plotter
        The plotter: `.show()` looks at it, `save_scene` writes it.

    Raises
    ------
    InputError
        For unknown names, and if `shown` lacks something that the scene needs.
    FieldmapError
        On a machine without OpenGL.
    """
    chosen, asked = check_scene(what, quantity), SCENES[what]
    scene = new_scene(window, off_screen)
    shown.need(*asked.needs)
    asked.draw(scene, shown, chosen)
    if asked.boxed and shown.lower is not None and shown.upper is not None:
        scene.add_mesh(box_edges(shown.box), color=INK, line_width=2.5, lighting=False)
    titles, stretch = axes_of(what, chosen, shown)
    add_rulers(scene, titles=titles, stretch=stretch)
    if what == "shift":
        look_at(scene, extent(scene), margin=0.4, view=FROM_ABOVE)
    else:
        look_at(scene, extent(scene), margin=0.3)
    add_words(scene, scene_words(what, chosen, shown), (0.02, 0.985))
    scene.enable_anti_aliasing("ssaa")
    return scene


def drawn_ranges(scene: pv.Plotter) -> dict[str, list[float]]:
    """Smallest and largest value of each quantity shown as colour, by its title with unit."""
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
    """The quantity that a scene draws. Raises InputError for an unknown scene or quantity."""
    known = SCENES[check_choice("what", what, SCENES)].quantities
    return check_choice("quantity", quantity or known[0], known)


def scene_words(what: str, quantity: str, shown: Shown) -> str:
    """Title of what is shown, and below it what arrows and lines of the scene mean."""
    asked = SCENES[what]
    legend = asked.legend(shown) if callable(asked.legend) else asked.legend
    return f"{shown.title}\n{legend if quantity in ('', asked.quantities[0]) else ''}".rstrip()


def axes_of(what: str, quantity: str, shown: Shown) -> Axes:
    """Axes of a scene; for "reachable" they depend on the set."""
    if what == "reachable" and shown.reachable is not None:
        return forces.reachable_axes(shown.reachable)
    return (forces.shift_titles(quantity or "x") if what == "shift" else MILLIMETRES), AS_THEY_ARE


def save_scene(
    scene: pv.Plotter, path: PathLike, title: str = "", axes: Axes = (MILLIMETRES, AS_THEY_ARE)
) -> Path:
    """Save a scene.

    Parameters
    ----------
    scene
        A scene of `make_scene`.
    path
        Ends in .png (a picture), .html (a page that turns the scene in a browser) or .vtm (for ParaView).
    title
        Title of the page (.html), of one or several lines.
    axes
        Of the page (.html), from `axes_of`.

    Returns
    -------
    Path
        The path.

    Raises
    ------
    InputError
        For any other ending.
    """
    target = Path(path)
    check_format(target)
    if target.suffix == ".png":
        save_screenshot(scene, target)
    elif target.suffix == ".html":
        save_web_page(scene, target, title, axes)
    else:
        datasets = [actor.mapper.dataset for actor in scene.actors.values() if isinstance(actor, pv.Actor)]
        raise_all(output_problems(str(target), target, ["ParaView scene"]))
        target.parent.mkdir(parents=True, exist_ok=True)
        # Not written under a temporary name, because the folder of the pieces has the name of the file.
        pv.MultiBlock(datasets).save(target)
    return target


def check_format(path: Path, formats: tuple[str, ...] = FORMATS) -> None:
    """Raise InputError unless the ending is one of `formats`."""
    check_choice("save", path.suffix, formats)


# The viewer clears the body of the page, so the style sheet adds the words after the body.
_HEAD = """<title>{title}</title><style>body::after {{ content: "{words}"; white-space: pre; position: fixed;
left: 1em; top: .6em; z-index: 99; color: #22282e; font: 15px system-ui, sans-serif; pointer-events: none; }}"""
_HOW = "drag: turn; wheel: zoom; shift and drag: move"


def save_web_page(
    scene: pv.Plotter, path: PathLike, title: str = "", axes: Axes = (MILLIMETRES, AS_THEY_ARE)
) -> Path:
    """Write the scene to an HTML file of some MB, with lines of text and titles of its axes.

    The viewer cannot show the labels of the rulers, so the viewer's own axes are added. Numbers on a stretched axis are
    multiplied by its factor. Raises FieldmapError if trame-vtk is not installed.
    """
    require("trame_vtk", "web", "fieldmap.plot.save_web_page", "save a .png")
    from trame_vtk.modules.vtk import serializers
    from trame_vtk.tools.vtksz2html import write_html

    x, y, z = (words if times == 1.0 else f"{times:g} {words}" for words, times in zip(*axes, strict=True))
    scene.renderer.show_bounds(xtitle=x, ytitle=y, ztitle=z, color=INK, font_size=10)
    # The viewer has no parallel projection.
    scene.camera.parallel_projection = False
    scene.renderer.reset_camera()
    scene.render()
    packed, page = io.BytesIO(), io.StringIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("index.json", json.dumps(_description(scene, serializers)))
    write_html(packed.getvalue(), page)
    quoted = title.replace("\\", "").replace('"', "'").replace("<", " ").replace("\n", "\\A ")
    head = _HEAD.format(title=html.escape(title), words=f"{quoted}\\A {_HOW}")
    # Replaces the viewer's own title.
    content = re.sub("<title>.*?</title>\\s*<style>", lambda _: head, page.getvalue(), count=1)
    return write_whole(path, content, "web page")


def _description(scene: pv.Plotter, tools: Any) -> dict[str, Any]:
    """Data for the viewer: the scene as JSON, and the arrays by the hashes in it."""
    tools.initialize_serializers()
    context = tools.SynchronizationContext()
    context.set_ignore_last_dependencies(True)
    window = scene.render_window
    described = tools.serialize(None, window, tools.reference_id(window), context, 1)
    camera = scene.renderer.GetActiveCamera()
    described["extra"] = {
        "vtkRefId": tools.reference_id(window),
        "centerOfRotation": camera.GetFocalPoint(),
        "camera": tools.reference_id(camera),
    }
    arrays = {
        entry["hash"]: entry | {"content": context.get_cached_data_array(entry["hash"], False)}
        for entry in tools.extract_array_hash(described)
    }
    return {"hashes": arrays, "scene": described}
