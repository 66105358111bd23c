"""One chamber between mirror planes: the bodies cut by them, and the mesh of the chamber copied to that of the whole.

Points on walls are found once and moved onto them exactly. A point's copies under two operations are one node where
the operations differ by one that leaves the point alone: nodes are merged by the group's table, not by distances, so
that the mesh has the symmetry without any tolerance.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldmap.device.model import Device
from fieldmap.iron.geometry.cad_kernel import kernel_errors, occ
from fieldmap.iron.geometry.shapes import MILLIMETRES, point
from fieldmap.iron.geometry.solids import glue_bodies
from fieldmap.iron.symmetry.chamber import Chamber
from fieldmap.iron.symmetry.group import SymmetryGroup
from fieldmap.records import Record
from fieldmap.typing import Array, Index

# The pieces of all chambers must add up to the whole, to this fraction of its volume and of its outer surface.
_DEFECT = 1e-5


def glue_chamber(device: Device, chamber: Chamber) -> occ.TopoDS_Shape | None:
    """The bodies' pieces inside the chamber, glued like those of `glue_bodies`, mm.

    None where the kernel cannot cut them, or its pieces do not add up to the bodies.
    """
    whole = glue_bodies(device)
    try:
        cut = whole * _chamber_solid(chamber, whole)
    except kernel_errors():
        return None
    sizes = {body.name: (body.mesh_size or 0.0) * MILLIMETRES for body in device.bodies}
    for piece in cut.solids:
        if piece.name not in sizes:
            return None
        piece.maxh = sizes[piece.name]
    if abs(cut.mass * chamber.group.order / whole.mass - 1) > _DEFECT:
        return None
    area = _outer_area(cut, chamber) * chamber.group.order
    return cut if abs(area / _outer_area(whole, None) - 1) < _DEFECT else None


def _outer_area(shape: occ.TopoDS_Shape, chamber: Chamber | None) -> float:
    """Area of the faces that belong to one solid only, those in the chamber's walls left out."""
    owners = Counter(face for solid in shape.solids for face in solid.faces)
    return sum(face.mass for face, count in owners.items() if count == 1 and not _in_wall(face, chamber))


def _in_wall(face: occ.Face, chamber: Chamber | None) -> bool:
    if chamber is None:
        return False
    at = np.array([face.center.x, face.center.y, face.center.z]) / MILLIMETRES - chamber.group.centre
    # All of the face lies on one side: its centre is on the wall only where all of it is.
    return bool(np.abs(chamber.walls @ at).min() < chamber.group.tolerance)


def _chamber_solid(chamber: Chamber, whole: occ.TopoDS_Shape) -> occ.TopoDS_Shape:
    """The chamber as a solid, larger than the whole."""
    centre = chamber.group.centre * MILLIMETRES
    corners = np.array([(p.x, p.y, p.z) for p in whole.bounding_box])
    extent = 3.0 * float(np.linalg.norm(np.abs(corners - centre).max(axis=0)))
    space = None
    for wall in chamber.walls:
        # A cube that stands on the wall; the kernel's own half-spaces crash it.
        side = np.eye(3)[np.abs(wall).argmin()]
        side = side - (side @ wall) * wall
        frame = occ.Axes(point(*centre), n=occ.Dir(*map(float, wall)), h=occ.Dir(*map(float, side)))
        cube = occ.Box(point(-extent, -extent, 0.0), point(extent, extent, 2 * extent))
        cube = occ.gp_Trsf.Transformation(frame).Inverted()(cube)
        space = cube if space is None else space * cube
    return space


@dataclass(frozen=True, eq=False, repr=False)
class MeshSymmetry(Record):
    """group: the operations that map the mesh onto itself; node_images (g, n): the node that each node is mapped
    onto by each operation. Tets are stored chamber by chamber, in the order of the operations."""

    group: SymmetryGroup
    node_images: Index


def on_walls(chamber: Chamber, points: Array) -> NDArray[np.bool_]:
    """Which points (n,) lie in which walls (w,): (n, w)."""
    return np.abs((points - chamber.group.centre) @ chamber.walls.T) < chamber.group.tolerance


