"""Derivatives of a state by the nodes of its mesh: one pass over elements and pairs of faces, for any movement.

With R the residual of the potential form and lambda an adjoint,

    lambda . R = inside(lambda, phi) - lambda . S phi,      S = M^T (W^-1 - N^-1) M,

and for q = W^-1 M phi (charges) and z, the smoothest potential with the face means M phi,

    d(lambda . S phi) = -q_lambda . dW q_phi - z_lambda . dK z_phi,

with K the stiffness at mu_r = 1 (`fieldmap.iron.elements.potential_form`). Fields at points depend on W through the
charges in the same way, and on the places of the charges.

Within an element that is deformed by the velocity gradient L, gradients a of potentials and circulations change by
-L^T a and the volume by tr L, so that an integral changes by P : L with a matrix P,

    int (M . u),      P = (M . u) 1 - h (db/dh - 1) u - u M,        int (a . b),      P = (a . b) 1 - a b - b a,

with mu0 M the polarisation at mu0 H = h. The field of the coils, which has no curl there, also changes by the gradient
of B . v in a movement v. Its circulation along an edge depends on the edge's ends alone, but for the quadrature error,
which matters close to a winding.

One pass over the pairs of faces gives the derivatives of sums over mutual potentials by all nodes. If operations a map
the mesh onto itself, only pairs with a face i in one chamber are computed,

    sum_ij x_i y_j G(i, j)  =  sum_a sum_(i in the chamber) sum_j x_ai y_aj G(ai, aj),

where the derivative of G(ai, aj) is the derivative of G(i, j), turned by a. Charges need not have the symmetry.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fieldmap.constants import MU0
from fieldmap.device.coils import Coil
from fieldmap.device.model import Device
from fieldmap.iron.elements.nodal_elements import POINTS_PER_HALF, half_rule
from fieldmap.iron.elements.potential_form import PotentialForm
from fieldmap.iron.mesh.chamber import MeshSymmetry
from fieldmap.iron.mesh.charged_faces import NEAR_DEGREE, NEAR_RADII, TOUCH_DEGREE, ChargedFaces
from fieldmap.iron.operators.mutual import face_images
from fieldmap.iron.sensitivity.quantities import Weights
from fieldmap.kernels.iron.mutual_gradient import close_gradient, far_pulls
from fieldmap.kernels.simplex_rules import triangle_rule
from fieldmap.records import Record
from fieldmap.sources import unit_flux_densities, unit_flux_density_and_gradient
from fieldmap.threads import over_rows
from fieldmap.typing import Array, Index

# Number of parts into which the close pairs are divided, for threads.
_SHARES = 16
# Triangles whose far pairs are computed at once: 12 MB for a mesh of 10 000.
_ROWS = 16


def mutual_gradient(
    faces: ChargedFaces,
    nodes: Index,
    count: int,
    charge: Array,
    others: Array,
    moving: NDArray[np.bool_],
    symmetry: MeshSymmetry | None = None,
) -> Array:
    """Derivatives (k, count, 3) of others (k, n) . W charge (n,) by the faces' corners, in 1/m^2 times the charges'
    units. nodes (n, 3): numbers of the corners among `count` nodes. Correct for nodes whose faces are all marked as
    moving (n,). symmetry: of the mesh; charges and movements need not have it."""
    if symmetry is None:
        images, places, matrices = np.arange(len(charge))[None], np.arange(count)[None], np.eye(3)[None]
    else:
        # In C order: numba would compile another kernel for another order.
        images, places = face_images(symmetry, nodes), np.ascontiguousarray(symmetry.node_images)
        matrices = symmetry.group.matrices
    first, moves = images.min(axis=0), moving[images]
    charges, of_others = charge[images], np.ascontiguousarray(others[:, images].swapaxes(0, 1))
    geometry, spheres = faces.kernel_geometry(), faces.spheres()
    shapes = (triangle_rule(NEAR_DEGREE)[0], triangle_rule(TOUCH_DEGREE)[0])
    parts = np.zeros((_SHARES, count, len(others), 3))
    any_moves = moves.any(axis=0)
    given = (geometry, shapes, spheres, NEAR_RADII, nodes, first, any_moves)
    # Ten units of `over_rows` for each pair of a part.
    work = 10.0 * np.count_nonzero(first == np.arange(len(first))) * len(first) / _SHARES
    over_rows(close_gradient, _SHARES, *given, charges, of_others, places, matrices, parts, work=work)
    out = np.ascontiguousarray(parts.sum(axis=0).transpose(1, 0, 2))
    rows = np.flatnonzero(any_moves & (first == np.arange(len(first))))
    used = np.flatnonzero(moves[:, rows].any(axis=1))
    for a, part in zip(
        used, _of_far_pairs(faces, nodes, count, rows, charges[used], of_others[used]), strict=True
    ):
        out[:, places[a]] += part @ matrices[a].T
    return out


def _of_far_pairs(
    faces: ChargedFaces, nodes: Index, count: int, rows: Index, charges: Array, others: Array
) -> Array:
    """The far pairs' part of these derivatives (g, k, count, 3), by the corners of some faces, for charges (g, n) and
    others (g, k, n)."""
    shapes, points = triangle_rule(2)[0], faces.far_points().reshape(3, -1, 3)
    points, spheres = np.ascontiguousarray(points.swapaxes(1, 2)), faces.spheres()
    every = np.concatenate([charges[:, None], others], axis=1)
    columns = np.ascontiguousarray(every.reshape(-1, every.shape[2]).T)
    pulls = np.empty((_ROWS, 3, 3, len(columns)))
    by_corner = np.empty((len(rows), 3, *others.shape[:2], 3))
    for start in range(0, len(rows), _ROWS):
        here = slice(start, start + _ROWS)
        chosen = rows[here]
        block = pulls[: len(chosen)]
        over_rows(far_pulls, len(chosen), chosen, points, spheres, NEAR_RADII, block, work=9.0 * len(columns))
        sums = (block.reshape(-1, len(columns)) @ columns).reshape(len(chosen), 3, 3, *every.shape[:2])
        pull = np.einsum("qc,rqdgk->rcgkd", shapes, sums) / (36 * np.pi)
        own = every[:, :, chosen].transpose(2, 0, 1)[:, None, :, :, None]
        by_corner[here] = own[..., 1:, :] * pull[..., :1, :] + own[..., :1, :] * pull[..., 1:, :]
    at, flat = nodes[rows].ravel(), by_corner.reshape(3 * len(rows), -1)
    out = np.array([np.bincount(at, column, count) for column in flat.T])
    return np.ascontiguousarray(out.reshape(*others.shape[:2], 3, count).swapaxes(2, 3))


# An edge is close to a coil if the coil's field changes by more than this share of itself along half of the edge. On
# other edges the rule for circulations, four points in each half, is accurate enough: relative errors of derivatives
# are 2e-8, and 5e-7 with 0.3 in place of 0.1 (core and magnet, a coarse mesh whose core stands 1 mm from its winding).
_CHANGES = 0.1


@dataclass(frozen=True, eq=False, repr=False)
class SolvedIron(Record):
    """A state of one source: nodal potential (n,), currents (c,); field strength and polarisation at the points of the
    elements (e, 4, 3), T; share (e, 1, 1): volume of each point."""

    device: Device
    currents: Array
    potential: Array
    strength: Array
    polarisation: Array
    share: Array


@dataclass(frozen=True, eq=False, repr=False)
class Adjoint(Record):
    """Adjoint potentials (n, k) of k numbers, which depend on samples at points by weights. cover (k, e, 4, 3):
    gradients of these potentials plus weighted fields of the coils, times the volume of each point; turned: db/dh - 1
    times cover."""

    potential: Array
    points: Array
    weights: Weights
    cover: Array
    turned: Array


class ByNodes:
    """Derivatives of a state by the nodes of its mesh that are `moving` (n,)."""

    def __init__(self, form: PotentialForm, state: SolvedIron, moving: NDArray[np.bool_]) -> None:
        self._form, self._state = form, state
        elements, topology = form.elements, form.iron.topology
        self._triangles = topology.nodes[topology.surface]
        self._faces_moving: NDArray[np.bool_] = np.any(moving[self._triangles], axis=1)
        self._moving_edges = moving[elements.edges].any(axis=1)
        # Where the coils' fields are needed: the ends of these edges and their middles.
        ends = np.zeros(len(moving), bool)
        ends[elements.edges[self._moving_edges]] = True
        self._needed = np.concatenate([ends, self._moving_edges])
        self._rests: dict[int, tuple[Index, Array]] = {}

    @cached_property
    def _unit(self) -> Array:
        """Fields (c, n, 3) of one ampere in each coil at the nodes that move and their neighbours; zero
        elsewhere."""
        at, moving = self._nodes, self._needed
        out = np.zeros((len(self._state.currents), *at.shape))
        out[:, moving] = unit_flux_densities(self._state.device.coils, np.ascontiguousarray(at[moving]))
        return out

    @cached_property
    def _background(self) -> Array:
        """Field (n, 3) of the background at these nodes."""
        out, needed, background = np.zeros_like(self._nodes), self._needed, self._state.device.background
        if background is not None:
            out[needed] = background.field(np.ascontiguousarray(self._nodes[needed]))
        return out

    @cached_property
    def _nodes(self) -> Array:
        elements = self._form.elements
        return np.concatenate([elements.points, elements.points[elements.edges].mean(axis=1)])

    @cached_property
    def _charges(self) -> Array:
        return np.ascontiguousarray(self._form.exterior.charge(self._state.potential[:, None])[:, 0])

    @cached_property
    def _gradients(self) -> tuple[Array, Array]:
        """Gradients (e, 4, 3) of the potential, and of the smoothest one with its face means."""
        potential = self._state.potential[:, None]
        pair = np.column_stack([potential, self._form.exterior.smoothest(potential)])
        own, smooth = self._form.elements.point_gradients(pair)
        return own, smooth

    def of_coil(self, c: int, adjoint: Adjoint) -> Array:
        """The part of coil c's field in the derivatives by the nodes (k, n, 3). A motion of the coil has the opposite
        sign."""
        return self._by_coils(adjoint, np.arange(len(self._state.currents)) == c)

    def derivative(self, adjoint: Adjoint) -> Array:
        """Derivatives by the nodes (k, n, 3)."""
        every = np.ones(len(self._state.currents), bool)
        by_coils = self._by_coils(adjoint, every, self._background)
        return self._by_elements(adjoint) + by_coils + self._by_faces(adjoint)

    def _by_elements(self, adjoint: Adjoint) -> Array:
        elements, state = self._form.elements, self._state
        of, smoothest = (
            state.share * elements.point_gradients(values)
            for values in (adjoint.potential, self._form.exterior.smoothest(adjoint.potential))
        )
        own, smooth = self._gradients
        total = _trace(state.polarisation, adjoint.cover) - _outer(adjoint.cover, state.polarisation)
        total -= _outer(state.strength, adjoint.turned)
        for sign, one, other in ((-1.0, own, of), (1.0, smooth, smoothest)):
            total += sign * (_trace(one, other) - _outer(one, other) - _outer(other, one))
        forces = np.einsum("keab,eib->keia", total, elements.gradients, optimize=True)
        return _on_nodes(forces, elements.nodes[:, :4], len(elements.points))

    def _by_coils(self, adjoint: Adjoint, coils: NDArray[np.bool_], more: Array | float = 0.0) -> Array:
        """The part of some coils (c,), and of a field more (n, 3) at the nodes, in the derivatives (k, n, 3)."""
        state = self._state
        out = self._by_field(adjoint.turned, state.currents[None] * coils, more)
        linkage = adjoint.weights.linkage / MU0 * coils
        if linkage.any():
            out += self._by_field((state.share * state.polarisation)[None], linkage)
        return out

    def _by_field(self, vectors: Array, amperes: Array, more: Array | float = 0.0) -> Array:
        """Derivatives by the nodes (k, n, 3) of sums of vectors (k, e, 4, 3) times a field: of amperes (k, coils) in
        the coils, plus more (n, 3) at the nodes. k may be 1 on either side."""
        elements = self._form.elements
        out = elements.tested(vectors)[..., None] * (np.tensordot(amperes, self._unit, 1) + more)
        corners = len(elements.points)
        ends = np.repeat(0.5 * out[:, corners:, None], 2, axis=2)
        halves = np.stack(elements.tested_by_circulations(vectors), axis=2)
        for c in np.flatnonzero(amperes.any(axis=0)).tolist():
            edges, rest = self._rest(c)
            follow = np.einsum("kmh,mhsd->kmsd", halves[:, edges], rest)
            ends[:, edges] += amperes[:, c, None, None, None] * follow
        return np.asarray(out[:, :corners] + _on_nodes(ends, elements.edges, corners))

    def _rest(self, c: int) -> tuple[Index, Array]:
        """The edges (m,) close to coil c, and the derivatives (m, 2, 2, 3) of the circulations of its unit field along
        both halves by both ends, less the derivatives of exact circulations."""
        if c not in self._rests:
            elements, field = self._form.elements, self._unit[c]
            first, last = elements.edges.T
            begin, middle, end = field[first], field[len(elements.points) :], field[last]
            change = np.maximum(*(np.linalg.norm(at - middle, axis=1) for at in (begin, end)))
            changes = change > _CHANGES * np.linalg.norm(middle, axis=1)
            edges = np.flatnonzero(changes & self._moving_edges)
            rest = self._by_rule(self._state.device.coils[c], edges)
            rest[:, 0, 0] += begin[edges] - 0.5 * middle[edges]
            rest[:, 0, 1] -= 0.5 * middle[edges]
            rest[:, 1, 0] += 0.5 * middle[edges]
            rest[:, 1, 1] -= end[edges] - 0.5 * middle[edges]
            self._rests[c] = edges, rest
        return self._rests[c]

    def _by_rule(self, coil: Coil, edges: Index) -> Array:
        """Derivatives (m, 2, 2, 3) of the computed circulations of a coil's unit field along both halves of edges (m,)
        by both ends."""
        elements = self._form.elements
        where, weight = half_rule(POINTS_PER_HALF)
        start, end = np.swapaxes(elements.points[elements.edges[edges]], 0, 1)
        step = end - start
        points = start[:, None] + where[:, None] * step[:, None]
        b, g = unit_flux_density_and_gradient(coil, points.reshape(-1, 3))
        b = b.reshape(*points.shape)
        slope = np.einsum("mqij,mi->mqj", g.reshape(*points.shape, 3), step)
        by_start = weight[:, None] * ((1 - where)[:, None] * slope - b)
        by_end = weight[:, None] * (where[:, None] * slope + b)
        pairs = np.stack([by_start, by_end], axis=2).reshape(len(edges), 2, len(where) // 2, 2, 3)
        return np.asarray(pairs.sum(axis=2))

    def _by_faces(self, adjoint: Adjoint) -> Array:
        form, weights, count = self._form, adjoint.weights, len(self._form.elements.points)
        charges, faces = form.exterior.charge(adjoint.potential), form.iron.surface
        seen = np.zeros((len(charges.T), count, 3))
        if len(adjoint.points):
            points = np.ascontiguousarray(adjoint.points)
            by_density = faces.weights(points, weights.field, weights.gradient)
            charges = charges - form.iron.mutual.solve(by_density.T / faces.areas[:, None], 2)
            by_corners = faces.gradient(
                points, weights.field, weights.gradient, self._charges, self._faces_moving
            )
            seen = _on_nodes(by_corners.transpose(1, 0, 2, 3), self._triangles, count)
        others, symmetry = np.ascontiguousarray(charges.T), form.iron.mesh.symmetry
        return seen + mutual_gradient(
            faces, self._triangles, count, self._charges, others, self._faces_moving, symmetry
        )


def _on_nodes(values: Array, nodes: Index, count: int) -> Array:
    """Sums (k, count, 3) of values (k, m, c, 3) of nodes (m, c)."""
    flat = nodes.ravel()
    rows = [[np.bincount(flat, of[..., d].ravel(), count) for d in range(3)] for of in values]
    return np.swapaxes(np.array(rows, float), 1, 2)


def _outer(one: Array, other: Array) -> Array:
    """Sums (k, e, 3, 3) of a_i b_j over the points of the elements, of (e, 4, 3) and (k, e, 4, 3), or the reverse."""
    return np.asarray(np.swapaxes(one, -1, -2) @ other)


def _trace(one: Array, other: Array) -> Array:
    """Sums (k, e, 3, 3) of (a . b) 1 over the points of the elements."""
    total = np.einsum("eqd,keqd->ke", one, other)
    return np.asarray(total[..., None, None] * np.eye(3))
