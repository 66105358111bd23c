"""Straight panels on the outlines of bodies and walls, and triangles inside the iron."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, cKDTree

from fieldmap.errors import GeometryError
from fieldmap.planar.conductors import complex_points
from fieldmap.planar.geometry import distance_to_edges, inside
from fieldmap.planar.model import PlanarDevice
from fieldmap.records import Record
from fieldmap.typing import Array

Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]
GRADING = 3
_SAME = 1e-9
"""Points closer than this share of the device's extent are one."""


@dataclass(frozen=True, eq=False, repr=False)
class Outline(Record):
    """Panels of the iron and of the walls.

    nodes (n,): end points of the iron's panels; bodies: for each body its panels as node pairs (m, 2), iron on the
    left. outside (m, 2): panels between iron and air, air on the left. wall (k,): end points of the walls' panels in
    order, counter-clockwise, empty in open space. extent: diagonal of everything, m.
    """

    nodes: Complex
    bodies: tuple[Indices, ...]
    outside: Indices
    wall: Complex
    extent: float


def make_outline(device: PlanarDevice, size: float, grading: int = GRADING) -> Outline:
    """Panels no longer than `size`, m, graded towards corners; with grading 1 they are equal.

    Edges along which two bodies touch have the same panels on both sides.
    """
    polygons = [complex_points(body.corners) for body in device.bodies]
    wall = np.empty(0, dtype=complex) if device.walls is None else complex_points(device.walls)
    everything = np.concatenate([*polygons, wall])
    extent = float(np.hypot(np.ptp(everything.real), np.ptp(everything.imag))) if len(everything) else 1.0
    corners = np.concatenate(polygons) if polygons else np.empty(0, dtype=complex)
    register = _Register(_SAME * extent)
    bodies = tuple(_panels(polygon, corners, size, grading, register) for polygon in polygons)
    nodes = np.array(register.points, dtype=complex)
    ends = [p for k in range(len(wall)) for p in _graded(wall[k], wall[(k + 1) % len(wall)], size, 1)[:-1]]
    return Outline(nodes, bodies, _unshared(bodies), np.array(ends, dtype=complex), extent)


class _Register:
    """Numbers points; those within the tolerance of each other get the same number."""

    def __init__(self, tolerance: float) -> None:
        self.tolerance = tolerance
        self.points: list[complex] = []

    def number(self, point: complex) -> int:
        if self.points:
            distances = np.abs(np.array(self.points) - point)
            nearest = int(distances.argmin())
            if distances[nearest] <= self.tolerance:
                return nearest
        self.points.append(complex(point))
        return len(self.points) - 1


def _panels(polygon: Complex, corners: Complex, size: float, grading: int, register: _Register) -> Indices:
    """Node pairs of one body; its edges are split at the corners of other bodies on them."""
    numbers: list[int] = []
    for k in range(len(polygon)):
        stops = _split(polygon[k], polygon[(k + 1) % len(polygon)], corners, register.tolerance)
        for start, end in pairwise(stops):
            numbers += [register.number(point) for point in _graded(start, end, size, grading)[:-1]]
    ring = np.array(numbers, dtype=np.int64)
    return np.column_stack([ring, np.roll(ring, -1)])


def _split(start: complex, end: complex, corners: Complex, tolerance: float) -> Complex:
    """The edge's end points and the corners on it, in order."""
    along = (corners - start) / (end - start)
    length = abs(end - start)
    share = tolerance / length
    on = (np.abs(along.imag) < share) & (along.real > share) & (along.real < 1 - share)
    places = np.unique(np.concatenate([[0.0], along.real[on], [1.0]]))
    places = places[np.concatenate([[True], np.diff(places) > share])]
    return np.asarray(start + (end - start) * places, dtype=np.complex128)


def _graded(start: complex, end: complex, size: float, grading: int) -> Complex:
    """Points of an edge: t^q / (t^q + (1 - t)^q), whose longest step is q times the mean (walls: 1)."""
    count = max(4, int(np.ceil(grading * abs(end - start) / size)))
    t = np.linspace(0.0, 1.0, count + 1)
    rise, fall = t**grading, (1 - t) ** grading
    return np.asarray(start + (end - start) * rise / (rise + fall), dtype=np.complex128)


def _unshared(bodies: tuple[Indices, ...]) -> Indices:
    """Panels of one body only, turned around."""
    pairs = {(int(a), int(b)) for body in bodies for a, b in body}
    free = [(b, a) for a, b in sorted(pairs) if (b, a) not in pairs]
    return np.array(free, dtype=np.int64).reshape(-1, 2)


_GROWTH = 0.35
"""Growth of the triangles' size with the distance from the boundary."""
_CLEARANCE = 0.65
"""Least distance of an inner point from the boundary, in units of the local size: keeps it out of the circles over
the edges, so that these are edges of Delaunay's triangles."""
_SMOOTHINGS = 6


