"""A device, its workspace and the field in it, as one PyVista scene."""

from typing import Final

import numpy as np
import pyvista as pv
from numpy.typing import ArrayLike
from vtkmodules.vtkRenderingCore import vtkBillboardTextActor3D

from fieldmap.device.model import Device, Workspace
from fieldmap.device.payload import Magnet, Payload, SoftBody
from fieldmap.field import (
    AnyField,
    Bounds,
    Currents,
    FieldAtCurrents,
    as_field,
    coil_currents,
    require_bounds,
)
from fieldmap.plot import solids
from fieldmap.plot.places import MM, box_grid, grid_points, plane_grids, plane_of
from fieldmap.plot.rendering import new_scene
from fieldmap.plot.scales import add_coloured, add_rulers, colour_bar
from fieldmap.plot.style import INK
from fieldmap.typing import Array

IRON = "#c5ccd3"
COPPER = "#e08a4e"
CURRENT = "#ffd34d"
MAGNET = "#e0402f"
SENSOR = "#2b9d5a"
# Not |B|: the text renderer takes | for a column break.
FLUX: Final = "B, mT"
NAME_SIZE = 30
VIEW: Final = (0.42, -1.0, 0.27)
"""Direction towards the viewer, who stands in front (-y), a little to the right and above."""
# Opacity of a solid in front of the workspace, and the share of the workspace that a solid must hide for it.
_TRANSLUCENT, _HIDDEN = 0.25, 0.1
# Length of the arrow of a field sensor, as a share of the largest length of the machine.
_SENSOR_LENGTH = 0.09
# Shortest arrow of a moment, as a share of the shortest side of the workspace: the arrow shows where a small bead is.
_MOMENT_LENGTH = 0.4
# Arrows of B along a slice, their length over their distance, and how far before it they lie, mm.
_ARROWS, _ARROW_LENGTH, _BEFORE = 7, 0.62, 0.3


def device_scene(
    device: Device,
    field: AnyField | None = None,
    currents: Currents | None = None,
    magnet_at: ArrayLike | None = None,
    hide: tuple[str, ...] = (),
    axes: bool = True,
    plotter: pv.Plotter | None = None,
    window_size: tuple[int, int] = (1200, 1200),
    iron_opacity: float = 1.0,
    coil_opacity: float = 1.0,
    names: bool = True,
    directions: bool = True,
) -> pv.Plotter:
    """Draw coils with their names and the sense of their current, iron, field sensors as arrows along their axes, the
    workspace box and, if given, B on slices of a field, as colour and direction. Solids between the viewer and the
    workspace are translucent.

    Parameters
    ----------
    device
        The device; lengths in the scene are millimetres.
    field
        Any field with a box.
    currents
        (n_coils,), A, 1 A each unless given; arrows point as they flow, coils without current have none.
    magnet_at
        (3,), m, where the payload's magnet is drawn.
    hide
        Names of bodies to leave out.
    axes
        Whether there are rulers, in mm.
    plotter
        Plotter to draw into; by default a new one, off-screen.
    window_size
        Of a new plotter, pixels.
    iron_opacity, coil_opacity
        1 for solid, 0 for invisible.
    names
        Whether coils are named; names on the far side are hidden behind the coils in front.
    directions
        Whether arrows on the slices show the direction of B.

    Returns
    -------
    pv.Plotter
        The plotter: `.screenshot("device.png")` saves it, `.show()` looks at it.

    Raises
    ------
    FieldmapError
        On a machine without OpenGL.

    Examples
    --------
    >>> device = fieldmap.read_device("drive_unit")                               # doctest: +SKIP
    >>> device_scene(device).screenshot("drive_unit.png")                         # doctest: +SKIP
    """
    scene = plotter if plotter is not None else new_scene(window_size)
    for body in device.bodies:
        if body.name not in hide:
            surface = solids.body_surface(device, body)
            _add_solid(scene, surface, IRON, _seen_through(surface, device.workspace, iron_opacity))
    of = device.coil_names if field is None else as_field(field).coil_names
    flowing = coil_currents(1.0 if currents is None else currents, of)
    by_name = dict(zip(of, flowing, strict=True))
    for coil in device.coils:
        # A map may have other coils than the device that is drawn with it.
        ampere = by_name.get(coil.name, 1.0)
        surface = solids.winding_surface(coil)
        _add_solid(scene, surface, COPPER, _seen_through(surface, device.workspace, coil_opacity))
        if ampere:
            arrow = solids.current_arrow(coil, sense=float(ampere))
            scene.add_mesh(arrow, color=CURRENT, ambient=0.4, smooth_shading=True)
    if device.sensors:
        length = _SENSOR_LENGTH * float(np.ptp(solids.extent(scene), axis=1).max())
        for sensor in device.sensors:
            scene.add_mesh(
                solids.sensor_arrow(sensor, length), color=SENSOR, ambient=0.4, smooth_shading=True
            )
    if device.workspace is not None:
        outline = solids.workspace_outline(device.workspace)
        scene.add_mesh(outline, color=INK, line_width=2.5, lighting=False)
    if field is not None:
        source = as_field(field)
        box = require_bounds(source)
        planes = plane_grids(box, points=81, floor=False)
        for plane in planes:
            plane[FLUX] = MM * np.linalg.norm(source.field(grid_points(plane, box), flowing), axis=1)
        add_planes(scene, planes, FLUX)
        if directions:
            add_directions(scene, source.at(flowing), box)
    if names:
        _add_names(scene, device)
    if magnet_at is not None and device.payload is not None:
        space = (
            0.0 if device.workspace is None else MM * float(np.subtract(*device.workspace.bounds[::-1]).min())
        )
        place = MM * np.asarray(magnet_at, dtype=float)
        add_payload(scene, device.payload, place, shortest=_MOMENT_LENGTH * space)
    if axes:
        add_rulers(scene)
    scene.enable_anti_aliasing("ssaa")
    return scene


