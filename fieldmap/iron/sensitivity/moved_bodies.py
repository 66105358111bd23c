"""Bodies that move or change their size: their nodes move with them, and the mesh keeps its topology.

A node has a fixed place in its body, in multiples of the body's dimensions: (x, y, z)/size in a box, (x, y)/radius and
z/height in a cylinder. The whole mesh thus moves smoothly with the shape, its curved faces included. If the parts of a
body change in different ways, each part carries its own faces (`lies_on`), and nodes inside move smoothly between them.

Each body that a key moves has a movement u, which carries its surfaces. Where two bodies touch, their movements may
differ along the contact, not across it. Nodes there follow the body whose edges bound the contact (the core that stands
on a disk). Within the other body, b, nodes move by u_b + w: w is the difference of movements on the contact, has no
component across any other surface, and minimises the sum of |grad w|^2 over elements, with equal weights for small and
large ones. Planes slide within themselves, curved surfaces keep their own movement.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_diag, coo_matrix, csc_matrix, identity, kron
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from fieldmap.device.model import Body, Box, Cylinder, Device, Part, Ring, Sphere
from fieldmap.errors import InputError
from fieldmap.iron.mesh.mesh import IronMesh
from fieldmap.iron.sensitivity.changes import Change, same
from fieldmap.iron.topology import TRIANGLE_SIDES, Faces, area_vectors, barycentric_gradients, distinct_parts
from fieldmap.records import Record
from fieldmap.typing import Array, Index

# Largest distance of nodes from their plane, over the part's largest dimension. Only rounding moves them off it.
_ON_PLANE = 1e-7
# Largest distance of corners from their curved face, over its radius. They are off it to keep the volume.
_ON_CURVE = 0.05
# A face lies in a plane if the cosine between its normal and the plane's is larger than the first number. It lies along
# an axis if the cosine between its normal and the axis is smaller than the second.
_ALONG, _ACROSS = 0.999, 0.05


def lies_on(part: Part, corners: Array, normals: Array) -> NDArray[np.bool_]:
    """Which corners (f, 3) of faces, given by corners (f, 3, 3) and unit normals (f, 3), lie on a part's surface. The
    face must lie in one of the part's planes or curved faces; in a plane it may reach beyond the part. No corner lies
    on parts other than boxes, cylinders, rings and spheres.
    """
    turn, shift = part.placement.rotation, part.placement.position
    local, normal = (corners - shift) @ turn, np.abs(normals @ turn)
    match part.shape.primitive:
        case Box(size):
            high, slack = np.array(size) / [2, 2, 1], _ON_PLANE * max(size)
            low = high - size
            inside = ((local > low - slack) & (local < high + slack)).all(axis=2)
            planes = [_in_plane(local, normal, k, at[k], slack) for k in range(3) for at in (low, high)]
            return np.asarray(inside & np.any(planes, axis=0)[:, None])
        case Cylinder(radius, height):
            return _on_turned(local, normal, 0.0, radius, height)
        case Ring(inner, outer, height):
            return _on_turned(local, normal, inner, outer, height)
        case Sphere(radius):
            near = _is_near(np.linalg.norm(local, axis=2), radius)
            return np.repeat(near[:, None], 3, axis=1)
    return np.zeros(corners.shape[:2], bool)


def _on_turned(local: Array, normal: Array, inner: float, outer: float, height: float) -> NDArray[np.bool_]:
    """`lies_on` for a solid of revolution between two radii and between z = 0 and its height."""
    distance, slack = np.hypot(local[..., 0], local[..., 1]), _ON_PLANE * max(outer, height)
    within = (local[..., 2] > -slack) & (local[..., 2] < height + slack)
    ends = _in_plane(local, normal, 2, 0.0, slack) | _in_plane(local, normal, 2, height, slack)
    reached = (distance >= inner * (1 - _ON_CURVE)) & (distance < outer * (1 + _ON_CURVE))
    curved = (_is_near(distance, inner) | _is_near(distance, outer)) & (normal[:, 2] < _ACROSS)
    return np.asarray(within & (ends[:, None] & reached | curved[:, None]))


def _is_near(distance: Array, radius: float) -> NDArray[np.bool_]:
    return np.asarray((np.abs(distance - radius) < _ON_CURVE * radius).all(axis=1))


def _in_plane(local: Array, normal: Array, axis: int, at: float, slack: float) -> NDArray[np.bool_]:
    return np.asarray((np.abs(local[..., axis] - at) < slack).all(axis=1) & (normal[:, axis] > _ALONG))


# Sine of the smallest angle between two faces that makes an edge.
_EDGE = 0.1
# Normals at a node that differ by less belong to one plane; movements across a contact below this share are rounding.
_SAME_PLANE = 1e-6


@dataclass(frozen=True, eq=False, repr=False)
class Contact(Record):
    """One contact of two bodies, by number: its nodes (n,), its unit normal (3,), and edges_of: the body whose edges
    surround it, None if neither body's do."""

    bodies: tuple[int, int]
    nodes: Index
    normal: Array
    edges_of: int | None

    @property
    def owner(self) -> int:
        """The body that the contact follows. If `edges_of` is None, both can only move together."""
        return self.bodies[0] if self.edges_of is None else self.edges_of


