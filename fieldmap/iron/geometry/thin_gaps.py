"""Close gaps between flat faces that are thin against the elements: bodies are moved until they touch, for the mesher.

If the faces on both sides of a gap are meshed separately, their elements and charges do not lie opposite to each other.
Bodies that touch have common elements there. So the pieces of iron on both sides of a thin gap are moved as a whole
until they touch, meshed, and moved back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from fieldmap.device.model import Device
from fieldmap.iron.geometry import contacts
from fieldmap.iron.geometry.shapes import MILLIMETRES, named, occ, xyz
from fieldmap.iron.geometry.solids import body_solid, device_label, glue_solids
from fieldmap.iron.topology import connected
from fieldmap.records import Record
from fieldmap.typing import Array, Index

THIN = 1 / 5
"""A gap is thin if it is narrower than this fraction of the smaller mesh size of the two bodies."""
# mm. Distances of flat faces that differ by less are the same.
_SAME = 1e-6
# Directions that differ by less are parallel.
_PARALLEL = 1e-9

Pair = tuple[int, int]


@dataclass(frozen=True, eq=False, repr=False)
class ClosedGaps(Record):
    """device: as it is given to the mesher, its bodies moved by moves (b, 3), m; gaps: widths in m of the gaps that
    were closed, by the numbers of their bodies."""

    device: Device
    moves: Array
    gaps: dict[Pair, float]


def closed_gaps(device: Device) -> ClosedGaps | None:
    """The device with its thin gaps closed; None if it has no thin gap that can be closed by moving bodies.

    Pieces of iron move as a whole, towards the largest of them. A gap that another one holds open (both ends of a slug
    between two poles) stays, and so do gaps between faces that are not flat or not parallel.
    """
    if THIN == 0 or len(device.bodies) < 2 or any(body.has_own_mesh for body in device.bodies):
        return None
    source = device_label(device)
    solids = [body_solid(body, source) for body in device.bodies]
    near = _near_pairs(device, solids)
    if not any(distance > contacts.CONTACT_DISTANCE for distance in near.values()):
        return None
    touching = [pair for pair, distance in near.items() if distance <= contacts.CONTACT_DISTANCE]
    piece = connected(np.array(touching, np.int64).reshape(-1, 2), len(solids))
    steps = {
        pair: step
        for pair, distance in near.items()
        if distance > contacts.CONTACT_DISTANCE and piece[pair[0]] != piece[pair[1]]
        if (step := _step_between(solids[pair[0]], solids[pair[1]], distance)) is not None
    }
    moves, closed = _moves(np.array([solid.mass for solid in solids]), piece, steps)
    if not closed or not _is_sound(device, solids, moves, closed, piece):
        return None
    bodies = tuple(
        body.moved(move / MILLIMETRES) if move.any() else body
        for body, move in zip(device.bodies, moves, strict=True)
    )
    same = {"materials": device.materials, "joints": device.joints}
    moved = Device.unchecked(name=device.name, source=device.source, bodies=bodies, **same)
    widths = {pair: float(np.linalg.norm(steps[pair])) / MILLIMETRES for pair in closed}
    return ClosedGaps(moved, moves / MILLIMETRES, widths)


def _near_pairs(device: Device, solids: Sequence[occ.TopoDS_Shape]) -> dict[Pair, float]:
    """Distances, mm, of bodies that touch or have a thin gap between them."""
    found = {}
    sizes = [(body.mesh_size or 0.0) * MILLIMETRES for body in device.bodies]
    for a, b in combinations(range(len(solids)), 2):
        limit = THIN * min(sizes[a], sizes[b]) - _SAME
        if not contacts.bounds_nearer_than(solids[a], solids[b], limit):
            continue
        distance = float(solids[a].Distance(solids[b]))
        if distance < limit:
            found[a, b] = distance
    return found


def _step_between(one: occ.TopoDS_Shape, other: occ.TopoDS_Shape, distance: float) -> Array | None:
    """Displacement (3,) of the other solid, mm, that brings flat faces `distance` apart into contact. None without such
    faces, and if there are gaps on several sides, as round a pole in a collar: closing one would widen another."""
    found: list[Array] = []
    for face in one.faces:
        normal = _plane_normal(face)
        if normal is None:
            continue
        for opposite in other.faces:
            its = _plane_normal(opposite)
            if its is None or abs(abs(normal @ its) - 1) > _PARALLEL:
                continue
            width = (xyz(opposite.center) - xyz(face.center)) @ normal
            if abs(abs(width) - distance) > _SAME:
                continue
            step = -width * normal
            # Exact where the normal is an axis.
            step[np.abs(step) < _SAME * distance] = 0.0
            if any(np.abs(step - known).max() < _SAME for known in found):
                continue
            if _contact(one, _moved(other, step)) > 0:
                found.append(step)
    return found[0] if len(found) == 1 else None


def _plane_normal(face: occ.Face) -> Array | None:
    """Unit normal (3,) of a flat face, of either sign; None for a curved face."""
    normals = []
    for u, v in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.3, 0.7)):
        _, along, across = face.surf.D1(u, v)
        normal = np.cross(xyz(along), xyz(across))
        length = np.linalg.norm(normal)
        if length == 0:
            return None
        normals.append(normal / length)
    flat = all(abs(normals[0] @ n - 1) < _PARALLEL for n in normals)
    return normals[0] if flat else None


def _moved(solid: occ.TopoDS_Shape, by: Array) -> occ.TopoDS_Shape:
    return solid.Move(occ.gp_Vec(*map(float, by))) if by.any() else solid


def _contact(one: occ.TopoDS_Shape, other: occ.TopoDS_Shape) -> float:
    """Area, mm^2, of the faces that two solids share."""
    pair = [named(one, "one"), named(other, "other")]
    return sum(contacts.contact_areas(glue_solids(pair)).values())


def _moves(volume: Array, piece: Index, steps: dict[Pair, Array]) -> tuple[Array, list[Pair]]:
    """Displacements (b, 3) of the bodies, mm, and the pairs whose gaps they close."""
    moves = np.zeros((len(volume), 3))
    size = np.bincount(piece, volume)
    placed: set[int] = set()
    for root in np.argsort(-size, kind="stable").tolist():
        queue = [] if root in placed else [root]
        placed.update(queue)
        while queue:
            here = queue.pop(0)
            for (a, b), step in steps.items():
                for near, far, by in ((a, b, step), (b, a, -step)):
                    if piece[near] == here and piece[far] not in placed:
                        moves[piece == piece[far]] = moves[near] + by
                        placed.add(int(piece[far]))
                        queue.append(int(piece[far]))
    closed = [
        pair for pair, step in steps.items() if np.abs(moves[pair[1]] - moves[pair[0]] - step).max() < _SAME
    ]
    return moves, closed


def _is_sound(
    device: Device, solids: Sequence[occ.TopoDS_Shape], moves: Array, closed: Sequence[Pair], piece: Index
) -> bool:
    """Whether the moved bodies touch where gaps were closed, and nothing else has come into contact."""
    moved = [_moved(solid, by) for solid, by in zip(solids, moves, strict=True)]
    names = [body.name for body in device.bodies]
    bodies = [
        contacts.NamedSolid("body", name, named(one, name)) for name, one in zip(names, moved, strict=True)
    ]
    if contacts.overlaps(combinations(bodies, 2)):
        return False
    for a, b in combinations(range(len(moved)), 2):
        if piece[a] == piece[b] or (a, b) in closed or not (moves[a] != moves[b]).any():
            continue
        if contacts.bounds_nearer_than(moved[a], moved[b], _SAME) and moved[a].Distance(moved[b]) < _SAME:
            return False
    return True
