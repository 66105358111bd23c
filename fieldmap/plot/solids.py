"""Surfaces of a device's bodies and windings, and arrows along currents. Lengths in mm.

Bodies of simple shapes are drawn exactly, others through the iron's own mesh; a winding is swept along its path.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import ArrayLike

from fieldmap.device import model
from fieldmap.device.coils import Coil
from fieldmap.device.drawing import winding_outline
from fieldmap.device.payload import Payload, PayloadPiece, SoftBody
from fieldmap.field import Bounds
from fieldmap.plot.places import MM, pose
from fieldmap.typing import Array

SEGMENTS = 96
ARC_SEGMENTS = 24
# Share of a turn that the arrow of its current covers.
_SHARE = 0.3


def body_surface(device: model.Device, body: model.Body) -> pv.PolyData:
    """Surface of one body in the global frame, mm.

    Parts without cuts are drawn directly; a body with a cut or a STEP file is meshed first.
    """
    parts = [(_local_surface(part.shape), part.placement) for part in body.parts if part.operation == "add"]
    simple = [placed(surface, placement) for surface, placement in parts if surface is not None]
    if len(simple) == len(body.parts):
        return pv.merge(simple, merge_points=False)
    from fieldmap.iron import generate_mesh

    mesh = generate_mesh(replace(device, bodies=(replace(body, edge_size=None),)))
    tetrahedra = pv.UnstructuredGrid({pv.CellType.TETRA: mesh.tets}, MM * mesh.points)
    return tetrahedra.extract_surface(algorithm=None)


def placed(surface: pv.PolyData, placement: model.Placement) -> pv.PolyData:
    """The surface, mm, turned and moved."""
    matrix = pose(placement.rotation, MM * np.asarray(placement.position))
    moved = surface.copy()
    moved.transform(matrix, inplace=True)
    return moved


def _local_surface(shape: model.Shape) -> pv.PolyData | None:
    """The shape in its local frame, mm, or None if it is not a simple shape."""
    match shape.primitive:
        case model.Cylinder(radius, height):
            return pv.Cylinder(
                center=(0, 0, MM * height / 2),
                direction=(0, 0, 1),
                radius=MM * radius,
                height=MM * height,
                resolution=SEGMENTS,
            )
        case model.Ring(inner, outer, height):
            return _revolved([[inner, 0], [outer, 0], [outer, height], [inner, height]])
        case model.Box(size):
            x, y, z = (MM * edge for edge in size)
            return pv.Box((-x / 2, x / 2, -y / 2, y / 2, 0, z))
        case model.Sphere(radius):
            return pv.Sphere(radius=MM * radius, theta_resolution=SEGMENTS, phi_resolution=SEGMENTS)
        case model.RevolvedProfile(points):
            return _revolved(points)
        case model.ExtrudedPolygon(points, height):
            corners = np.column_stack([MM * points, np.zeros(len(points))])
            outline = pv.PolyData(corners, faces=[len(corners), *range(len(corners))]).triangulate()
            solid = outline.extrude((0, 0, MM * height), capping=True).triangulate().clean()
            # After the extrusion, the normals of sides and caps are not consistent.
            return solid.compute_normals(point_normals=False, auto_orient_normals=True)
    return None


def box_edges(box: Bounds) -> pv.PolyData:
    """The twelve edges, mm, of a box with corners in m."""
    return pv.Box(tuple(MM * np.column_stack(box).ravel())).extract_all_edges()


def workspace_outline(space: model.Workspace) -> pv.PolyData:
    """Edges of the workspace, mm."""
    if isinstance(space, model.WorkspaceBox):
        return box_edges((space.lower, space.upper))
    middle = space.base + np.array([0.0, 0.0, space.height / 2])
    return sharp_edges(upright_cylinder(space.radius, space.height).translate(MM * middle, inplace=False))


def sharp_edges(surface: pv.DataSet, angle: float = 35.0) -> pv.PolyData:
    """Edges at which a surface bends by more than an angle, degrees."""
    return surface.clean().extract_feature_edges(
        feature_angle=angle, boundary_edges=False, non_manifold_edges=False, manifold_edges=False
    )


def sensor_arrow(sensor: model.FieldSensor, length: float) -> pv.PolyData:
    """An arrow along the axis of a field sensor, with its tip at the sensitive spot; global frame. length: mm."""
    along, facets = length * sensor.direction, ARC_SEGMENTS
    return pv.Arrow(
        start=MM * np.asarray(sensor.position) - along,
        direction=along,
        scale=length,
        tip_length=0.45,
        tip_radius=0.22,
        tip_resolution=facets,
        shaft_radius=0.08,
        shaft_resolution=facets,
    )


def extent(drawn: pv.DataSet | pv.Plotter) -> Array:
    """Lower and upper end (3, 2) of a surface or of a whole scene, mm."""
    return np.array(drawn.bounds).reshape(3, 2)


def payload_surface(payload: Payload) -> pv.PolyData | None:
    """A payload's magnet, or all of its pieces, about its centre, upright, mm; None for a moment without a body."""
    if not payload.pieces:
        return magnet_surface(payload.magnet)
    return pv.merge([piece_surface(piece) for piece in payload.pieces]).extract_surface(algorithm=None)


def piece_surface(piece: PayloadPiece) -> pv.PolyData:
    """One piece of a payload at its position about the centre, upright, mm."""
    shape = piece.shape
    if isinstance(shape, SoftBody):
        surface = pv.Sphere(radius=1.0)
        surface.scale(tuple(MM * axis / 2 for axis in shape.axes), inplace=True)
        return placed(surface, piece.placement)
    magnet = magnet_surface(shape)
    assert magnet is not None
    return placed(magnet, piece.placement)


