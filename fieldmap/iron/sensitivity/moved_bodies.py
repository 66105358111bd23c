"""Bodies that move or change their size: their nodes move with them, and the mesh keeps its topology.

A node has a fixed place in its body, in multiples of the body's dimensions: (x, y, z)/size in a box, (x, y)/radius and
z/height in a cylinder. That carries the whole mesh smoothly along with the shape, its curved faces included. Where a
body slides along another one that it touches, its nodes are moved on (`fieldmap.iron.sensitivity.contacts`).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from fieldmap.device.model import Body, Box, Cylinder, Device, Part, Ring, Sphere
from fieldmap.errors import InputError, Problem
from fieldmap.iron.mesh.mesh import IronMesh
from fieldmap.iron.mesh.topology import Faces
from fieldmap.iron.sensitivity.changes import Change, same
from fieldmap.iron.sensitivity.contacts import Contacts
from fieldmap.typing import Array

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

        Raises InputError for bodies of several parts that change otherwise than as a whole, of other shapes than boxes,
        cylinders, rings and spheres unless they only move, for bodies that part from what they touch, or slide along it
        where the edges of neither bound the contact, and for joints.
        """
        if self._mesh.sheets:
            raise _refused(change, "must not move bodies of a device with joints", "joints")
        above, below = change.sides
        return self._points(above, change), self._points(below, change)

    def _points(self, other: Device, change: Change) -> Array:
        mesh, bodies = self._mesh, zip(self._device.bodies, other.bodies, strict=True)
        moved = [
            np.zeros((len(nodes), 3))
            if _alike(body, target)
            else _carried(mesh.points[nodes], body, target, change) - mesh.points[nodes]
            for nodes, (body, target) in zip(mesh.nodes_of_bodies, bodies, strict=True)
        ]
        slack = _AGREE * float(np.ptp(mesh.points, axis=0).max())
        out, apart = self._joined(moved)
        if apart > slack:
            found = self._contacts.reconciled(moved, slack)
            if isinstance(found, list):
                out, apart = self._joined(found)
            if isinstance(found, tuple) or apart > slack:
                names = (
                    " and ".join(f"'{mesh.body_names[k]}'" for k in found)
                    if isinstance(found, tuple)
                    else "three"
                )
                must_hold = "must leave bodies that touch in contact, with the edges of one of them around it"
                raise _refused(change, must_hold, f"{names} part, or their edges cross")
        return mesh.points + out

    def _joined(self, moved: Sequence[Array]) -> tuple[Array, float]:
        """Movements (n, 3) of all nodes from those of the bodies', and by how much these differ where bodies touch."""
        out, known, apart = np.zeros_like(self._mesh.points), np.zeros(len(self._mesh.points), bool), 0.0
        for nodes, there in zip(self._mesh.nodes_of_bodies, moved, strict=True):
            again = known[nodes]
            apart = max(apart, float(np.abs(out[nodes][again] - there[again]).max(initial=0.0)))
            out[nodes], known[nodes] = there, True
        return out, apart


def _alike(one: Body, other: Body) -> bool:
    return same(one.parts, other.parts)


def _carried(x: Array, body: Body, target: Body, change: Change) -> Array:
    """Points (n, 3) of a body, carried along."""
    if len(body.parts) == 1:
        one, other = body.parts[0], target.parts[0]
        local = _stretched((x - one.placement.position) @ one.placement.rotation, one, other)
        if local is not None:
            return local @ other.placement.rotation.T + other.placement.position
    carriers = [_rigid(one, other) for one, other in zip(body.parts, target.parts, strict=True)]
    first = carriers[0]
    if first is None or not all(
        carrier is not None
        and np.allclose(carrier[0], first[0], atol=1e-12)
        and np.allclose(carrier[1], first[1], atol=1e-12)
        for carrier in carriers
    ):
        must_hold = "must move a body as a whole, or change the size of a box, cylinder, ring or sphere"
        raise _refused(change, must_hold, f"body '{body.name}'")
    turn, shift = first
    return x @ turn.T + shift


def _rigid(one: Part, other: Part) -> tuple[Array, Array] | None:
    """Rotation and shift that carry a part to its other place; None where its shape changes."""
    if not same(one.shape, other.shape):
        return None
    turn = other.placement.rotation @ one.placement.rotation.T
    return turn, other.placement.position - turn @ one.placement.position


def _stretched(local: Array, one: Part, other: Part) -> Array | None:
    """Local points with the dimensions of another shape of the same kind; None for kinds that have no such map."""
    match one.shape, other.shape:
        case Box(size), Box(resized):
            return local * (np.array(resized) / np.array(size))
        case Cylinder(radius, height), Cylinder(wider, higher):
            return local * [wider / radius, wider / radius, higher / height]
        case Sphere(radius), Sphere(wider):
            return local * (wider / radius)
        case Ring(inner, outer, height), Ring(inside, outside, higher):
            distance = np.hypot(local[:, 0], local[:, 1])
            wanted = inside + (distance - inner) * (outside - inside) / (outer - inner)
            scale = wanted / distance
            return np.column_stack(
                [local[:, 0] * scale, local[:, 1] * scale, local[:, 2] * (higher / height)]
            )
    return None


def _refused(change: Change, must_hold: str, received: str) -> InputError:
    remedy = "take differences of two solutions"
    return InputError(Problem(f"derivative, {change.key}", must_hold, received, remedy))
