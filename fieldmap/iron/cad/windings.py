"""Windings and workspaces as solids of the CAD kernel, to hold them against the iron and each other (mm)."""

import numpy as np
from netgen import occ
from numpy.typing import NDArray

from fieldmap.device.model import (
    CircularCoil,
    Coil,
    PathCoil,
    Placement,
    RoundedRectangleCoil,
    WorkspaceBox,
    WorkspaceCylinder,
)
from fieldmap.device.polygons import polygon_fault, rounding_fault
from fieldmap.iron.cad.rounded_outline import Corner, outline_points, rounded_outline
from fieldmap.iron.cad.shapes import (
    MILLIMETRES,
    checked_polygon,
    cylinder,
    place,
    point,
    positive,
    ring,
    segment,
)

Array = NDArray[np.float64]

SHORTEST_EDGE = 1e-6
"""Edges below this length, mm, are rounding and left out; ten times what the kernel takes for one point."""


def winding_solid(coil: Coil) -> occ.TopoDS_Shape:
    """The space that a coil's winding fills, in the global frame; its name is the coil's.

    Raises one of `fieldmap.iron.cad.shapes.KERNEL_ERRORS` where the winding cannot be built.
    """
    match coil:
        case CircularCoil():
            low = -coil.height / 2
            solid = ring(coil.inner_radius, coil.outer_radius, low, coil.height)
        case RoundedRectangleCoil():
            solid = _wound_path(_rectangle(coil), coil.corner_radius, coil.thickness, coil.height)
        case PathCoil():
            solid = _wound_path(coil.corners, coil.corner_radius, coil.thickness, coil.height)
    solid = place(solid, coil.placement)
    for piece in solid.solids:
        piece.name = coil.name
    return solid


def workspace_solid(workspace: WorkspaceBox | WorkspaceCylinder) -> occ.TopoDS_Shape:
    """The workspace as a solid. Raises ValueError where it is empty."""
    if isinstance(workspace, WorkspaceBox):
        lower = np.asarray(workspace.lower, dtype=float) * MILLIMETRES
        upper = lower + positive(extent=np.asarray(workspace.upper, dtype=float) - workspace.lower)
        return occ.Box(point(*lower), point(*upper))
    return place(cylinder(workspace.radius, 0.0, workspace.height), Placement(position=workspace.base))


def _rectangle(coil: RoundedRectangleCoil) -> Array:
    """Corners (4, 2) of the middle line before rounding, counter-clockwise, m."""
    x, y = coil.half_width_x, coil.half_width_y
    return np.array([[x, -y], [x, y], [-x, y], [-x, -y]])


def _outline_face(outline: tuple[Corner, ...], height: float) -> occ.TopoDS_Shape:
    """Plane face at z = `height` inside a closed curve of arcs and straight pieces, mm."""

    def lift(flat: Array) -> Array:
        return np.append(flat, height)

    edges = []
    for i, corner in enumerate(outline):
        previous = outline[i - 1].end
        if np.linalg.norm(corner.start - previous) > SHORTEST_EDGE:
            edges.append(segment(lift(previous), lift(corner.start)))
        if np.linalg.norm(corner.end - corner.start) > SHORTEST_EDGE:
            arc = (point(*lift(p)) for p in (corner.start, corner.middle, corner.end))
            edges.append(occ.ArcOfCircle(*arc))
    return occ.Face(occ.Wire(edges))


def _wound_path(corners: Array, radius: float, thickness: float, height: float) -> occ.TopoDS_Shape:
    path = checked_polygon(corners, "the winding's middle line")
    r, t, h = positive(corner_radius=radius, thickness=thickness, height=height)
    fault = rounding_fault(path.tolist(), float(r))
    if fault is not None:
        raise ValueError(f"the winding's corners must fit its sides: {fault}")
    outer, inner = (_clear_outline(path, float(r), side * t / 2) for side in (-1.0, 1.0))
    up = occ.Vec(0.0, 0.0, float(h))
    return occ.Prism(_outline_face(outer, -h / 2), up) - occ.Prism(_outline_face(inner, -h / 2), up)


def _clear_outline(path: Array, radius: float, offset: float) -> tuple[Corner, ...]:
    """The outline beside a path. Raises ValueError where it meets itself: the turns run into each other."""
    outline = rounded_outline(path, radius, offset)
    if polygon_fault(outline_points(outline).tolist()) is not None:
        raise ValueError("the winding is so thick that its turns run into each other")
    return outline