def magnet_surface(magnet: Any) -> pv.PolyData | None:
    """A payload's magnet about the origin, upright, mm; None if there is none."""
    match magnet:
        case model.MagnetCylinder(diameter, height):
            return upright_cylinder(diameter / 2, height)
        case model.MagnetSphere(diameter):
            return pv.Sphere(radius=MM * diameter / 2)
        case model.MagnetBlock(size):
            x, y, z = (MM * edge / 2 for edge in size)
            return pv.Box((-x, x, -y, y, -z, z))
    return None


def upright_cylinder(radius: float, height: float) -> pv.PolyData:
    """A cylinder about the origin, mm; radius and height in m."""
    return pv.Cylinder(direction=(0, 0, 1), radius=MM * radius, height=MM * height, resolution=SEGMENTS)


def middle_line(coil: Coil) -> tuple[Array, Array]:
    """Middle line (n, 2) of the winding in its local plane, mm, and the unit normals (n, 2) to its right.

    It runs in the sense of a positive current at polarity +1; the normals point outward.
    """
    path = coil.winding()
    if path.is_circle:
        (points, normals), *_ = path.outline(0.0, SEGMENTS + 1)
        return MM * points[:-1], normals[:-1]
    arcs = [piece for piece in path.outline(0.0, ARC_SEGMENTS + 1) if len(piece[0]) > 2]
    points, normals = (np.concatenate([piece[k] for piece in arcs]) for k in range(2))
    return MM * points, normals


def winding_surface(coil: Coil) -> pv.PolyData:
    """The winding as a solid, global frame, mm."""
    if not coil.has_winding:
        outline = winding_outline(coil)
        return pv.PolyData.from_regular_faces(MM * outline.points, outline.triangles)  # type: ignore[arg-type]
    line, normal = middle_line(coil)
    half_width, half_height = 0.5 * MM * coil.winding().thickness, 0.5 * MM * coil.height
    section = [(-half_width, -half_height), (half_width, -half_height)]
    section += [(half_width, half_height), (-half_width, half_height)]
    rings = [np.column_stack([line + offset * normal, np.full(len(line), z)]) for offset, z in section]
    return placed(_closed_tube(np.array(rings)), coil.placement)


def current_arrow(coil: Coil, sense: float = 1.0) -> pv.PolyData:
    """An arrow along a coil current on the outside of the winding, on the side that faces away from the z axis; global
    frame, mm. sense: negative for a negative current."""
    loop, outermost = _outside(coil, 0.6)
    loop = _arc_about(loop, outermost, _SHARE)
    if coil.polarity * sense < 0:
        loop = loop[::-1]
    size = 0.09 * MM * coil.height
    shaft = pv.Spline(loop).tube(radius=0.25 * size)
    ahead, facets = loop[-1] - loop[-3], ARC_SEGMENTS
    tip = pv.Cone(center=loop[-1], direction=ahead, height=2.4 * size, radius=0.8 * size, resolution=facets)
    return placed(pv.merge([shaft, tip.extract_surface(algorithm=None)], merge_points=False), coil.placement)


def name_place(coil: Coil, towards: tuple[float, float, float]) -> Array:
    """Position (3,) of the coil's name, global frame, mm: outside the winding, above the arrow, on the side of a viewer
    in the direction `towards`."""
    loop, _ = _outside(coil, 2.0)
    around = placed(pv.PolyData(loop + [0.0, 0.0, 0.28 * MM * coil.height]), coil.placement).points
    return np.asarray(around[int(np.argmax(around @ np.array(towards)))])


def _outside(coil: Coil, off: float) -> tuple[Array, int]:
    """A turn (n, 3) at a distance of `off` mm outside the winding at half its height, in the coil's frame, mm; and the
    number of its point farthest from the machine's z axis."""
    line, normal = middle_line(coil)
    gap = 0.5 * MM * coil.winding().thickness + off
    loop = np.column_stack([line + gap * normal, np.zeros(len(line))])
    outward = placed(pv.PolyData(loop), coil.placement).points[:, :2]
    return loop, int(np.argmax(np.linalg.norm(outward, axis=1)))


def _arc_about(loop: Array, middle: int, share: float) -> Array:
    """The part of a closed line (n, 3) with a share of its length, centred on point `middle`."""
    step = np.linalg.norm(np.roll(loop, -1, axis=0) - loop, axis=1)
    along = np.concatenate([[0.0], np.cumsum(step)])
    closed = np.vstack([loop, loop[:1]])
    where = along[middle] + along[-1] * share * np.linspace(-0.5, 0.5, 60)
    return np.column_stack([np.interp(where % along[-1], along, closed[:, axis]) for axis in range(3)])


def _closed_tube(rings: Array) -> pv.PolyData:
    """Surface through k rings of n points, (k, n, 3), closed around each ring and from the last to the first."""
    k, n, _ = rings.shape
    index = np.arange(k * n).reshape(k, n)
    ahead, beside = np.roll(index, -1, axis=0), np.roll(index, -1, axis=1)
    corner = np.roll(ahead, -1, axis=1)
    quads = np.stack([index, beside, corner, ahead], axis=-1).reshape(-1, 4)
    return pv.PolyData.from_regular_faces(rings.reshape(-1, 3), quads).triangulate()  # type: ignore[arg-type]


def _revolved(profile: ArrayLike) -> pv.PolyData:
    """Closed polygon `profile` (k, 2) of (r, z), m, turned about the z axis, mm."""
    angle = 2.0 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    r, z = np.hsplit(MM * np.asarray(profile), 2)
    rings = np.stack([r * np.cos(angle), r * np.sin(angle), np.broadcast_to(z, (len(z), SEGMENTS))], axis=-1)
    return _closed_tube(rings)
