"""Parts and windings as sets of labelled segments: two are alike exactly where their sets are.

A row is (start, end, two scalars), lengths in m, and every segment is listed in both directions. An operation moves
the two points and leaves the scalars. A prism is the set of its edges; a body of revolution that of its profile's
edges, each by its two heights on the axis and its two radii; a sphere its centre and radius. A box and an extruded
rectangle are alike, a ring and a revolved rectangle too.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldmap.device.model import (
    Body,
    Box,
    CircularCoil,
    Coil,
    Cylinder,
    ExtrudedPolygon,
    PathCoil,
    Placement,
    RevolvedProfile,
    Ring,
    RoundedRectangleCoil,
    Shape,
    Sphere,
    StepFile,
)
from fieldmap.device.polygons import signed_area

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Outline:
    """kind: what must be equal word for word; rows (k, 8)."""

    kind: tuple[object, ...]
    rows: Array

    def moved(self, matrix: Array, centre: Array) -> "Outline":
        """The image under a linear map about `centre`."""
        rows = self.rows.copy()
        for part in (slice(0, 3), slice(3, 6)):
            rows[:, part] = (rows[:, part] - centre) @ matrix.T + centre
        return Outline(self.kind, rows)

    def is_like(self, other: "Outline", tolerance: float) -> bool:
        """Whether both are the same set of segments."""
        if self.kind != other.kind or len(self.rows) != len(other.rows):
            return False
        distance = np.abs(self.rows[:, None] - other.rows[None]).max(axis=2)
        # Rows of one outline lie further apart than the tolerance: nearest neighbours pair them.
        nearest = distance.argmin(axis=1)
        return bool(distance.min(axis=1).max() < tolerance and len(np.unique(nearest)) == len(nearest))


@dataclass(frozen=True, eq=False)
class Item:
    """A body or winding: kind, and runs of outlines. Within a run (parts added, or parts cut) the order is free."""

    kind: tuple[object, ...]
    runs: tuple[tuple[Outline, ...], ...]

    @property
    def points(self) -> Array:
        """All segment ends (n, 3)."""
        return np.concatenate([outline.rows[:, :3] for run in self.runs for outline in run])

    def moved(self, matrix: Array, centre: Array) -> "Item":
        """The image under a linear map about `centre`."""
        return Item(self.kind, tuple(tuple(o.moved(matrix, centre) for o in run) for run in self.runs))

    def is_like(self, other: "Item", tolerance: float) -> bool:
        """Whether both are of one kind and fill the same space, as far as their parts tell."""
        if self.kind != other.kind or [len(r) for r in self.runs] != [len(r) for r in other.runs]:
            return False
        return all(_same_set(a, b, tolerance) for a, b in zip(self.runs, other.runs, strict=True))


def _same_set(these: tuple[Outline, ...], those: tuple[Outline, ...], tolerance: float) -> bool:
    left = list(those)
    for outline in these:
        match = next((k for k, other in enumerate(left) if outline.is_like(other, tolerance)), None)
        if match is None:
            return False
        del left[match]
    return True


def body_item(body: Body, kind: tuple[object, ...]) -> Item:
    """A body's parts. `kind` holds whatever else must be equal in bodies that are alike."""
    runs: list[tuple[str, list[Outline]]] = []
    for part in body.parts:
        if not runs or runs[-1][0] != part.operation:
            runs.append((part.operation, []))
        kind_of_shape, rows = _shape_rows(part.shape)
        runs[-1][1].append(Outline(kind_of_shape, _placed(rows, part.placement)))
    operations = tuple(operation for operation, _ in runs)
    return Item((*kind, operations), tuple(tuple(outlines) for _, outlines in runs))