def chamber_contacts(
    chamber: Chamber, points: Array, tets: Index, body: Index
) -> tuple[tuple[int, int], ...]:
    """Pairs of bodies that touch in a wall of the chamber, each with its own image behind it."""
    found: set[tuple[int, int]] = set()
    heights = on_walls(chamber, points)
    for wall, normal in enumerate(chamber.walls):
        mirror = np.eye(3) - 2 * np.outer(normal, normal)
        operation = chamber.group.operations[
            int(np.abs(chamber.group.matrices - mirror).max(axis=(1, 2)).argmin())
        ]
        in_wall = heights[tets, wall].sum(axis=1) == 3
        here = np.unique(body[in_wall]).tolist()
        found |= {(one, operation.bodies[one]) for one in here if operation.bodies[one] != one}
    return tuple(sorted(found))


class ChamberCopies:
    """Numbers of the copies of a chamber's points (n, 3)."""

    def __init__(self, chamber: Chamber, points: Array) -> None:
        self._chamber = chamber
        self._on_wall = np.abs(self._heights(points)) < chamber.group.tolerance
        self.points = self.onto_walls(points)
        self._number, self._source = self._numbered(len(points))

    def onto_walls(self, points: Array) -> Array:
        """The points, those on walls moved onto them exactly."""
        points = points.copy()
        for pattern in np.unique(self._on_wall, axis=0):
            walls = self._chamber.walls[pattern]
            if len(walls):
                here = (self._on_wall == pattern).all(axis=1)
                height = (points[here] - self._chamber.group.centre) @ walls.T
                points[here] -= np.linalg.solve(walls @ walls.T, height.T).T @ walls
        return points

    def nodes(self, cells: Index) -> Index:
        """Copies (g m, k) of cells (m, k) of the chamber's points, operation by operation."""
        return self._number[:, cells].reshape(-1, cells.shape[1])

    def tets(self, tets: Index) -> Index:
        """Copies (g m, 4) of tetrahedra, all oriented as the given ones."""
        copies = self._number[:, tets]
        for copy, operation in zip(copies, self._chamber.group.operations, strict=True):
            if operation.handedness < 0:
                copy[:, [1, 2]] = copy[:, [2, 1]]
        return copies.reshape(-1, 4)

    def all_points(self) -> Array:
        """All nodes (N, 3), the chamber's own first."""
        operation, point = self._source
        centre = self._chamber.group.centre
        turned = np.einsum("nij,nj->ni", self._chamber.group.matrices[operation], self.points[point] - centre)
        turned += centre
        turned[: len(self.points)] = self.points
        return turned

    def vectors(self, points: Array) -> Array:
        """Images (g m, 3) of other points (m, 3), operation by operation."""
        return np.concatenate([operation(points) for operation in self._chamber.group.operations])

    def bodies(self, body: Index, images: Sequence[Sequence[int]] | None = None) -> Index:
        """Body (g m,) of every copy of the chamber's tets of bodies (m,); images: what each operation makes of each
        body, where there are more than those of the device."""
        known = images or [one.bodies for one in self._chamber.group.operations]
        return np.concatenate([np.array(of_bodies)[body] for of_bodies in known])

    def symmetry(self) -> MeshSymmetry:
        """What each operation does to the nodes."""
        operation, point = self._source
        return MeshSymmetry(self._chamber.group, self._number[self._chamber.table[:, operation], point])

    def _heights(self, points: Array) -> Array:
        return (points - self._chamber.group.centre) @ self._chamber.walls.T

    def _numbered(self, count: int) -> tuple[Index, tuple[Index, Index]]:
        """number[g, v]: node of the copy of point v under operation g; and operation and point of each node."""
        order = self._chamber.group.order
        first = np.repeat(np.arange(order)[:, None], count, axis=1)
        for pattern in np.unique(self._on_wall, axis=0):
            if pattern.any():
                here = (self._on_wall == pattern).all(axis=1)
                alone = self._chamber.wall_group(np.flatnonzero(pattern))
                # Operations that differ by one that leaves the point alone: the first of them stands for all.
                first[:, here] = self._chamber.table[:, alone].min(axis=1)[:, None]
        is_first = first == np.arange(order)[:, None]
        number = np.zeros((order, count), np.int64)
        number[is_first] = np.arange(is_first.sum())
        number = np.take_along_axis(number, first, axis=0)
        operation, point = np.nonzero(is_first)
        return number, (operation.astype(np.int64), point.astype(np.int64))
