"""Outlines of a machine as triangles, and as a small SVG picture for notebooks, without a plotting library."""

import math
from dataclasses import dataclass
from types import ModuleType

import numpy as np

from fieldmap.device.air_sources import AirSource
from fieldmap.device.coils import Coil
from fieldmap.device.parts import Body, Part
from fieldmap.device.shapes.base import ROUND
from fieldmap.device.shapes.turned import Sphere
from fieldmap.errors import MissingExtraError
from fieldmap.extras import require
from fieldmap.records import Record
from fieldmap.typing import Array, Index

_SIZE = 220.0
_MARGIN = 6.0
_IRON, _COPPER = "#9aa5b1", "#d08b5b"


def small_picture(bodies: tuple[Body, ...], coils: tuple[Coil, ...]) -> str:
    """SVG picture of bodies and windings in the x-y and x-z planes, to one scale; "" if there is nothing to draw, or if
    scipy, which finds the outlines, is not installed.

    Outlines are convex: bores and notches do not show. Bodies from STEP and mesh files are left out.
    """
    things = [(_IRON, points) for body in bodies for points in map(part_points, body.parts) if len(points)]
    things += [(_COPPER, winding_outline(coil).points) for coil in coils]
    try:
        return _two_views(things) if things else ""
    except MissingExtraError:
        return ""


def _two_views(things: list[tuple[str, Array]]) -> str:
    every = np.concatenate([points for _, points in things])
    lower, upper = every.min(axis=0), every.max(axis=0)
    scale = (_SIZE - 2 * _MARGIN) / max(float((upper - lower).max()), 1e-9)
    views = []
    for number, (across, up) in enumerate(((0, 1), (0, 2))):
        shapes = []
        for colour, points in things:
            flat = (points[:, [across, up]] - lower[[across, up]]) * [scale, scale]
            flat[:, 1] = (upper[up] - lower[up]) * scale - flat[:, 1]
            outline = _hull(flat) + [_MARGIN + number * _SIZE, _MARGIN]
            corners = " ".join(f"{x:.1f},{y:.1f}" for x, y in outline)
            shapes.append(
                f"<polygon points='{corners}' fill='{colour}' fill-opacity='0.5' stroke='{colour}'/>"
            )
        views.append("".join(shapes))
    size = f"width='{2 * _SIZE:.0f}' height='{_SIZE:.0f}'"
    return f"<svg xmlns='http://www.w3.org/2000/svg' {size}>{''.join(views)}</svg>"


@dataclass(frozen=True, eq=False, repr=False)
class Outline(Record):
    """Triangles (k, 3) of points (n, 3), m, that show a thing; kind: "iron", "magnet", "coil" or "map"."""

    name: str
    kind: str
    points: Array
    triangles: Index


def winding_outline(coil: Coil) -> Outline:
    """The surface of a winding; thin tubes for filaments, triangles for sheets."""
    if not coil.has_winding:
        parts = [source_outline(source) for source in coil.filaments]
        shifts = np.cumsum([0, *(len(part.points) for part in parts)])
        triangles = [part.triangles + shift for part, shift in zip(parts, shifts, strict=False)]
        points = coil.placement.to_device(np.concatenate([part.points for part in parts]))
        return Outline(coil.name, "coil", points, np.concatenate(triangles))
    path = coil.winding()
    pieces = path.outline(0.0, ROUND)
    line, normal = (np.concatenate([piece[k] for piece in pieces]) for k in range(2))
    width, height = path.thickness / 2, path.height / 2
    section = ((-width, -height), (width, -height), (width, height), (-width, height))
    rings = [np.column_stack([line + offset * normal, np.full(len(line), z)]) for offset, z in section]
    local = np.concatenate(rings)
    index = np.arange(len(local)).reshape(len(section), -1)
    beside, ahead = np.roll(index, -1, axis=0), np.roll(index, -1, axis=1)
    corner = np.roll(beside, -1, axis=1)
    halves = [
        np.stack(three, axis=-1).reshape(-1, 3) for three in ((index, ahead, corner), (index, corner, beside))
    ]
    return Outline(coil.name, "coil", coil.placement.to_device(local), np.concatenate(halves))


