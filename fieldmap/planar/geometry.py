"""Polygons in the plane, as complex numbers, and whether the bodies, conductors and walls of a device fit together."""

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from fieldmap.device.polygons import signed_area
from fieldmap.errors import GeometryError, Problem
from fieldmap.planar.conductors import complex_points, rectangle, wires
from fieldmap.planar.model import PlanarCoil, PlanarDevice, RoundWire
from fieldmap.typing import Array

Complex = NDArray[np.complex128]


def inside(points: Complex, polygon: Complex) -> NDArray[np.bool_]:
    """Whether points (n,) lie in a simple polygon: a ray to the right meets it an odd number of times. On its edges
    either side."""
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
    problems = [*_bodies(device), *_conductors(device), *_walls(device)]
    if problems:
        raise GeometryError(*problems)


def _bodies(device: PlanarDevice) -> list[Problem]:
    found = [
        Problem(
            f"{device.name}: body {body.name}",
            "corners must run counter-clockwise, x to the right and z up",
            "a clockwise polygon",
            "reverse their order",
        )
        for body in device.bodies
        if signed_area(body.corners.tolist()) <= 0
    ]
    for one, other in combinations(device.bodies, 2):
        first, second = complex_points(one.corners), complex_points(other.corners)
        if _overlap(first, second):
            found.append(
                Problem(
                    f"{device.name}: bodies {one.name} and {other.name}",
                    "bodies may touch but not overlap",
                    "polygons that overlap",
                    "move one of them, or draw them as one polygon",
                )
            )
    return found


def _overlap(first: Complex, second: Complex) -> bool:
    if edges_cross(first, second):
        return True
    return any(
        bool(
            np.any(
                inside(_probes(a), b) & (distance_to_edges(_probes(a), b) > 1e-9 * np.ptp(np.abs(b - b[0])))
            )
        )
        for a, b in ((first, second), (second, first))
    )


def _probes(polygon: Complex) -> Complex:
    """Corners, middles of the edges, and a point inside."""
    middles = 0.5 * (polygon + np.roll(polygon, -1))
    inwards = middles + 1e-6j * (np.roll(polygon, -1) - polygon)
    return np.concatenate([polygon, middles, inwards])


def _outline_points(coil: PlanarCoil, centre: complex) -> Complex:
    """Points on the edge of a conductor."""
    if isinstance(coil.wire, RoundWire):
        return np.array([centre])
    corners = rectangle(centre, coil.wire)
    return np.concatenate([corners, 0.5 * (corners + np.roll(corners, -1)), [centre]])


def _cuts(coil: PlanarCoil, centre: complex, polygon: Complex, want_inside: bool) -> bool:
    """Whether a conductor reaches over the edge of a polygon that it should be inside or outside of."""
    points = _outline_points(coil, centre)
    distance = distance_to_edges(points, polygon)
    wrong = inside(points, polygon) != want_inside
    if isinstance(coil.wire, RoundWire):
        return bool(wrong[0] or distance[0] < coil.wire.radius * (1 - _SLACK))
    near = _SLACK * min(coil.wire.width, coil.wire.height)
    return bool(np.any(wrong & (distance > near)) or edges_cross(rectangle(centre, coil.wire), polygon))


def _conductors(device: PlanarDevice) -> list[Problem]:
    found = []
    for coil in device.coils:
        for centre in wires(coil)[0]:
            place = f"{device.name}: coil {coil.name}, conductor at ({1e3 * centre.real:g}, {1e3 * centre.imag:g}) mm"
            found += [
                Problem(
                    place,
                    "conductors must lie outside the iron",
                    f"it cuts {body.name}",
                    "move it or the body",
                )
                for body in device.bodies
                if _cuts(coil, centre, complex_points(body.corners), False)
            ]
            if device.walls is not None and _cuts(coil, centre, complex_points(device.walls), True):
                found.append(
                    Problem(place, "conductors must lie inside the walls", "it does not", "widen the walls")
                )
    return found


def _walls(device: PlanarDevice) -> list[Problem]:
    if device.walls is None:
        return []
    wall = complex_points(device.walls)
    found = []
    for body in device.bodies:
        corners = complex_points(body.corners)
        outline = np.concatenate([corners, 0.5 * (corners + np.roll(corners, -1))])
        gap = 1e-6 * np.ptp(wall.real)
        if (
            not inside(outline, wall).all()
            or edges_cross(corners, wall)
            or distance_to_edges(wall, corners).min() < gap
        ):
            found.append(
                Problem(
                    f"{device.name}: body {body.name}",
                    "iron must lie inside the walls and not touch them",
                    "iron that reaches the walls",
                    "widen the walls",
                )
            )
    return found