def coil_item(coil: Coil) -> Item:
    """A winding as a space filled with turns; the sense of the current is left out."""
    match coil:
        case CircularCoil():
            half = 0.5 * coil.height * np.array([0.0, 0.0, 1.0])
            rows = _both_ways(-half[None], half[None], coil.inner_radius, coil.outer_radius)
            kind: tuple[object, ...] = ("circular", abs(coil.turns))
        case RoundedRectangleCoil():
            x, y = coil.half_width_x, coil.half_width_y
            rows = _path_rows(np.array([[x, y], [-x, y], [-x, -y], [x, -y]]), coil)
            kind = ("path", abs(coil.turns), coil.thickness)
        case PathCoil():
            rows = _path_rows(np.asarray(coil.corners, dtype=float), coil)
            kind = ("path", abs(coil.turns), coil.thickness)
    return Item(kind, ((Outline((), _placed(rows, coil.placement)),),))


def coil_axis(coil: Coil) -> Array:
    """Direction (3,) of the moment of a positive current: an axial vector."""
    sense = np.sign(coil.turns) * coil.polarity
    if isinstance(coil, PathCoil):
        sense *= np.sign(signed_area(coil.corners.tolist()))
    return np.asarray(coil.placement.rotation, dtype=float)[:, 2] * sense


def _path_rows(corners: Array, coil: RoundedRectangleCoil | PathCoil) -> Array:
    flat = np.column_stack([corners, np.zeros(len(corners))])
    return _both_ways(flat, np.roll(flat, -1, axis=0), coil.corner_radius, coil.height)


def _shape_rows(shape: Shape) -> tuple[tuple[object, ...], Array]:
    match shape:
        case Cylinder(radius, height):
            return ("turned",), _turned(np.array([[0, 0], [radius, 0], [radius, height], [0, height]]))
        case Ring(inner, outer, height):
            return ("turned",), _turned(np.array([[inner, 0], [outer, 0], [outer, height], [inner, height]]))
        case RevolvedProfile(points):
            return ("turned",), _turned(np.asarray(points, dtype=float))
        case Box((x, y, z)):
            outline = np.array([[-x, -y], [x, -y], [x, y], [-x, y]]) / 2
            return ("prism",), _prism(outline, z)
        case ExtrudedPolygon(points, height):
            return ("prism",), _prism(np.asarray(points, dtype=float), height)
        case Sphere(radius):
            return ("sphere",), np.array([[0.0] * 6 + [radius, 0.0]])
        case StepFile(path, scale):
            # The solid's own symmetry is not looked at: a frame of three labelled points has none.
            rows = np.zeros((4, 8))
            rows[1:, :3] = np.eye(3) * 0.1
            rows[:, 6] = np.arange(4)
            return ("step", str(path), scale), rows


def _both_ways(start: Array, end: Array, *scalars: float | Array) -> Array:
    forth = np.column_stack([start, end, *(np.broadcast_to(s, len(start)) for s in scalars)])
    back = np.column_stack([end, start, *(np.broadcast_to(s, len(start)) for s in scalars)])
    return np.unique(np.concatenate([forth, back]), axis=0)


def _prism(outline: Array, height: float) -> Array:
    low = np.column_stack([outline, np.zeros(len(outline))])
    high = low + [0.0, 0.0, height]
    start = np.concatenate([low, high, low])
    end = np.concatenate([np.roll(low, -1, axis=0), np.roll(high, -1, axis=0), high])
    return _both_ways(start, end, 0.0, 0.0)


def _turned(profile: Array) -> Array:
    """Each edge of the profile as two points on the axis, with the radii as its scalars."""
    other = np.roll(profile, -1, axis=0)
    points = [np.column_stack([np.zeros((len(p), 2)), p[:, 1]]) for p in (profile, other)]
    forth = np.column_stack([*points, profile[:, 0], other[:, 0]])
    back = np.column_stack([points[1], points[0], other[:, 0], profile[:, 0]])
    return np.unique(np.concatenate([forth, back]), axis=0)


def _placed(rows: Array, placement: Placement) -> Array:
    out = rows.copy()
    rotation = np.asarray(placement.rotation, dtype=float)
    for part in (slice(0, 3), slice(3, 6)):
        out[:, part] = rows[:, part] @ rotation.T + placement.position
    return out