def source_outline(source: AirSource) -> Outline:
    """A current or magnet that magpylib has: filaments as thin tubes, sheets as triangles, magnets as convex shapes. An
    object of another class is one triangle of three equal points."""
    triangles = np.array([[0, 1, 2]])
    if source.kind == "Circle":
        points, triangles = _tube(source.diameter / 2 * _circle(3 * ROUND))  # type: ignore[operator]
    elif source.kind == "Polyline":
        points, triangles = _tube(np.asarray(source.vertices))
    elif source.kind in ("TriangleSheet", "TriangleStrip", "TriangularMesh"):
        points = np.asarray(source.vertices)
        row = np.arange(len(points) - 2)[:, None] + [0, 1, 2]
        triangles = row if source.faces is None else np.asarray(source.faces)
    else:
        points = _magnet_points(source)
        if len(points) > 3:
            triangles = _hull_triangles(points)
    kind = "coil" if source.is_current else "magnet"
    return Outline(source.kind, kind, source.placement.to_device(points), triangles)


def _magnet_points(source: AirSource) -> Array:
    if source.vertices is not None:
        return np.asarray(source.vertices)
    if source.kind == "Cuboid":
        half = np.asarray(source.dimension) / 2
        return half * [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    if source.kind == "Sphere":
        return Sphere(source.diameter / 2).hull()  # type: ignore[operator]
    if source.kind in ("Cylinder", "CylinderSegment"):
        size = np.asarray(source.dimension)
        radii = [size[0] / 2] if source.kind == "Cylinder" else size[:2]
        first, last = (0.0, 360.0) if source.angles is None else source.angles
        angles = np.radians(np.linspace(first, last, ROUND + 1))
        flat = [[r * math.cos(a), r * math.sin(a)] for r in radii for a in angles]
        return np.array([[x, y, side * size[-1] / 2] for x, y in flat for side in (-1, 1)])
    return np.zeros((3, 3))


def _circle(count: int) -> Array:
    angle = np.linspace(0.0, 2 * math.pi, count + 1)
    return np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count + 1)])


def _tube(line: Array) -> tuple[Array, Index]:
    """Prisms of three sides around the segments of a line (n, 3), a hundredth of its extent thick."""
    start, end = line[:-1], line[1:]
    along = end - start
    side = np.cross(along, np.eye(3)[np.abs(along).argmin(axis=1)])
    side *= 0.01 * np.ptp(line, axis=0).max() / np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(along / np.linalg.norm(along, axis=1, keepdims=True), side)
    ring = [math.cos(a) * side + math.sin(a) * other for a in np.radians([0.0, 120.0, 240.0])]
    points = np.stack([place + offset for place in (start, end) for offset in ring], axis=1).reshape(-1, 3)
    prism = np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [2, 0, 3], [2, 3, 5], [0, 2, 1], [3, 4, 5]])
    return points, (6 * np.arange(len(start))[:, None, None] + prism).reshape(-1, 3)


def body_outlines(bodies: tuple[Body, ...], magnets: tuple[str, ...] = ()) -> tuple[Outline, ...]:
    """Convex outlines of the parts of bodies: bores and notches do not show. Bodies from STEP and mesh files are left
    out. magnets: names of the bodies that are permanent magnets."""
    outlines = []
    for body in bodies:
        kind = "magnet" if body.name in magnets else "iron"
        for points in map(part_points, body.parts):
            if len(points):
                outlines.append(Outline(body.name, kind, points, _hull_triangles(points)))
    return tuple(outlines)


def box_outline(name: str, lower: Array, upper: Array) -> Outline:
    """The faces of an axis-parallel box."""
    corners = np.stack(np.meshgrid(*np.stack([lower, upper], axis=1), indexing="ij"), axis=-1).reshape(-1, 3)
    return Outline(name, "map", corners, _hull_triangles(corners))


def part_points(part: Part) -> Array:
    """Points (n, 3), m, with the convex hull of a part; none for a STEP or mesh file, or for a part that is cut out."""
    if part.operation != "add":
        return np.zeros((0, 3))
    return part.placement.to_device(part.shape.hull())


def _hull_triangles(points: Array) -> Index:
    triangles: Index = _spatial().ConvexHull(points).simplices.astype(np.int64)
    return triangles


def _hull(points: Array) -> Array:
    spatial = _spatial()
    try:
        corners: Array = points[spatial.ConvexHull(points).vertices]
    except spatial.QhullError:
        return points
    return corners


def _spatial() -> ModuleType:
    # Imported on use: reading a device or a map does not need scipy, whose import takes long.
    return require("scipy.spatial", "plot", "outlines")
