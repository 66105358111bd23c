"""Bodies that move or change their size: their nodes move with them, and the mesh keeps its topology.

A node has a fixed place in its body, in multiples of the body's dimensions: (x, y, z)/size in a box, (x, y)/radius and
z/height in a cylinder. That carries the whole mesh smoothly along with the shape, its curved faces included. The
derivative of the equations by the nodes is the central difference of the residual at the frozen state, on the two moved
meshes: two assemblies of what moved, and no solve. With R the residual of the potential form and lambda an adjoint,

    lambda . R = inside(lambda, phi) - lambda . S phi,      S = M^T (W^-1 - N^-1) M,

and for q = W^-1 M phi (charges) and z, the smoothest potential with the face means M phi,

    d(lambda . S phi) = -q_lambda . dW q_phi - z_lambda . dK z_phi,

with K the stiffness at mu_r = 1 (`fieldmap.iron.operators.exterior`). What is seen through the charges at points
follows W in the same way.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fieldmap.device.model import Body, Box, Cylinder, Device, Part, Ring, Sphere
from fieldmap.errors import InputError, Problem
from fieldmap.iron.elements.bh_law import Magnetisation
from fieldmap.iron.elements.nodal_elements import CoilField, NodalElements
from fieldmap.iron.elements.potential_form import PotentialForm
from fieldmap.iron.mesh.mesh import IronMesh
from fieldmap.iron.operators.surface import ChargedFaces
from fieldmap.iron.quantities.linkage import linkage_and_coenergy
from fieldmap.iron.sensitivity.changes import Change, same
from fieldmap.iron.sensitivity.quantities import Weights
from fieldmap.records import Record
from fieldmap.sources import unit_flux_densities
from fieldmap.typing import Array

# Nodes that two bodies share, and that both move, agree within this share of the device's size.
_AGREE = 1e-12


def moved_points(mesh: IronMesh, device: Device, change: Change) -> tuple[Array, Array]:
    """Points (n, 3) of the mesh of a device with a key above and below its value.

    Raises InputError for bodies of several parts that change otherwise than as a whole, of other shapes than boxes,
    cylinders, rings and spheres unless they only move, for bodies that touch others which do not follow, and for
    joints.
    """
    if mesh.sheets:
        raise _refused(change, "must not move bodies of a device with joints", "joints")
    above, below = change.sides
    return tuple(_points(mesh, device, side, change) for side in (above, below))  # type: ignore[return-value]


def _points(mesh: IronMesh, device: Device, other: Device, change: Change) -> Array:
    out, moved = mesh.points.copy(), np.zeros(len(mesh.points), bool)
    size = float(np.ptp(mesh.points, axis=0).max())
    for number, (body, target) in enumerate(zip(device.bodies, other.bodies, strict=True)):
        nodes = np.unique(mesh.tets[mesh.body == number])
        there = (
            mesh.points[nodes] if _alike(body, target) else _carried(mesh.points[nodes], body, target, change)
        )
        known = moved[nodes]
        if np.abs(out[nodes][known] - there[known]).max(initial=0.0) > _AGREE * size:
            must_hold = "must move bodies that touch together"
            raise _refused(change, must_hold, f"'{body.name}' and a body that it touches part")
        out[nodes], moved[nodes] = there, True
    return out


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


@dataclass(frozen=True, eq=False, repr=False)
class FrozenState(Record):
    """What stays as it is when the mesh moves: nodal potential (n,), material of one source, currents (c,)."""

    device: Device
    currents: Array
    potential: Array
    material: Magnetisation


@dataclass(frozen=True, eq=False, repr=False)
class Adjoint(Record):
    """Adjoint potentials (n, k) of k numbers that follow the samples at points by weights."""

    potential: Array
    points: Array
    weights: Weights


class MovedMesh:
    """A mesh on both sides of a change, and what of the equations follows it."""

    def __init__(self, form: PotentialForm, state: FrozenState, change: Change) -> None:
        self._form, self._state, self._width = form, state, change.width
        mesh, topology = form.iron.mesh, form.iron.topology
        sides = moved_points(mesh, state.device, change)
        triangles = topology.nodes[topology.surface]
        moving = np.any([(points != mesh.points).any(axis=1) for points in sides], axis=0)
        # Pairs of faces that stay need not be looked at: they stand first.
        stays = ~moving[triangles].any(axis=1)
        self._order = np.argsort(~stays, kind="stable")
        self._first = int(stays.sum())
        self._elements = [
            NodalElements.from_mesh(replace(mesh, points=points, symmetry=None), topology) for points in sides
        ]
        self._faces = [ChargedFaces.from_nodes(points, triangles) for points in sides]
        potential = state.potential[:, None]
        self._charges = np.ascontiguousarray(form.charges(potential)[:, 0])
        self._smooth = np.ascontiguousarray(form.smoothest(potential)[:, 0])
        unit = [self._unit_field(elements) for elements in self._elements]
        fields = [self._applied(elements, one) for elements, one in zip(self._elements, unit, strict=True)]
        # What multiplies the adjoint: the residual at the frozen potential, the mean potentials of the frozen charges,
        # and the stiffness times the frozen smooth potential.
        self._inside = self._difference([self._residual(k, fields[k]) for k in (0, 1)])
        self._means = self._difference([self._potentials(faces) for faces in self._faces])
        self._stiff = self._difference([self._stiffness(elements) for elements in self._elements])
        self._linked = self._difference([self._linkage(k, fields[k], unit[k]) for k in (0, 1)])

    def _difference(self, sides: list[Array]) -> Array:
        return np.asarray((sides[0] - sides[1]) / self._width)

    def _unit_field(self, elements: NodalElements) -> CoilField:
        coils = self._state.device.coils
        return elements.coil_field(lambda x: unit_flux_densities(coils, x))

    def _applied(self, elements: NodalElements, unit: CoilField) -> CoilField:
        currents, background = self._state.currents, self._state.device.background
        field = CoilField(
            np.einsum("c,ced->ed", currents, unit.constant)[None], (currents @ unit.bubble)[None]
        )
        if background is None:
            return field
        more = elements.coil_field(lambda x: background.field(x)[None])
        return CoilField(field.constant + more.constant, field.bubble + more.bubble)

    def _residual(self, side: int, field: CoilField) -> Array:
        state = self._state
        vectors = self._elements[side].residual(state.potential, field, 0, state.material)
        return self._form.assembled(vectors)

    def _potentials(self, faces: ChargedFaces) -> Array:
        out = np.empty_like(self._charges)
        ordered = np.ascontiguousarray(self._charges[self._order])
        out[self._order] = faces.part(self._order).mutual_product(ordered, self._first)
        return out

    def _stiffness(self, elements: NodalElements) -> Array:
        """K z at mu_r = 1 (n,)."""
        nothing = Magnetisation(
            self._state.material.law,
            self._state.material.tables,
            np.zeros_like(self._state.material.remanence),
        )
        # With t = grad z and phi = z there is no h: what is left of the residual is -int grad z . grad v.
        source = CoilField(np.zeros((1, len(elements.volume), 3)), self._smooth[None])
        return -self._form.assembled(elements.residual(self._smooth, source, 0, nothing))

    def _linkage(self, side: int, field: CoilField, unit: CoilField) -> Array:
        """What the iron adds to the linkages (c,) with the frozen potential."""
        elements, state = self._elements[side], self._state
        linkage, _ = linkage_and_coenergy(
            elements.volume,
            state.material,
            elements.strength_at_points(state.potential[:, None], field, state.material),
            elements.coil_field_at_points(field),
            elements.coil_field_at_points(unit),
        )
        return linkage[:, 0]

    def derivative(self, adjoint: Adjoint) -> Array:
        """What the movement adds to the derivatives (k,)."""
        form, weights = self._form, adjoint.weights
        charges = form.charges(adjoint.potential)
        total = adjoint.potential.T @ self._inside + form.smoothest(adjoint.potential).T @ self._stiff
        if len(adjoint.points):
            points = np.ascontiguousarray(adjoint.points)
            by_density = form.iron.surface.weights(points, weights.field, weights.gradient)
            charges = charges - form.iron.mutual.solve(by_density.T / form.iron.surface.areas[:, None], 2)
            total += self._difference([self._seen(faces, points, weights) for faces in self._faces])
        return np.asarray(total + charges.T @ self._means + weights.linkage @ self._linked)

    def _seen(self, faces: ChargedFaces, points: Array, weights: Weights) -> Array:
        """Sums (k,) over the field of the frozen charges at the points."""
        field, gradient = faces.field_and_gradient(points, (self._charges / faces.areas)[None])
        return np.einsum("knd,nd->k", weights.field, field[0]) + np.einsum(
            "knij,nij->k", weights.gradient, gradient[0]
        )
