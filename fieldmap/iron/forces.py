"""Forces and torques on bodies and coils, and the connected pieces of iron on which a force is defined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from fieldmap.arguments import check, check_names, raise_all
from fieldmap.constants import MU0
from fieldmap.device.model import Background, Coil
from fieldmap.errors import Problem
from fieldmap.iron.mesh.charged_faces import ChargedFaces
from fieldmap.iron.mesh.mesh import IronMesh
from fieldmap.iron.mesh.surface_mesh import IronSurface
from fieldmap.iron.topology import connected
from fieldmap.records import Record
from fieldmap.sources import unit_flux_density
from fieldmap.sources.winding_rules import current_elements
from fieldmap.typing import Array, Index


@dataclass(frozen=True, eq=False, repr=False)
class MagneticBodies(Record):
    """Connected pieces of iron, numbered from 0: of_element (e,), of_face (m,), number of each charged face's piece.

    For a mesh of surfaces of_element (s,) is of the solids.
    """

    of_element: Index
    of_face: Index

    def touched_by(self, mesh: IronMesh | IronSurface, body: str) -> tuple[str, ...]:
        """Names of all bodies in one piece of iron with this one, itself included; joints connect bodies."""
        pieces = np.unique(self.of_element[mesh.body == mesh.body_names.index(body)])
        bodies = np.unique(mesh.body[np.isin(self.of_element, pieces)])
        return tuple(name for k in bodies if (name := mesh.body_names[k]) in mesh.iron_names)


def magnetic_bodies(mesh: IronMesh | IronSurface, faces: ChargedFaces) -> MagneticBodies:
    """Sort elements and charged faces by the piece of iron they belong to; the faces' corners are mesh points."""
    if isinstance(mesh, IronSurface):
        outer = mesh.faces_around(mesh.all_solids)
        return MagneticBodies(mesh.pieces, mesh.pieces[mesh.sides[outer, 0]])
    count = len(mesh.points)
    piece = connected(np.column_stack([np.repeat(mesh.tets[:, 0], 3), mesh.tets[:, 1:].ravel()]), count)
    # Points that no element uses are pieces of their own; the other pieces are numbered from 0.
    used, of_element = np.unique(piece[mesh.tets[:, 0]], return_inverse=True)
    corners = faces.corners[:, 0]
    _, number = np.unique(np.concatenate([mesh.points, corners]), axis=0, return_inverse=True)
    number = number.ravel()
    point_of = np.empty(number.max() + 1, dtype=np.int64)
    point_of[number[:count]] = np.arange(count)
    of_face = np.searchsorted(used, piece[point_of[number[count:]]])
    return MagneticBodies(of_element, of_face)


Mask = NDArray[np.bool_]
# Degree of the rule on faces; degree on faces nearer to the other charges than the third number times their radius.
_DEGREE, _NEAR_DEGREE, _NEAR_RADII = 4, 8, 6.0
# Decimal digits of the coils' field; a force needs five.
_DIGITS = 7


@dataclass(frozen=True, eq=False, repr=False)
class Magnetised(Record):
    """A device at fixed currents (c,), or a part of it: its coils and, if it has iron, its mesh, charged faces and
    their density (m,) in T. background: the field of sources outside the device."""

    coils: tuple[Coil, ...]
    currents: Array
    mesh: IronMesh | IronSurface | None = None
    faces: ChargedFaces | None = None
    density: Array | None = None
    background: Background | None = None

    def part(self, coils: Mask, faces: Mask) -> Magnetised:
        """Some of its coils (c,) and charged faces (m,)."""
        some = replace(self, coils=tuple(compress(self.coils, coils)), currents=self.currents[coils])
        if self.faces is None or self.density is None:
            return some
        return replace(some, faces=self.faces.part(faces), density=self.density[faces])

    def field(self, points: Array) -> Array:
        """Flux density (n, 3), background included."""
        field = np.zeros_like(points) if self.background is None else self.background.field(points)
        for coil, current in zip(self.coils, self.currents, strict=True):
            if current != 0:
                field += current * unit_flux_density(coil, points, digits=_DIGITS)
        if self.faces is not None and self.density is not None and len(self.density):
            field += self.faces.field(points, np.ascontiguousarray(self.density[None]))[0]
        return field