def triangulate(ring: Complex, size: float) -> tuple[Complex, Indices]:
    """Points (n,), the ring's (m,) first, and triangles (t, 3), counter-clockwise, that fill the ring.

    ring: corners of a simple polygon, counter-clockwise; triangles inside are no larger than about `size`, m. Raises
    GeometryError where an edge of the ring is no edge of the triangles: corners sharper than about 60 degrees, or
    edges longer than the iron is thick or a gap is wide.
    """
    inner = _inner_points(ring, size)
    points = np.concatenate([ring, inner])
    for _ in range(_SMOOTHINGS):
        points[len(ring) :] = _smoothed(points, _triangles(points, ring), len(ring))
    triangles = _triangles(points, ring)
    _require_edges(triangles, ring)
    return points, triangles


def _sizes(places: Complex, ring: Complex, size: float) -> Array:
    """Local size (n,): the nearest edges' length, growing with the distance from them."""
    ends = np.roll(ring, -1)
    length, middle = np.abs(ends - ring), 0.5 * (ring + ends)
    local = np.full(len(places), size)
    for start in range(0, len(places), 2000):
        part = slice(start, start + 2000)
        allowed = length + _GROWTH * np.abs(places[part, None] - middle)
        local[part] = np.minimum(size, allowed.min(axis=1))
    return local


def _inner_points(ring: Complex, size: float) -> Complex:
    """Middles of squares that are halved until they are no larger than the local size."""
    low = complex(ring.real.min(), ring.imag.min())
    across = max(np.ptp(ring.real), np.ptp(ring.imag))
    count = int(np.ceil(across / size))
    step = across / count
    k = np.arange(count) + 0.5
    squares = np.asarray((low + step * (k[:, None] + 1j * k)).ravel(), dtype=np.complex128)
    found = []
    while len(squares):
        # Squares beyond the boundary by more than their diagonal hold no inner point.
        near = inside(squares, ring) | (distance_to_edges(squares, ring) < 0.75 * step)
        squares = squares[near]
        large = step > 1.3 * _sizes(squares, ring, size)
        found.append((squares[~large], step))
        quarter = 0.25 * step * np.array([1 + 1j, 1 - 1j, -1 + 1j, -1 - 1j])
        squares, step = np.asarray((squares[large, None] + quarter).ravel()), 0.5 * step
    points = np.concatenate([places for places, _ in found])
    points = points[inside(points, ring)]
    clear = distance_to_edges(points, ring) > _CLEARANCE * _sizes(points, ring, size)
    return np.asarray(points[clear])


def _triangles(points: Complex, ring: Complex) -> Indices:
    """Delaunay triangles whose middles lie inside, counter-clockwise."""
    corners = Delaunay(np.column_stack([points.real, points.imag])).simplices.astype(np.int64)
    a, b, c = points[corners].T
    area = 0.5 * ((b - a).conj() * (c - a)).imag
    corners = np.where((area < 0)[:, None], corners[:, ::-1], corners)
    extent = np.abs(points - points[0]).max()
    solid = np.abs(area) > 1e-14 * extent**2
    return np.asarray(corners[inside((a + b + c) / 3, ring) & solid])


def _smoothed(points: Complex, triangles: Indices, fixed: int) -> Complex:
    """Inner points moved half way to the mean of their neighbours, where that keeps their distance from the ring."""
    total = np.zeros(len(points), dtype=complex)
    count = np.zeros(len(points))
    for one, other in ((0, 1), (1, 2), (2, 0), (1, 0), (2, 1), (0, 2)):
        np.add.at(total, triangles[:, one], points[triangles[:, other]])
        np.add.at(count, triangles[:, one], 1.0)
    moved = 0.5 * (points + total / np.maximum(count, 1.0))[fixed:]
    old = points[fixed:]
    nearest = cKDTree(np.column_stack([points[:fixed].real, points[:fixed].imag]))
    before = nearest.query(np.column_stack([old.real, old.imag]))[0]
    after = nearest.query(np.column_stack([moved.real, moved.imag]))[0]
    return np.where(after >= before * (1 - 1e-9), moved, old)


def _require_edges(triangles: Indices, ring: Complex) -> None:
    """Raise GeometryError unless every edge of the ring is an edge of a triangle on its left."""
    count = len(ring)
    have = {(int(t[i]), int(t[(i + 1) % 3])) for t in triangles for i in range(3)}
    lost = [k for k in range(count) if (k, (k + 1) % count) not in have]
    if lost:
        x, z = 1e3 * ring[lost[0]].real, 1e3 * ring[lost[0]].imag
        where = f"triangles inside the iron, edge at ({x:.4g}, {z:.4g}) mm ({len(lost)} such)"
        sharp = "corners no sharper than about 60 degrees"
        must_hold = f"edges must be shorter than iron is thick and gaps are wide, {sharp}"
        raise GeometryError.of(where, must_hold, "an edge that no triangle has", "give a smaller size")
