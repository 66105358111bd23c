"""Closed plane paths with rounded corners, and the curves at a constant distance beside them.

Everything here is plain numbers in the unit of the caller; nothing knows the mesher.
"""

from dataclasses import dataclass

import numpy as np
from netgen import occ

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
from fieldmap.iron.geometry.shapes import (
    MILLIMETRES,
    checked_polygon,
    cylinder,
    place,
    point,
    positive,
    ring,
    segment,
)
from fieldmap.typing import Array

RELATIVE_LENGTH = 1e-9
"""Lengths below this fraction of the longest side, and turns below this angle, are rounding."""


@dataclass(frozen=True, eq=False)
class Corner:
    """A rounded corner: the arc enters at `start`, passes `middle`, leaves at `end` (each (2,)).

    The three points coincide where the radius is zero, and where the path goes straight on.
    """

    start: Array
    middle: Array
    end: Array


def rounded_outline(corners: Array, radius: float, offset: float) -> tuple[Corner, ...]:
    """The curve at distance `offset` to the left of a closed path whose corners are rounded with `radius`.

    corners (n, 2): where the straight pieces would meet, in order. The straight pieces run from one corner's
    `end` to the next one's `start`; `fieldmap.device.polygons.rounding_fault` says whether corners fit sides.
    Raises ValueError where the offset is larger than the radius on the inner side of a bend.
    """
    along, lengths, turn = _sides(corners)
    before = np.roll(along, 1, axis=0)
    slack = RELATIVE_LENGTH * lengths.max()
    return tuple(
        _rounded_corner(corners[i], before[i], along[i], float(turn[i]), radius, offset, slack)
        for i in range(len(corners))
    )


def outline_points(outline: tuple[Corner, ...]) -> Array:
    """Points (n, 2) along an outline in order: the ends and the middle of every arc, once each."""
    points = [point for corner in outline for point in (corner.start, corner.middle, corner.end)]
    slack = RELATIVE_LENGTH * max(np.ptp(points, axis=0))
    return np.array([p for i, p in enumerate(points) if np.linalg.norm(p - points[i - 1]) > slack])


def _sides(corners: Array) -> tuple[Array, Array, Array]:
    """Directions (n, 2) and lengths (n,) of the sides that leave the corners; turns (n,), left > 0."""
    along = np.roll(corners, -1, axis=0) - corners
    lengths = np.linalg.norm(along, axis=1)
    along = along / lengths[:, None]
    before = np.roll(along, 1, axis=0)
    cross = before[:, 0] * along[:, 1] - before[:, 1] * along[:, 0]
    return along, lengths, np.arctan2(cross, np.sum(before * along, axis=1))


def _rounded_corner(
    corner: Array, before: Array, after: Array, turn: float, radius: float, offset: float, slack: float
) -> Corner:
    """One corner of `rounded_outline`: directions `before` and `after`, turning angle `turn` (left > 0)."""
    left = np.array([-before[1], before[0]])
    if abs(turn) < RELATIVE_LENGTH:
        point = corner + offset * left
        return Corner(point, point, point)
    bent = np.sign(turn)
    inner = radius - bent * offset
    if inner < -slack:
        raise ValueError("half the thickness is larger than the corner radius")
    inner = max(inner, 0.0)
    centre = corner - radius * np.tan(abs(turn) / 2) * before + bent * radius * left
    towards = corner - centre
    start = centre - bent * inner * left
    end = centre - bent * inner * np.array([-after[1], after[0]])
    return Corner(start, centre + inner * towards / np.linalg.norm(towards), end)


SHORTEST_EDGE = 1e-6
"""Edges below this length, mm, are rounding and left out; ten times what the kernel takes for one point."""


def winding_solid(coil: Coil) -> occ.TopoDS_Shape:
    """The space that a coil's winding fills, in the global frame; its name is the coil's.

    Raises one of `fieldmap.iron.geometry.shapes.KERNEL_ERRORS` where the winding cannot be built.
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
