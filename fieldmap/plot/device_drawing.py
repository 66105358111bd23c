"""A device, its workspace and the field in it, as one PyVista scene."""

from typing import Any, Final

import numpy as np
import pyvista as pv
from numpy.typing import ArrayLike
from vtkmodules.vtkRenderingCore import vtkBillboardTextActor3D

from fieldmap.device.model import Device, MagnetBlock, MagnetCylinder, MagnetSphere, Workspace, WorkspaceBox
from fieldmap.device.payload import Payload, PayloadPiece, SoftBody
from fieldmap.field import AnyField, Currents, Field, FieldAtCurrents, as_field, coil_currents, require_bounds
from fieldmap.plot.rendering import require_renderer
from fieldmap.plot.rulers import add_rulers, label_step
from fieldmap.plot.solids import MM, body_surface, current_arrow, name_place, placed, winding_surface
from fieldmap.plot.style import INK
from fieldmap.typing import Array

IRON = "#c5ccd3"
COPPER = "#e08a4e"
CURRENT = "#ffd34d"
MAGNET = "#e0402f"
COLOUR_MAP: Final = "viridis"
NAME_SIZE = 30
VIEW: Final = (0.42, -1.0, 0.27)
"""Towards the viewer, who stands in front (-y), a little to the right and above."""
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
    """Draw coils with their names and the sense of their current, iron, the workspace box and, if given, B on slices of
    a field, as colour and direction.

    field: any field with a box. currents (n_coils,), A, 1 A each by default: arrows point as they flow, coils without
    current have none. magnet_at (3,), m: where to draw the payload's magnet. hide: names of bodies to leave out. axes:
    rulers in mm. plotter: draw into this one; otherwise a new off-screen plotter. names: of the coils, those on the far
    side are hidden behind the others. directions: arrows of B on the slices. Lengths in the scene are millimetres.

    Returns the plotter; save with `.screenshot("device.png")`, look at it with `.show()`. Raises FieldmapError on
    a machine without OpenGL.

    Example::

        device = fieldmap.read_device("drive_unit")
        device_scene(device).screenshot("drive_unit.png")
    """
    require_renderer()
    scene = plotter if plotter is not None else pv.Plotter(off_screen=True, window_size=list(window_size))
    scene.background_color = pv.Color("white")
    for body in device.bodies:
        if body.name not in hide:
            _add_solid(scene, body_surface(device, body), IRON, iron_opacity)
    of = device.coil_names if field is None else as_field(field).coil_names
    flowing = coil_currents(1.0 if currents is None else currents, of)
    by_name = dict(zip(of, flowing, strict=True))
    for coil in device.coils:
        # A map may have been made of other coils than those of the device that is drawn with it.
        ampere = by_name.get(coil.name, 1.0)
        _add_solid(scene, winding_surface(coil), COPPER, coil_opacity)
        if ampere:
            arrow = current_arrow(coil, sense=float(ampere))
            scene.add_mesh(arrow, color=CURRENT, ambient=0.4, smooth_shading=True)
    if device.workspace is not None:
        outline = workspace_outline(device.workspace)
        scene.add_mesh(outline, color=INK, line_width=2.5, lighting=False)
    if field is not None:
        source = as_field(field)
        _add_slices(scene, source, flowing)
        if directions:
            lower, upper = require_bounds(source)
            add_directions(scene, source.at(flowing), lower, upper)
    if names and device.coils:
        _add_names(scene, device)
    if magnet_at is not None and device.payload is not None:
        add_payload(scene, device.payload, MM * np.asarray(magnet_at, dtype=float))
    if axes:
        add_rulers(scene)
    scene.enable_anti_aliasing("ssaa")
    return scene


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
    edges = surface.clean().extract_feature_edges(
        feature_angle=35.0, boundary_edges=False, non_manifold_edges=False, manifold_edges=False
    )
    if edges.n_points:
        scene.add_mesh(edges, color=INK, line_width=1.5, opacity=0.55)


def _add_names(scene: pv.Plotter, device: Device) -> None:
    """Names of the coils on their windings; the windings in front hide those behind."""
    for coil in device.coils:
        # Labels at points are drawn over everything, or nowhere.
        text = vtkBillboardTextActor3D()
        text.SetInput(coil.name)
        text.SetPosition(*name_place(coil, VIEW))
        text.GetTextProperty().SetFontSize(NAME_SIZE)
        text.GetTextProperty().SetBold(True)
        text.GetTextProperty().SetJustificationToCentered()
        text.GetTextProperty().SetVerticalJustificationToCentered()
        # On copper in both schemes.
        text.GetTextProperty().SetColor(0.0, 0.0, 0.0)
        scene.add_actor(text, pickable=False, reset_camera=False)  # type: ignore[arg-type]


def workspace_outline(space: Workspace) -> pv.PolyData:
    """Edges of the workspace, mm."""
    if isinstance(space, WorkspaceBox):
        return pv.Box(tuple(MM * np.column_stack([space.lower, space.upper]).ravel())).extract_all_edges()
    return pv.Cylinder(
        center=MM * (space.base + np.array([0.0, 0.0, space.height / 2])),
        direction=(0, 0, 1),
        radius=MM * space.radius,
        height=MM * space.height,
        resolution=64,
    ).extract_feature_edges(feature_angle=35.0)


