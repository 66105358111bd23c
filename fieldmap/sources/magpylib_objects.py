"""Magnetised tetrahedra, for use of solved iron, and coils as magpylib objects."""

import math
from functools import singledispatch

import numpy as np
from scipy.spatial.transform import Rotation

from fieldmap.arguments import check
from fieldmap.constants import MU0
from fieldmap.device.coils import Coil, WindingPath
from fieldmap.device.coils.rounded_rectangle import RoundedRectangleCoil
from fieldmap.extras import needs
from fieldmap.typing import Array

with needs("make", "models of magpylib"):
    import magpylib


def magpylib_tetrahedra(corners: Array, polarisation: Array, label: str) -> magpylib.Collection:
    """Tetrahedra with corners (n, 4, 3) in m and polarisation (n, 3) in T, uniform in each, as one Collection.

    >>> import numpy as np
    >>> unit = np.vstack([np.zeros(3), np.eye(3)])
    >>> ball = magpylib_tetrahedra(unit[None], np.array([[0.0, 0.0, 1.0]]), "a corner")
    >>> print(ball.getB([5.0, 0.0, 0.0]).round(6))
    [-1.80e-05  1.00e-06 -1.22e-04]
    """
    magnets = [
        magpylib.magnet.Tetrahedron(vertices=vertices, polarization=vector)
        for vertices, vector in zip(corners, polarisation, strict=True)
    ]
    return magpylib.Collection(*magnets, style_label=label)


_QUARTERS = (0.0, 90.0, 180.0, 270.0)


def magpylib_coil(coil: Coil, current: float = 1.0, shells: int = 8) -> magpylib.Collection:
    """A coil carrying `current` (A) as a magpylib Collection at its place in the global frame.

    shells: number of current sheets. Eight are good to about 1e-12 one coil diameter away and to 5e-7 at 1 mm
    from a winding 10 mm thick, sixteen to 1e-11 there. Inside the winding the field is the field of the sheets.
    Roundings are magpylib CylinderSegments, whose own errors reach 1e-7 at some points (1e-10 at most of them).
    Raises InputError for fewer than one shell or a current that is not finite.

    >>> from fieldmap.device.model import CircularCoil
    >>> coil = CircularCoil("one", inner_radius=0.011, outer_radius=0.021, height=0.039, turns=840)
    >>> print(magpylib_coil(coil).getB([0.0, 0.0, 0.0]).round(6))
    [0.      0.      0.02095]
    """
    received, right = f"shells = {shells}, current = {current}", shells >= 1 and math.isfinite(current)
    check(right, "magpylib_coil", "shells >= 1 and a finite current", received, "correct it")
    nodes, weights = np.polynomial.legendre.leggauss(shells)
    magnets = []
    for node, weight in zip(nodes, weights / 2, strict=True):
        magnetised = MU0 * coil.turns * coil.polarity * current * weight / coil.height
        magnets += _sheet(coil, float(node), magnetised)
    collection = magpylib.Collection(*magnets)
    collection.rotate(Rotation.from_matrix(coil.placement.rotation), anchor=0)
    collection.move(coil.placement.position)
    return collection


@singledispatch
def _sheet(coil: Coil, node: float, magnetised: float) -> list:
    """The magnets of one sheet, `node` in [-1, 1] across the thickness; of any shape, from its arcs and bars."""
    path = coil.winding()
    if path.is_circle:
        inner, outer = path.arcs[0, 5:7]
        radius = (inner + outer + node * (outer - inner)) / 2
        return [
            magpylib.magnet.Cylinder(polarization=(0, 0, magnetised), dimension=(2 * radius, path.height))
        ]
    return _path(path, node * path.thickness / 2, magnetised)


@_sheet.register
def _rounded_rectangle(coil: RoundedRectangleCoil, node: float, magnetised: float) -> list:
    """Blocks and four sectors: fewer and quicker magnets than for a path."""
    offset = node * coil.thickness / 2
    x, y = coil.half_width_x - coil.corner_radius, coil.half_width_y - coil.corner_radius
    radius = coil.corner_radius + offset
    boxes = [
        ((2 * x, 2 * (y + radius), coil.height), (0.0, 0.0, 0.0)),
        ((radius, 2 * y, coil.height), (x + radius / 2, 0.0, 0.0)),
        ((radius, 2 * y, coil.height), (-x - radius / 2, 0.0, 0.0)),
    ]
    corners = [(x, y, 0.0), (-x, y, 0.0), (-x, -y, 0.0), (x, -y, 0.0)]
    return [
        magpylib.magnet.Cuboid(polarization=(0, 0, magnetised), dimension=size, position=place)
        for size, place in boxes
        if min(size) > 0
    ] + [
        _sector(place, radius, coil.height, start, start + 90, magnetised)
        for place, start in zip(corners, _QUARTERS, strict=True)
    ]


def _sector(
    place: tuple[float, ...], radius: float, height: float, start: float, stop: float, magnetised: float
):
    return magpylib.magnet.CylinderSegment(
        polarization=(0, 0, magnetised), dimension=(0, radius, height, start, stop), position=place
    )


def _path(path: WindingPath, offset: float, magnetised: float) -> list:
    """Inside the outline = the polygon through arc centres and bar ends, plus or minus the sectors of the corners."""
    magnets, corners = [], []
    for cx, cy, mx, my, span, inner, outer, sense in path.arcs:
        radius = (inner + outer) / 2 + sense * offset
        middle, opening = math.atan2(my, mx), sense * span
        ends = [
            (cx + radius * math.cos(angle), cy + radius * math.sin(angle))
            for angle in (middle - opening, middle + opening)
        ]
        corners += [ends[0], (cx, cy), ends[1]]
        angles = math.degrees(middle - span), math.degrees(middle + span)
        magnets.append(_sector((cx, cy, 0.0), radius, path.height, *angles, sense * magnetised))
    polygon = np.array(corners)
    origin = polygon.mean(axis=0)
    for one, two in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        magnets += _prism(np.array([origin, one, two]), path.height, magnetised)
    return magnets


_FACES = np.array([[0, 2, 1], [3, 4, 5], [0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [2, 0, 3], [2, 3, 5]])


def _prism(triangle: Array, height: float, magnetised: float) -> list:
    """Signed triangular prism: positive where the triangle turns counter-clockwise, nothing where it is flat."""
    edge, other = triangle[1] - triangle[0], triangle[2] - triangle[0]
    area = edge[0] * other[1] - edge[1] * other[0]
    if abs(area) < 1e-14 * (edge @ edge + other @ other):
        return []
    if area < 0:
        triangle, magnetised = triangle[::-1], -magnetised
    below = np.column_stack([triangle, np.full(3, -height / 2)])
    above = np.column_stack([triangle, np.full(3, height / 2)])
    vertices = np.vstack([below, above])
    return [magpylib.magnet.TriangularMesh(polarization=(0, 0, magnetised), vertices=vertices, faces=_FACES)]
