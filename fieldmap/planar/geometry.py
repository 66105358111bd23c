"""Polygons in the plane, as complex numbers, and whether the bodies, conductors and walls of a device fit together."""

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from fieldmap.arguments import raise_all
from fieldmap.device.polygons import signed_area
from fieldmap.errors import GeometryError, Problem
from fieldmap.planar.conductors import complex_points, rectangle, wires
from fieldmap.planar.model import PlanarCoil, PlanarDevice, RoundWire
from fieldmap.typing import Array

Complex = NDArray[np.complex128]


def inside(points: Complex, polygon: Complex) -> NDArray[np.bool_]:
    """Whether points (n,) lie in a simple polygon: a ray to the right meets it an odd number of times. Points on an
    edge may fall on either side."""
    ends = np.roll(polygon, -1)
    above = polygon.imag[None, :] > points.imag[:, None]
    point, edge = np.nonzero(above != np.roll(above, -1, axis=1))
    start, end = polygon[edge], ends[edge]
    left = ((end - start).conj() * (points[point] - start)).imag > 0
    met = point[left == (end.imag > start.imag)]
    return np.asarray(np.bincount(met, minlength=len(points)) % 2 == 1)


def distance_to_edges(points: Complex, polygon: Complex) -> Array:
    """Distance (n,) to the nearest edge of a polygon."""
    start, step = polygon[None, :], (np.roll(polygon, -1) - polygon)[None, :]
    along = np.clip(((points[:, None] - start) / step).real, 0.0, 1.0)
    return np.abs(points[:, None] - start - along * step).min(axis=1)


def edges_cross(first: Complex, second: Complex) -> bool:
    """Whether an edge of one polygon runs through an edge of the other (touching is not crossing)."""
    p, q = first[:, None], np.roll(first, -1)[:, None]
    a, b = second[None, :], np.roll(second, -1)[None, :]
    tolerance = 1e-9 * np.abs(q - p) * np.abs(b - a)

    def side(start: Complex, end: Complex, point: Complex) -> Array:
        area = ((end - start).conj() * (point - start)).imag
        return np.where(np.abs(area) <= tolerance, 0.0, np.sign(area))

    return bool(np.any((side(p, q, a) * side(p, q, b) < 0) & (side(a, b, p) * side(a, b, q) < 0)))


_SLACK = 1e-6
"""Share of the radius by which rounding may put a touching conductor into the iron."""


def check_planar_geometry(device: PlanarDevice) -> None:
    """Raise GeometryError with one Problem for everything that overlaps or lies outside the walls."""
    raise_all([*_bodies(device), *_conductors(device), *_walls(device)], GeometryError)


def _bodies(device: PlanarDevice) -> Iterator[Problem]:
    for body in device.bodies:
        if signed_area(body.corners.tolist()) <= 0:
            where = f"{device.name}: body {body.name}"
            must_hold = "corners must run counter-clockwise, x to the right and z up"
            yield Problem(where, must_hold, "a clockwise polygon", "reverse their order")
    for one, other in combinations(device.bodies, 2):
        if _overlap(complex_points(one.corners), complex_points(other.corners)):
            where = f"{device.name}: bodies {one.name} and {other.name}"
            must_hold = "bodies may touch but not overlap"
            remedy = "move one of them, or draw them as one polygon"
            yield Problem(where, must_hold, "polygons that overlap", remedy)


def _overlap(first: Complex, second: Complex) -> bool:
    def reaches_into(one: Complex, other: Complex) -> bool:
        probes = _probes(one)
        apart = distance_to_edges(probes, other) > 1e-9 * np.ptp(np.abs(other - other[0]))
        return bool(np.any(inside(probes, other) & apart))

    return edges_cross(first, second) or reaches_into(first, second) or reaches_into(second, first)


def _probes(polygon: Complex) -> Complex:
    """Corners, middles of the edges, and a point inside."""
    middles = 0.5 * (polygon + np.roll(polygon, -1))
    inwards = middles + 1e-6j * (np.roll(polygon, -1) - polygon)
    return np.concatenate([polygon, middles, inwards])


def _cuts(coil: PlanarCoil, centre: complex, polygon: Complex, want_inside: bool) -> bool:
    """Whether a conductor reaches over the edge of a polygon that it should be inside or outside of."""
    middle = np.array([centre])
    if isinstance(coil.wire, RoundWire):
        near = distance_to_edges(middle, polygon)[0] < coil.wire.radius * (1 - _SLACK)
        return bool(near or inside(middle, polygon)[0] != want_inside)
    corners = rectangle(centre, coil.wire)
    points = np.concatenate([corners, 0.5 * (corners + np.roll(corners, -1)), middle])
    clear = distance_to_edges(points, polygon) > _SLACK * min(coil.wire.width, coil.wire.height)
    wrong = inside(points, polygon) != want_inside
    return bool(np.any(wrong & clear)) or edges_cross(corners, polygon)


def _conductors(device: PlanarDevice) -> Iterator[Problem]:
    for coil in device.coils:
        for centre in wires(coil)[0]:
            place = f"{device.name}: coil {coil.name}, conductor at ({1e3 * centre.real:g}, {1e3 * centre.imag:g}) mm"
            for body in device.bodies:
                if _cuts(coil, centre, complex_points(body.corners), False):
                    must_hold, remedy = "conductors must lie outside the iron", "move it or the body"
                    yield Problem(place, must_hold, f"it cuts {body.name}", remedy)
            if device.walls is not None and _cuts(coil, centre, complex_points(device.walls), True):
                yield Problem(place, "conductors must lie inside the walls", "it does not", "widen the walls")


def _walls(device: PlanarDevice) -> Iterator[Problem]:
    if device.walls is None:
        return
    wall = complex_points(device.walls)
    for body in device.bodies:
        corners = complex_points(body.corners)
        outline = np.concatenate([corners, 0.5 * (corners + np.roll(corners, -1))])
        touches = distance_to_edges(wall, corners).min() < 1e-6 * np.ptp(wall.real)
        if touches or edges_cross(corners, wall) or not inside(outline, wall).all():
            where = f"{device.name}: body {body.name}"
            must_hold = "iron must lie inside the walls and not touch them"
            yield Problem(where, must_hold, "iron that reaches the walls", "widen the walls")
