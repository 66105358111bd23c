"""A device, its workspace and the field in it, as one PyVista scene."""

from typing import Any, Final

import numpy as np
import pyvista as pv
from numpy.typing import ArrayLike

from fieldmap.device.model import Device, MagnetBlock, MagnetCylinder, MagnetSphere, Workspace, WorkspaceBox
from fieldmap.device.payload import Payload, PayloadPiece, SoftBody
from fieldmap.field import AnyField, Currents, Field, as_field, coil_currents, require_bounds
from fieldmap.plot.rendering import require_renderer
from fieldmap.plot.rulers import INK, add_rulers, label_step
from fieldmap.plot.solids import MM, body_surface, current_arrow, winding_surface
from fieldmap.typing import Array

IRON = "#c5ccd3"
COPPER = "#e08a4e"
CURRENT = "#ffd34d"
MAGNET = "#e0402f"
COLOUR_MAP: Final = "viridis"


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
) -> pv.Plotter:
    """Draw coils with the sense of their current, iron, the workspace box and, if given, |B| on slices of a field.

    field: any field with a box, drawn at currents (n_coils,) in A, 1 A each by default. magnet_at (3,), m: where to
    draw the payload's magnet. hide: names of bodies to leave out. axes: rulers in mm. plotter: draw into this
    one; otherwise a new off-screen plotter. Lengths in the scene are millimetres.

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
    for coil in device.coils:
        _add_solid(scene, winding_surface(coil), COPPER)
        scene.add_mesh(current_arrow(coil), color=CURRENT, ambient=0.4, smooth_shading=True)
    if device.workspace is not None:
        outline = workspace_outline(device.workspace)
        scene.add_mesh(outline, color=INK, line_width=2.5, lighting=False)
    if field is not None:
        source = as_field(field)
        _add_slices(scene, source, coil_currents(1.0 if currents is None else currents, source.coil_names))
    if magnet_at is not None and device.payload is not None:
        add_payload(scene, device.payload, MM * np.asarray(magnet_at, dtype=float))
    if axes:
        add_rulers(scene)
    scene.enable_anti_aliasing("ssaa")
    return scene


def _add_solid(scene: pv.Plotter, surface: pv.PolyData, colour: str, opacity: float = 1.0) -> None:
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
    shape, place = piece.shape, np.eye(4)
    place[:3, :3], place[:3, 3] = piece.placement.rotation, MM * np.asarray(piece.placement.position)
    if isinstance(shape, SoftBody):
        x, y, z = (MM * axis / 2 for axis in shape.axes)
        return pv.Sphere(radius=1.0).scale((x, y, z), inplace=False).transform(place, inplace=False)
    surface = magnet_surface(shape)
    assert surface is not None
    return surface.transform(place, inplace=False)


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