def _add_slices(scene: pv.Plotter, field: Field, currents: Array) -> None:
    """|B| in mT on the planes x = middle and y = middle of the map's box."""
    slices = slice_planes(field, currents)
    values = np.concatenate([plane["|B|"] for plane in slices])
    step = label_step(float(np.ptp(values)))
    limits = (step * np.floor(values.min() / step), step * np.ceil(values.max() / step))
    bar: Any = _SCALAR_BAR | {"n_labels": int(np.rint((limits[1] - limits[0]) / step)) + 1}
    for plane in slices:
        scene.add_mesh(
            plane,
            scalars="|B|",
            cmap=COLOUR_MAP,
            clim=limits,
            lighting=False,
            show_scalar_bar=plane is slices[0],
            scalar_bar_args=bar,
        )


def add_directions(scene: pv.Plotter, field: FieldAtCurrents, lower: Array, upper: Array) -> None:
    """Arrows along B, all of one length, before the slices x = middle and y = middle of a box with corners (3,), m."""
    middle, size = 0.5 * (lower + upper), upper - lower
    step = float(size.max()) / _ARROWS
    places = []
    for axis in (0, 1):
        counts = np.maximum(2, np.rint(size / step)).astype(int)
        ticks = [
            low + (np.arange(n) + 0.5) / n * span for low, n, span in zip(lower, counts, size, strict=True)
        ]
        ticks[axis] = middle[axis : axis + 1]
        places.append(np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 3))
    # One row stands where the slices cross: once is enough.
    points = np.unique(np.vstack(places).round(12), axis=0)
    cloud = pv.PolyData(MM * points + _BEFORE * np.sign(VIEW) * [1.0, 1.0, 0.0])
    cloud["direction"] = field.field(points)
    slender = pv.Arrow(start=(-0.5, 0.0, 0.0), tip_length=0.4, tip_radius=0.14, shaft_radius=0.045)
    arrows = cloud.glyph(orient="direction", scale=False, factor=_ARROW_LENGTH * MM * step, geom=slender)
    scene.add_mesh(arrows, color="white", lighting=False, show_scalar_bar=False)


_SCALAR_BAR: dict[str, Any] = {
    # Not |B|: the text renderer takes | for a column break.
    "title": "B, mT",
    "vertical": True,
    "height": 0.45,
    "width": 0.06,
    "position_x": 0.86,
    "position_y": 0.08,
    "fmt": "%.1f",
    "color": INK,
    "title_font_size": 30,
    "label_font_size": 26,
}


def slice_planes(field: AnyField, currents: Array, points: int = 81) -> list[pv.StructuredGrid]:
    """Planes x = middle and y = middle of the field's box, in mm, with |B| in mT as point data "|B|"."""
    source = as_field(field)
    lower, upper = require_bounds(source)
    inset = 1e-9 * (upper - lower)
    x, y, z = (np.linspace(a, b, points) for a, b in zip(lower + inset, upper - inset, strict=True))
    middle = 0.5 * (lower + upper)
    planes = []
    for across in ((x, np.array([middle[1]])), (np.array([middle[0]]), y)):
        mesh = np.meshgrid(*across, z, indexing="ij")
        at = np.stack([axis.ravel() for axis in mesh], axis=1)
        grid = pv.StructuredGrid(*(MM * axis for axis in mesh))
        strength = MM * np.linalg.norm(source.field(at, currents), axis=1)
        # VTK counts points with the first index fastest.
        grid["|B|"] = strength.reshape(mesh[0].shape).ravel(order="F")
        planes.append(grid)
    return planes


def add_payload(scene: pv.Plotter, payload: Payload, at: Array) -> None:
    """The payload's magnet with its centre at (3,), mm, and an arrow along its moment; or its pieces, upright."""
    for piece in payload.pieces:
        surface = _placed_surface(piece).translate(at, inplace=False)
        _add_solid(scene, surface, IRON if isinstance(piece.shape, SoftBody) else MAGNET)
    shape = magnet_surface(payload.magnet)
    if shape is None:
        return
    half = 0.5 * (shape.bounds[5] - shape.bounds[4])
    _add_solid(scene, shape.translate(at, inplace=False), MAGNET)
    arrow = pv.Arrow(
        start=at + np.array([0.0, 0.0, half]), direction=(0, 0, 1), scale=2.0 * half, shaft_radius=0.06
    )
    scene.add_mesh(arrow, color=MAGNET)


def payload_surface(payload: Payload) -> pv.PolyData | None:
    """A payload's magnet, or all of its pieces, about its centre, upright, mm; None of a mere moment."""
    if not payload.pieces:
        return magnet_surface(payload.magnet)
    return pv.merge([_placed_surface(piece) for piece in payload.pieces]).extract_surface(algorithm=None)


def _placed_surface(piece: PayloadPiece) -> pv.PolyData:
    shape = piece.shape
    if isinstance(shape, SoftBody):
        x, y, z = (MM * axis / 2 for axis in shape.axes)
        surface = pv.Sphere(radius=1.0)
        surface.scale((x, y, z), inplace=True)
        return placed(surface, piece.placement)
    magnet = magnet_surface(shape)
    assert magnet is not None
    return placed(magnet, piece.placement)


def magnet_surface(magnet: Any) -> pv.PolyData | None:
    """A payload's magnet about the origin, upright, mm; None where there is none."""
    match magnet:
        case MagnetCylinder(diameter, height):
            return pv.Cylinder(
                direction=(0, 0, 1), radius=MM * diameter / 2, height=MM * height, resolution=64
            )
        case MagnetSphere(diameter):
            return pv.Sphere(radius=MM * diameter / 2)
        case MagnetBlock(size):
            x, y, z = (MM * edge / 2 for edge in size)
            return pv.Box((-x, x, -y, y, -z, z))
    return None