def _seen_through(surface: pv.PolyData, space: Workspace | None, opacity: float) -> float:
    """The opacity of a solid: low if it hides much of the workspace."""
    if space is None:
        return opacity
    room = solids.extent(solids.workspace_outline(space))
    places = box_grid((room[:, 0] / MM, room[:, 1] / MM), (3, 3, 3)).points
    beyond = 10.0 * np.ptp(solids.extent(surface)) * np.array(VIEW)
    whole = surface.triangulate()
    hidden = sum(whole.ray_trace(place, place + beyond)[1].size > 0 for place in places)
    return min(opacity, _TRANSLUCENT) if hidden > _HIDDEN * len(places) else opacity


def _add_solid(scene: pv.Plotter, surface: pv.DataSet, colour: str, opacity: float = 1.0) -> None:
    scene.add_mesh(
        surface,
        color=colour,
        opacity=opacity,
        smooth_shading=True,
        split_sharp_edges=True,
        feature_angle=35.0,
        ambient=0.35,
        diffuse=0.75,
        specular=0.15,
        specular_power=25.0,
    )
    edges = solids.sharp_edges(surface)
    if edges.n_points:
        scene.add_mesh(edges, color=INK, line_width=1.5, opacity=0.55)


def _add_names(scene: pv.Plotter, device: Device) -> None:
    """Names of the coils on their windings; the windings in front hide those behind."""
    for coil in device.coils:
        # Point labels of pyvista would be drawn over everything or not at all.
        text = vtkBillboardTextActor3D()
        text.SetInput(coil.name)
        # In front of the winding and its surroundings; the parallel projection does not shift the text.
        before = 0.25 * float(np.ptp(solids.extent(solids.winding_surface(coil)), axis=1).max())
        text.SetPosition(*(solids.name_place(coil, VIEW) + before * np.array(VIEW)))
        text.GetTextProperty().SetFontSize(NAME_SIZE)
        text.GetTextProperty().SetBold(True)
        text.GetTextProperty().SetJustificationToCentered()
        text.GetTextProperty().SetVerticalJustificationToCentered()
        # Black in both schemes, because the text is on copper.
        text.GetTextProperty().SetColor(0.0, 0.0, 0.0)
        scene.add_actor(text, pickable=False, reset_camera=False)  # type: ignore[arg-type]


