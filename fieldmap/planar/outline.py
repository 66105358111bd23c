"""Outlines of bodies and walls as straight panels; those of bodies are graded towards every corner."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fieldmap.planar.conductors import complex_points
from fieldmap.planar.model import PlanarDevice

Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]
GRADING = 3
_SAME = 1e-9
"""Points closer than this share of the device's extent are one."""


@dataclass(frozen=True, eq=False)
class Outline:
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
    """Panels no longer than `size`, m, graded towards corners; grading 1 is none.

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
    """Node pairs of one body, split where corners of others lie on its edges."""
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