class Contacts:
    """All contacts of the bodies of a mesh, and smooth movements within the bodies."""

    def __init__(self, mesh: IronMesh, topology: Faces) -> None:
        self._mesh, self._nodes = mesh, topology.nodes
        owner = topology.owner
        self._sides = np.sort(np.where(owner < 0, -1, mesh.body[owner]), axis=1)
        cross = area_vectors(mesh.points[topology.nodes])
        self._normals = cross / np.linalg.norm(cross, axis=1)[:, None]
        self._smooth: dict[tuple[int, int], _SmoothMovement] = {}

    @cached_property
    def contacts(self) -> tuple[Contact, ...]:
        """Connected pieces of the faces that two bodies share."""
        out: list[Contact] = []
        shared = np.flatnonzero((self._sides[:, 0] >= 0) & (self._sides[:, 0] != self._sides[:, 1]))
        for pair in np.unique(self._sides[shared], axis=0):
            faces = shared[(self._sides[shared] == pair).all(axis=1)]
            rows = np.repeat(np.arange(len(faces)), 3)
            touches = coo_matrix((np.ones(len(rows)), (rows, self._nodes[faces].ravel()))).tocsr()
            piece = connected_components(touches @ touches.T)[1]
            out += [self._contact(faces[piece == k], pair) for k in range(piece.max() + 1)]
        return tuple(out)

    def _contact(self, faces: Index, pair: Index) -> Contact:
        normal, nodes = self._normals[faces[0]], self._nodes[faces]
        sides = distinct_parts(nodes, TRIANGLE_SIDES)
        around = np.unique(sides.rows[sides.times == 1])
        bent = np.linalg.norm(np.cross(self._normals, normal), axis=1) > _EDGE
        edged = [bool(np.isin(around, self._nodes[self._boundary(int(one)) & bent]).all()) for one in pair]
        one, other = (int(k) for k in pair)
        # If the edges of both coincide, either may be the owner: both can only move together.
        owner = one if edged[0] else other if edged[1] else None
        return Contact((one, other), np.unique(nodes), normal, owner)

    def _boundary(self, body: int) -> NDArray[np.bool_]:
        """Which faces (f,) have this body on one side only."""
        return np.asarray((self._sides == body).sum(axis=1) == 1)

    def reconciled(self, moved: Sequence[Array], slack: float) -> list[Array] | tuple[int, int]:
        """Movements (n, 3) of the nodes of each body that agree where bodies touch, from the bodies' own movements; or
        two bodies that cannot agree. slack: differences that are rounding, m."""
        mesh, shape = self._mesh, (len(moved), len(self._mesh.points), 3)
        # For every body at all nodes, NaN where it has none: its own movement, and the correction.
        own, added = np.full(shape, np.nan), np.full(shape, np.nan)
        for number, nodes in enumerate(mesh.nodes_of_bodies):
            own[number, nodes] = moved[number]
        for contact in self.contacts:
            one, other = contact.bodies
            difference = own[one, contact.nodes] - own[other, contact.nodes]
            size = float(np.abs(difference).max())
            across = float(np.abs(difference @ contact.normal).max())
            if size > slack and (contact.edges_of is None or across > _SAME_PLANE * size + slack):
                return contact.bodies
            follower, wanted = (other, difference) if contact.owner == one else (one, -difference)
            before = added[follower, contact.nodes]
            if np.nanmax(np.abs(before - wanted), initial=0.0) > slack:
                return contact.bodies
            added[follower, contact.nodes] = np.where(np.isnan(before), wanted, before)
        for contact in self.contacts:
            rest = added[contact.owner, contact.nodes]
            added[contact.owner, contact.nodes] = np.where(np.isnan(rest), 0.0, rest)
        out = []
        for number, nodes in enumerate(mesh.nodes_of_bodies):
            values, wanted = moved[number], added[number, nodes]
            fixed = np.flatnonzero(~np.isnan(wanted[:, 0]))
            if np.abs(wanted[fixed]).max(initial=0.0) > slack:
                correction = self._movement(number, fixed).of(wanted[fixed], slack)
                if correction is None:
                    return next(contact.bodies for contact in self.contacts if number in contact.bodies)
                values = values + correction
            out.append(values)
        return out

    def surface(self, number: int) -> tuple[Index, Array]:
        """Faces of a body: numbers (f, 3) of their corners among its nodes, and unit normals (f, 3)."""
        faces = self._boundary(number)
        triangles = np.searchsorted(self._mesh.nodes_of_bodies[number], self._nodes[faces])
        return triangles, self._normals[faces]

    def carried(self, number: int, surface: Array, slack: float) -> Array | None:
        """Smooth movement (n, 3) of the nodes of a body, from the components across the faces of the movements
        (f, 3, 3) of their corners; None where faces that meet would part."""
        across = np.einsum("fkd,fd->fk", surface, self.surface(number)[1])
        return self._movement(number, np.zeros(0, int)).of(np.zeros((0, 3)), slack, across)

    def _movement(self, number: int, fixed: Index) -> _SmoothMovement:
        """Smooth movements of a body. fixed: the nodes with given movements, none or the nodes in contacts, by their
        numbers in the body."""
        known = self._smooth.get((number, len(fixed)))
        if known is None:
            mesh = self._mesh
            nodes = mesh.nodes_of_bodies[number]
            tets = np.searchsorted(nodes, mesh.tets[mesh.body == number])
            known = _SmoothMovement(mesh.points[nodes], tets, *self.surface(number), fixed)
            self._smooth[number, len(fixed)] = known
        return known


