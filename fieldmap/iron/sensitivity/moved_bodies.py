"""Bodies that move or change their size: their nodes move with them, and the mesh keeps its topology.

A node has a fixed place in its body, in multiples of the body's dimensions: (x, y, z)/size in a box, (x, y)/radius and
z/height in a cylinder. That carries the whole mesh smoothly along with the shape, its curved faces included. Of a body
of several parts each part carries its own faces, and nodes inside move smoothly between them. Where a body slides along
another one that it touches, its nodes are moved on (`fieldmap.iron.sensitivity.contacts`).

Which part of a body a face of its mesh lies on: parts that change otherwise than together carry their own faces.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fieldmap.device.model import Body, Box, Cylinder, Device, Part, Ring, Sphere
from fieldmap.errors import InputError
from fieldmap.iron.mesh.mesh import IronMesh
from fieldmap.iron.sensitivity.changes import Change, same
from fieldmap.iron.sensitivity.contacts import Contacts
from fieldmap.iron.topology import Faces
from fieldmap.typing import Array

# Of the largest dimension: how far nodes lie off planes. They are on them, but for rounding.
_ON_PLANE = 1e-7
# Of a radius: how far corners of a curved face lie off it, which keep its volume.
_ON_CURVE = 0.05
# Cosine and sine of the angles at which a face lies in a plane, or along an axis.
_ALONG, _ACROSS = 0.999, 0.05


def lies_on(part: Part, corners: Array, normals: Array) -> NDArray[np.bool_]:
    """Which corners (f, 3) of faces, given by corners (f, 3, 3) and unit normals (f, 3), lie on a part's surface, the
    face in one of its planes or curved faces; in a plane of two parts it may reach from one to the other. None lies on
    other parts than boxes, cylinders, rings and spheres.
    """
    turn, shift = part.placement.rotation, part.placement.position
    local, normal = (corners - shift) @ turn, np.abs(normals @ turn)
    match part.shape:
        case Box(size):
            low, high = (
                np.array([-size[0] / 2, -size[1] / 2, 0.0]),
                np.array([size[0] / 2, size[1] / 2, size[2]]),
            )
            slack = _ON_PLANE * max(size)
            inside = ((local > low - slack) & (local < high + slack)).all(axis=2)
            planes = [_in_plane(local, normal, k, at, slack) for k in range(3) for at in (low[k], high[k])]
            return np.asarray(inside & np.any(planes, axis=0)[:, None])
        case Cylinder(radius, height):
            return _on_turned(local, normal, (radius,), 0.0, radius, height)
        case Ring(inner, outer, height):
            return _on_turned(local, normal, (inner, outer), inner, outer, height)
        case Sphere(radius):
            near = _is_near(np.linalg.norm(local, axis=2), radius)
            return np.repeat(near[:, None], 3, axis=1)
    return np.zeros(corners.shape[:2], bool)


def _on_turned(
    local: Array, normal: Array, radii: tuple[float, ...], inner: float, outer: float, height: float
) -> NDArray[np.bool_]:
    """On a solid of revolution with these radii between z = 0 and its height."""
    distance, slack = np.hypot(local[..., 0], local[..., 1]), _ON_PLANE * max(outer, height)
    within = (local[..., 2] > -slack) & (local[..., 2] < height + slack)
    ends = _in_plane(local, normal, 2, 0.0, slack) | _in_plane(local, normal, 2, height, slack)
    reached = (distance >= inner * (1 - _ON_CURVE)) & (distance < outer * (1 + _ON_CURVE))
    curved = np.any([_is_near(distance, radius) for radius in radii], axis=0) & (normal[:, 2] < _ACROSS)
    return np.asarray(within & (ends[:, None] & reached | curved[:, None]))


def _is_near(distance: Array, radius: float) -> NDArray[np.bool_]:
    return np.asarray((np.abs(distance - radius) < _ON_CURVE * radius).all(axis=1))


def _in_plane(local: Array, normal: Array, axis: int, at: float, slack: float) -> NDArray[np.bool_]:
    return np.asarray((np.abs(local[..., axis] - at) < slack).all(axis=1) & (normal[:, axis] > _ALONG))


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
        as a whole, for bodies that part from what they touch, or slide along it where the edges of neither bound the
        contact, and for joints.
        """
        if self._mesh.sheets:
            raise _refused(change, "must not move bodies of a device with joints", "joints")
        above, below = change.sides
        return self._points(above, change), self._points(below, change)

    def _points(self, other: Device, change: Change) -> Array:
        mesh, pairs = self._mesh, zip(self._device.bodies, other.bodies, strict=True)
        slack = _AGREE * float(np.ptp(mesh.points, axis=0).max())
        moved = [self._of_body(number, *pair, change, slack) for number, pair in enumerate(pairs)]
        out, apart = self._joined(moved)
        if apart > slack:
            found = self._contacts.reconciled(moved, slack)
            if isinstance(found, list):
                out, apart = self._joined(found)
            if isinstance(found, tuple) or apart > slack:
                named = [f"'{mesh.body_names[k]}'" for k in found] if isinstance(found, tuple) else ["bodies"]
                must_hold = "must leave bodies that touch in contact, with the edges of one of them around it"
                raise _refused(change, must_hold, f"{' and '.join(named)} part, or their edges cross")
        return mesh.points + out

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
        """The same of a body whose parts carry their own surfaces; None where these are not known, or part."""
        triangles, normals = self._contacts.surface(number)
        corners = self._mesh.points[self._mesh.nodes_of_bodies[number]][triangles]
        surface, known = np.zeros_like(corners), np.zeros(corners.shape[:2], bool)
        for part, carry in zip(body.parts, maps, strict=True):
            on = lies_on(part, corners, normals)
            moved = carry(corners) - corners
            # What lies on two parts must not be torn between them.
            apart = np.einsum("fkd,fd->fk", moved - surface, normals)[on & known]
            if np.abs(apart).max(initial=0.0) > slack:
                return None
            surface[on], known[on] = moved[on], True
        return self._contacts.carried(number, surface, slack) if known.all() else None

    def _joined(self, moved: Sequence[Array]) -> tuple[Array, float]:
        """Movements (n, 3) of all nodes from those of the bodies', and by how much these differ where bodies touch."""
        out, known, apart = np.zeros_like(self._mesh.points), np.zeros(len(self._mesh.points), bool), 0.0
        for nodes, there in zip(self._mesh.nodes_of_bodies, moved, strict=True):
            again = known[nodes]
            apart = max(apart, float(np.abs(out[nodes][again] - there[again]).max(initial=0.0)))
            out[nodes], known[nodes] = there, True
        return out, apart


def _map(one: Part, other: Part) -> Callable[[Array], Array] | None:
    """How a part carries points (..., 3); None where its shape changes and has no such map."""
    here, there = one.placement, other.placement
    if same(one.shape, other.shape):
        turn = there.rotation @ here.rotation.T
        return lambda x: x @ turn.T + (there.position - turn @ here.position)
    stretch = _stretch(one, other)
    if stretch is None:
        return None

    return lambda x: stretch((x - here.position) @ here.rotation) @ there.rotation.T + there.position


def _stretch(one: Part, other: Part) -> Callable[[Array], Array] | None:
    """How local points follow the dimensions of another shape of the same kind; None for kinds without such a map."""
    match one.shape, other.shape:
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
    remedy = "take differences of two solutions"
    return InputError.of(f"derivative, {change.key}", must_hold, received, remedy)