def force_and_torque(device: Magnetised, names: str | Sequence[str], about: ArrayLike) -> tuple[Array, Array]:
    """Force (3,) in N and torque (3,) in N m about a point (3,) on named bodies and coils taken together.

    Raises InputError for a name that is neither a body nor a coil, for a body named without the bodies that it touches
    (iron glued to iron has no force of its own), and for a bad point.
    """
    centre = np.asarray(about, dtype=float)
    holds = centre.shape == (3,) and bool(np.isfinite(centre).all())
    check(holds, "torque, about", "must be one finite point (3,)", repr(about), "give x, y, z in m")
    coils, faces = _named(device, (names,) if isinstance(names, str) else tuple(names))
    mine, others = device.part(coils, faces), device.part(~coils, ~faces)
    force, torque = np.zeros(3), np.zeros(3)
    for points, push in (*_on_charges(mine, others), *_on_currents(mine, others)):
        force += push.sum(axis=0)
        torque += np.cross(points - centre, push).sum(axis=0)
    return force, torque


def _on_charges(mine: Magnetised, others: Magnetised):
    """Points (n, 3) and forces (n, 3) on charges: sigma B / mu0 over their faces."""
    if mine.faces is None or mine.density is None or others.faces is None:
        return
    near = cKDTree(others.faces.centres).query(mine.faces.centres)[0] < _NEAR_RADII * mine.faces.radii
    for part, degree in ((~near, _DEGREE), (near, _NEAR_DEGREE)):
        if not part.any():
            continue
        faces = mine.faces.part(part)
        points, weights = faces.rule_points(degree)
        charge = np.outer(mine.density[part] * faces.areas / MU0, weights).reshape(-1, 1)
        points = points.reshape(-1, 3)
        yield points, charge * others.field(points)


def _on_currents(mine: Magnetised, others: Magnetised):
    """Points (n, 3) and forces (n, 3) on currents: I dl x B over their windings."""
    for coil, current in zip(mine.coils, mine.currents, strict=True):
        if current != 0:
            rule = current_elements(coil)
            yield rule.points, current * np.cross(rule.vectors, others.field(rule.points))


def _named(device: Magnetised, names: tuple[str, ...]) -> tuple[Mask, Mask]:
    """Which coils (c,) and which charged faces (m,) have these names."""
    coil_names = tuple(coil.name for coil in device.coils)
    body_names = device.mesh.iron_names if device.mesh is not None else ()
    known = (*body_names, *coil_names)
    check(bool(names), "force, name", "at least one body or coil is needed", "none", "name one")
    must_hold = f"must be a body or coil: {', '.join(known)}"
    check_names("force, name", names, must_hold, known, "use one of these")
    faces = np.zeros(0 if device.faces is None else len(device.faces.areas), bool)
    bodies = tuple(name for name in names if name in body_names)
    if bodies and device.mesh is not None and device.faces is not None:
        pieces = magnetic_bodies(device.mesh, device.faces)
        problems = []
        for name in bodies:
            touching = pieces.touched_by(device.mesh, name)
            if not set(touching) <= set(bodies):
                others = ", ".join(repr(other) for other in touching if other != name)
                must_hold = "a force is defined for whole pieces of iron, with air all around"
                remedy = f"ask for the force on all of them together: {list(touching)}"
                problem = Problem(
                    f"force, body '{name}'", must_hold, f"'{name}', which touches {others}", remedy
                )
                problems.append(problem)
        raise_all(problems)
        elements = np.isin(device.mesh.body, [body_names.index(name) for name in bodies])
        faces = np.isin(pieces.of_face, pieces.of_element[elements])
    return np.isin(coil_names, [name for name in names if name not in bodies]), faces