class _SmoothMovement:
    """Smooth movements of the nodes of one body, given at fixed nodes, and elsewhere across its surface only."""

    def __init__(self, points: Array, tets: Index, triangles: Index, normals: Array, fixed: Index) -> None:
        self._fixed, self._triangles, self._normals = fixed, triangles, normals
        count = len(points)
        is_fixed = np.zeros(count, bool)
        is_fixed[fixed] = True
        along, self._across = _planes(triangles, normals, count)
        free = [along.get(node, np.eye(3)) for node in np.flatnonzero(~is_fixed).tolist()]
        # (3 n, r): takes the unknowns to coordinates of the nodes.
        here = 3 * np.flatnonzero(~is_fixed)[:, None] + np.arange(3)
        place = csc_matrix(
            (np.ones(here.size), (here.ravel(), np.arange(here.size))), shape=(3 * count, here.size)
        )
        self._basis = csc_matrix(place @ block_diag(free, format="csc"))
        self._matrix = csc_matrix(kron(_stiffness(points, tets), identity(3)))
        self._factor = splu(csc_matrix(self._basis.T @ self._matrix @ self._basis))

    def of(self, values: Array, slack: float, across: Array | float = 0.0) -> Array | None:
        """Movement (n, 3) of all nodes, from the movement of the fixed nodes (m, 3) and the movement across faces of
        their corners (f, 3); None where these do not agree."""
        out = np.zeros((self._matrix.shape[0] // 3, 3))
        pushes = self._normals[:, None] * np.broadcast_to(across, self._triangles.shape)[..., None]
        np.add.at(out, self._triangles, pushes)
        out = np.einsum("nij,nj->ni", self._across, out)
        out[self._fixed] = values
        left = np.abs(np.einsum("fkd,fd->fk", out[self._triangles], self._normals) - across)
        if left.max() > _SAME_PLANE * np.abs(out).max() + slack:
            return None
        right = -(self._basis.T @ (self._matrix @ out.ravel()))
        return out + (self._basis @ self._factor.solve(right)).reshape(-1, 3)


def _planes(triangles: Index, normals: Array, count: int) -> tuple[dict[int, Array], Array]:
    """For each node of a surface the directions (3, r) that lie in all faces that meet there, and the pseudo-inverse
    (n, 3, 3) of the sum of n n^T over the normals of these faces."""
    nodes = triangles.ravel()
    order = np.argsort(nodes, kind="stable")
    at = np.repeat(normals, 3, axis=0)[order]
    squares = np.zeros((count, 3, 3))
    np.add.at(squares, nodes[order], at[:, :, None] * at[:, None, :])
    values, vectors = np.linalg.eigh(squares)
    flat = values < np.maximum(_SAME_PLANE * values[:, 2:], 1e-300)
    inverse = np.where(flat, 0.0, 1 / np.where(flat, 1.0, values))
    along = {int(k): vectors[k][:, flat[k]] for k in np.unique(nodes)}
    return along, np.einsum("nij,nj,nkj->nik", vectors, inverse, vectors)


def _stiffness(points: Array, tets: Index) -> coo_matrix:
    """Matrix (n, n) of the sum over elements of |grad w|^2."""
    gradients = barycentric_gradients(points[tets])
    local = gradients @ np.swapaxes(gradients, 1, 2)
    rows, columns = np.broadcast_arrays(tets[:, :, None], tets[:, None, :])
    shape = (len(points), len(points))
    return coo_matrix((local.ravel(), (rows.ravel(), columns.ravel())), shape=shape)


# Nodes that two bodies share, and that both move, agree within this share of the device's size.
_AGREE = 1e-12


class MovedBodies:
    """The mesh of a device whose bodies move or change their size."""

    def __init__(self, device: Device, mesh: IronMesh, topology: Faces) -> None:
        self._device, self._mesh, self._topology = device, mesh, topology

    @cached_property
    def _contacts(self) -> Contacts:
        return Contacts(self._mesh, self._topology)

    def velocities(self, change: Change) -> Array:
        """Velocities (n, 3) of the points of the mesh per unit of a key; raises as `points`."""
        above, below = self.points(change)
        return (above - below) / change.width

    def points(self, change: Change) -> tuple[Array, Array]:
        """Points (n, 3) of the mesh with a key above and below its value.

        Raises InputError for bodies of other shapes than boxes, cylinders, rings and spheres unless they only move, and
        as a whole; for bodies that part from a body that they touch, or slide along it without edges around the
        contact; and for joints.
        """
        if self._mesh.sheets:
            raise _refused(change, "must not move bodies of a device with joints", "joints")
        return self._points(change.above, change), self._points(change.below, change)

    def _points(self, other: Device, change: Change) -> Array:
        mesh, pairs = self._mesh, zip(self._device.bodies, other.bodies, strict=True)
        slack = _AGREE * float(np.ptp(mesh.points, axis=0).max())
        moved = [self._of_body(number, *pair, change, slack) for number, pair in enumerate(pairs)]
        found = self._contacts.reconciled(moved, slack)
        named = [f"'{mesh.body_names[k]}'" for k in found] if isinstance(found, tuple) else []
        if isinstance(found, list):
            # Movements of all nodes from the movements of the bodies.
            out, known = np.zeros_like(mesh.points), np.zeros(len(mesh.points), bool)
            for nodes, there in zip(mesh.nodes_of_bodies, found, strict=True):
                again = known[nodes]
                if np.abs(out[nodes][again] - there[again]).max(initial=0.0) > slack:
                    named = ["bodies"]
                out[nodes], known[nodes] = there, True
            if not named:
                return mesh.points + out
        must_hold = "must leave bodies that touch in contact, with the edges of one of them around it"
        raise _refused(change, must_hold, f"{' and '.join(named)} part, or their edges cross")

    def _of_body(self, number: int, body: Body, target: Body, change: Change, slack: float) -> Array:
        """Movements (n, 3) of the nodes of a body, whatever it touches."""
        x = self._mesh.points[self._mesh.nodes_of_bodies[number]]
        if same(body.parts, target.parts):
            return np.zeros_like(x)
        pairs = zip(body.parts, target.parts, strict=True)
        maps = [carry for pair in pairs if (carry := _map(*pair)) is not None]
        if len(maps) == len(body.parts):
            moved = [carry(x) - x for carry in maps]
            if all(np.abs(one - moved[0]).max() <= slack for one in moved):
                return moved[0]
            found = self._by_parts(number, body, maps, slack)
            if found is not None:
                return found
        must_hold = "must move a body as a whole, or boxes, cylinders, rings and spheres of which it consists"
        raise _refused(change, must_hold, f"body '{body.name}'")

    def _by_parts(
        self, number: int, body: Body, maps: Sequence[Callable[[Array], Array]], slack: float
    ) -> Array | None:
        """`_of_body` for parts that carry their own surfaces; None if a face lies on no part, or parts separate."""
        triangles, normals = self._contacts.surface(number)
        corners = self._mesh.points[self._mesh.nodes_of_bodies[number]][triangles]
        surface, known = np.zeros_like(corners), np.zeros(corners.shape[:2], bool)
        for part, carry in zip(body.parts, maps, strict=True):
            on = lies_on(part, corners, normals)
            moved = carry(corners) - corners
            # Both parts of a corner must move it alike across the face.
            apart = np.einsum("fkd,fd->fk", moved - surface, normals)[on & known]
            if np.abs(apart).max(initial=0.0) > slack:
                return None
            surface[on], known[on] = moved[on], True
        return self._contacts.carried(number, surface, slack) if known.all() else None


def _map(one: Part, other: Part) -> Callable[[Array], Array] | None:
    """The map of points (..., 3) that moves with a part; None if the part's shape changes without such a map."""
    here, there = one.placement, other.placement
    if same(one.shape, other.shape):
        turn = there.rotation @ here.rotation.T
        return lambda x: x @ turn.T + (there.position - turn @ here.position)
    stretch = _stretch(one, other)
    if stretch is None:
        return None

    return lambda x: stretch((x - here.position) @ here.rotation) @ there.rotation.T + there.position


def _stretch(one: Part, other: Part) -> Callable[[Array], Array] | None:
    """The map of local points to another shape of the same kind; None for kinds without such a map."""
    match one.shape.primitive, other.shape.primitive:
        case Box(size), Box(resized):
            return lambda x: x * (np.array(resized) / np.array(size))
        case Cylinder(radius, height), Cylinder(wider, higher):
            return lambda x: x * [wider / radius, wider / radius, higher / height]
        case Sphere(radius), Sphere(wider):
            return lambda x: x * (wider / radius)
        case Ring(inner, outer, height), Ring(inside, outside, higher):

            def widened(local: Array) -> Array:
                distance = np.hypot(local[..., 0], local[..., 1])
                wanted = inside + (distance - inner) * (outside - inside) / (outer - inner)
                scale = wanted / distance
                return local * np.stack([scale, scale, np.full_like(scale, higher / height)], axis=-1)

            return widened
    return None


def _refused(change: Change, must_hold: str, received: str) -> InputError:
    return InputError.of(
        f"derivative, {change.key}", must_hold, received, "take differences of two solutions"
    )