def add_planes(
    scene: pv.Plotter, planes: list[pv.ImageData], title: str, bar_at: tuple[float, float] | None = None
) -> list[pv.Actor]:
    """Draw the point data `title` of planes in colour, with one colour bar for all; bar_at: its lower left corner."""
    settings = colour_bar(title, np.concatenate([plane[title] for plane in planes]))
    if bar_at is not None:
        settings["scalar_bar_args"] |= {"position_x": bar_at[0], "position_y": bar_at[1]}
    look = {"lighting": False, "nan_color": "white"}
    return [
        add_coloured(scene, plane, title, settings, show_scalar_bar=plane is planes[0], **look)
        for plane in planes
    ]


def add_directions(scene: pv.Plotter, field: FieldAtCurrents, box: Bounds) -> None:
    """Arrows along B, all of one length, in front of the slices x = middle and y = middle of a box."""
    size = np.subtract(box[1], box[0])
    step = float(size.max()) / _ARROWS
    counts = np.maximum(2, np.rint(size / step)).astype(int)
    slices = [plane_of(box, normal, None, tuple(np.delete(counts, k))) for k, normal in enumerate("xy")]
    # The slices share one row of points.
    points = np.unique(np.vstack([places for places, _ in slices]).round(12), axis=0)
    before = points + 1e-3 * _BEFORE * np.sign(VIEW) * [1.0, 1.0, 0.0]
    flux = field.field(points)
    # Zero field, as without currents, gives no visible arrow.
    even = flux / np.maximum(np.linalg.norm(flux, axis=1, keepdims=True), np.finfo(float).tiny)
    scene.add_mesh(arrows_at(before, even, _ARROW_LENGTH * MM * step), color="white", lighting=False)


def arrows_at(places: Array, vectors: Array, longest: float) -> pv.PolyData:
    """Arrows about places (n, 3), m, along vectors (n, 3), the longest `longest` mm; "size": of the vectors."""
    cloud = pv.PolyData(MM * places)
    cloud["direction"], cloud["size"] = vectors, np.linalg.norm(vectors, axis=1)
    slender = pv.Arrow(start=(-0.5, 0.0, 0.0), tip_length=0.4, tip_radius=0.15, shaft_radius=0.05)
    factor = longest / (float(cloud["size"].max()) or 1.0)
    return cloud.glyph(orient="direction", scale="size", factor=factor, geom=slender)


def add_payload(scene: pv.Plotter, payload: Payload, at: Array, shortest: float = 0.0) -> None:
    """Draw the payload's magnet, or its pieces, upright about `at` (3,), mm, and the moment of each magnet as an arrow.

    The arrow starts at a face of the magnet. It is as long as the magnet's longest side, and at least `shortest`, mm.
    """
    for piece in payload.pieces:
        surface = solids.piece_surface(piece).translate(at, inplace=False)
        if isinstance(piece.shape, SoftBody):
            _add_solid(scene, surface, IRON)
            continue
        _add_solid(scene, surface, MAGNET)
        along = np.asarray(piece.placement.rotation, dtype=float)[:, 2]
        _add_moment(scene, piece.shape, at + MM * np.asarray(piece.placement.position), along, shortest)
    shape = solids.magnet_surface(payload.magnet)
    if shape is not None and payload.magnet is not None:
        _add_solid(scene, shape.translate(at, inplace=False), MAGNET)
        _add_moment(scene, payload.magnet, at, np.sign(payload.moment_vector), shortest)


def _add_moment(scene: pv.Plotter, magnet: Magnet, at: Array, along: Array, shortest: float) -> None:
    surface = solids.magnet_surface(magnet)
    assert surface is not None
    sides = np.ptp(solids.extent(surface), axis=1)
    arrow = pv.Arrow(
        start=at + 0.5 * sides[2] * along,
        direction=along,
        scale=max(float(sides.max()), shortest),
        tip_length=0.35,
        tip_radius=0.14,
        shaft_radius=0.06,
    )
    scene.add_mesh(arrow, color=MAGNET, ambient=0.4)
