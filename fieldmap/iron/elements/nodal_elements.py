"""Second-order nodal elements on the iron's tetrahedra: numbering, and the coil field as exact edge circulations.

The coil field inside the iron enters as a field t that is curl-free by construction: its circulation along every
half edge is the exact line integral of the coil field. t is constant per element (the lowest-order edge element with
those circulations) plus the gradient of second-order bubbles that carry the difference of the two halves. Because t
and the gradients of the potential live in one space, H = t - grad phi may be thousands of times smaller than either
without loss; and closed loops of iron around a winding need no cuts.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from scipy.sparse import csr_matrix

from fieldmap.device.coils import Coil
from fieldmap.iron.elements.bh_law import Magnetisation
from fieldmap.iron.mesh.chamber import MeshSymmetry
from fieldmap.iron.mesh.mesh import IronMesh, volumes
from fieldmap.iron.operators.linear_systems import ElementSums, nested_dissection
from fieldmap.iron.topology import TET_EDGES, Faces, barycentric_gradients, distinct_parts, edge_keys
from fieldmap.kernels.iron.quadratic_potential import sample_gradients, tested_matrices, tested_vectors
from fieldmap.records import Record
from fieldmap.sources import unit_flux_densities
from fieldmap.threads import over_rows
from fieldmap.typing import Array, Index

# Gauss points per half edge: the coil field is smooth over a few millimetres at 1 mm from a winding.
POINTS_PER_HALF = 4
# Points at which a field is evaluated at a time.
_BATCH = 200_000
UNIT = np.array([1.0, 0.0, 0.0, 1.0, 0.0, 1.0])
"""The unit matrix as xx, xy, xz, yy, yz, zz."""


FieldOfPoints = Callable[[Array], Array]
"""field(points (n, 3)) -> (c, n, 3): flux densities of c sources, T."""


@dataclass(frozen=True, eq=False, repr=False)
class CoilField(Record):
    """t of several sources: constant part (c, e, 3) and bubbles (c, n), in T."""

    constant: Array
    bubble: Array

    def combined(self, shares: Array) -> "CoilField":
        """Sources (k) made of shares (k, c) of these."""
        return CoilField(np.einsum("kc,ced->ked", shares, self.constant), shares @ self.bubble)

    def __add__(self, other: "CoilField") -> "CoilField":
        return CoilField(self.constant + other.constant, self.bubble + other.bubble)


class Elements(Record):
    """Interface of both families of elements, with k unknowns per element. coil_field(field, symmetry): flux densities
    field(points (n, 3)) -> (c, n, 3) in T, as a field in the iron; residual(potential (n,), field, source, material):
    element vectors (e, k) of the iron's part of R; tangent(the same): matrices (e, k, k), minus the derivative of the
    residual; strength_at_points(potential (n, c), field, material): mu0 H (c, e, 4, 3) at four points of every element.

    work: cost of an element at its four points, in the unit of `over_rows`.
    """

    work: ClassVar[float]
    coil_field: Callable[..., Any]

    def unit_fields(self, coils: Sequence[Coil], mesh: IronMesh) -> Any:
        """The field in the iron of one ampere in each coil."""
        return self.coil_field(lambda x: unit_flux_densities(coils, x), mesh.symmetry)


@dataclass(frozen=True, eq=False, repr=False)
class NodalElements(Elements):
    """Nodes are the mesh's points, then the midpoints of its edges.

    nodes (e, 10) in the order of `fieldmap.kernels.iron.quadratic_potential`; gradients (e, 4, 3) of the barycentric
    coordinates; volume (e,); edges (m, 2), sorted; surface (k,): nodes on the iron's surface; face_mean (s, n):
    takes nodal values to their means over the surface faces.
    """

    work = 50.0

    points: Array
    nodes: Index
    gradients: Array
    volume: Array
    edges: Index
    surface: Index
    face_mean: csr_matrix

    @property
    def count(self) -> int:
        """Number of nodes."""
        return len(self.points) + len(self.edges)

    @property
    def node_points(self) -> Array:
        """Positions (n, 3) of the nodes, m."""
        return np.concatenate([self.points, self.points[self.edges].mean(axis=1)])

    @property
    def unknowns(self) -> Index:
        """Numbers (e, 10) of the elements' unknowns: their nodes."""
        return self.nodes

    def elimination_order(self) -> Index:
        """Order (n,) in which the nodes are eliminated: the mesh's points by nested dissection, and the middle of an
        edge just before the end that comes first.

        The first ends of two edges of one tetrahedron are neighbours or equal: no separator lies between them. The
        separators of the points, with the edges between them, therefore separate the edges' middles as well, and the
        graph of the points has only a fifth of the nodes.
        """
        corners = ElementSums(self.nodes[:, :4], len(self.points))
        rank = np.empty(len(self.points), np.int64)
        rank[nested_dissection(corners.pattern)] = np.arange(len(rank))
        return np.argsort(np.concatenate([2 * rank + 1, 2 * rank[self.edges].min(axis=1)]), kind="stable")

    @classmethod
    def from_mesh(cls, mesh: IronMesh, faces: Faces) -> Self:
        """Number the nodes of a mesh."""
        corner_count = len(mesh.points)
        edges, _, number, _ = distinct_parts(mesh.tets, TET_EDGES)
        nodes = np.column_stack([mesh.tets, corner_count + number.reshape(-1, 6)])
        triangles = faces.nodes[faces.surface]
        middles, mean = _middles_and_means(triangles, edges, corner_count)
        surface = np.unique(np.concatenate([triangles.ravel(), middles.ravel()]))
        gradients = barycentric_gradients(mesh.points[mesh.tets])
        return cls(mesh.points, nodes, gradients, volumes(mesh.points, mesh.tets), edges, surface, mean)

    def mean_over(self, triangles: Index, topology: Faces) -> csr_matrix:
        """Takes nodal values to their means (k, n) over faces with these nodes (k, 3)."""
        return _middles_and_means(triangles, self.edges, len(self.points))[1]

    def coil_field(self, field: FieldOfPoints, symmetry: MeshSymmetry | None = None) -> CoilField:
        """t of flux densities field(points (n, 3)) -> (c, n, 3), in T; they must be free of curl in the iron.

        symmetry: of the mesh; give it only if the fields are those of the device's coils, in their order. Edges and
        coils that the operations map onto each other are then computed once.
        """
        first, second = self._half_circulations(field, symmetry)
        bubble = np.zeros((len(first), self.count))
        bubble[:, len(self.points) :] = 0.5 * (first - second)
        along = (first + second)[:, self.nodes[:, 4:] - len(self.points)]
        return CoilField(np.einsum("cem,emd->ced", along, self._edge_functions()), bubble)

    def _edge_functions(self) -> Array:
        """Lowest-order edge functions (e, 6, 3) at the centroids."""
        # Stored edges run from the smaller to the larger point number.
        sign = np.where(self.nodes[:, TET_EDGES[:, 0]] < self.nodes[:, TET_EDGES[:, 1]], 1.0, -1.0)
        # The function of edge (a, b) there is (grad l_b - grad l_a) / 4.
        shape = 0.25 * (self.gradients[:, TET_EDGES[:, 1]] - self.gradients[:, TET_EDGES[:, 0]])
        return np.asarray(sign[..., None] * shape)

    def tested_by_circulations(self, vectors: Array) -> tuple[Array, Array]:
        """Derivatives of the sum of v . t over the four points of every element, for vectors v (c, e, 4, 3), by the
        circulations of t along the first and the second half of every edge: (c, m) each."""
        bubble = self.tested(vectors)[:, len(self.points) :]
        of_elements = np.einsum("ced,emd->cem", vectors.sum(axis=2), self._edge_functions(), optimize=True)
        number = (self.nodes[:, 4:] - len(self.points)).ravel()
        along = np.stack([np.bincount(number, of.ravel(), len(self.edges)) for of in of_elements])
        return along + 0.5 * bubble, along - 0.5 * bubble

    def node_images(self, corners: Index) -> Index:
        """Images (n,) of all nodes, given the images of the mesh's points; midpoints move with their edges."""
        count = len(self.points)
        ends = np.sort(corners[self.edges], axis=1)
        number = np.searchsorted(edge_keys(self.edges, count), edge_keys(ends, count))
        return np.concatenate([corners, count + number])

    def _half_circulations(self, field: FieldOfPoints, symmetry: MeshSymmetry | None) -> tuple[Array, Array]:
        """Line integrals (c, m) of the field along both halves of every edge."""
        if symmetry is None:
            return half_circulations(field, self.points, self.edges, POINTS_PER_HALF)
        # Flux density is an axial vector: an operation M that moves an edge multiplies its circulation by det(M).
        count, moves = len(self.points), []
        for corners, operation in zip(symmetry.node_images, symmetry.group.operations, strict=True):
            if operation.coils is not None:
                moved = self.node_images(corners)[count:] - count
                turned = corners[self.edges[:, 0]] > corners[self.edges[:, 1]]
                signs = operation.handedness * np.array(operation.coil_signs, float)[:, None]
                moves.append((moved, turned, list(operation.coils), signs))
        own = np.min([moved for moved, *_ in moves], axis=0) == np.arange(len(self.edges))
        halves = half_circulations(field, self.points, self.edges[own], POINTS_PER_HALF)
        out = np.empty((2, len(halves[0]), len(self.edges)))
        for moved, turned, coils, signs in moves:
            to, back = moved[own], turned[own]
            for k in (0, 1):
                out[k][np.ix_(coils, to)] = signs * np.where(back, -halves[1 - k], halves[k])
        return out[0], out[1]

    def no_field(self) -> CoilField:
        """One source that is zero."""
        return CoilField(np.zeros((1, len(self.volume), 3)), np.zeros((1, self.count)))

    def joined(self, field: CoilField, more: CoilField) -> CoilField:
        """The same sources, then `more`."""
        both = ((field.constant, more.constant), (field.bubble, more.bubble))
        return CoilField(*map(np.concatenate, both))

    def residual(self, potential: Array, field: CoilField, source: int, material: Magnetisation) -> Array:
        """Element vectors (e, 10) of int (b(h) + b_r - t) . grad N with h = t - grad phi, for phi (n,)."""
        h, slope = self._strength(potential, field, source)
        return self._element_vectors(material.polarisation(h, source) - slope, self.volume)

    def tangent(self, potential: Array, field: CoilField, source: int, material: Magnetisation) -> Array:
        """Element matrices (e, 10, 10) of int grad N_i . (db/dh) grad N_j at phi (n,)."""
        permeability = material.susceptibility(self._strength(potential, field, source)[0]) + UNIT
        out = np.zeros((*self.nodes.shape, 10))
        given = (permeability, self.gradients, self.volume, out)
        over_rows(tested_matrices, len(out), *given, work=2 * self.work)
        return out

    def _strength(self, potential: Array, field: CoilField, source: int) -> tuple[Array, Array]:
        """mu0 H and grad phi (e, 4, 3) at the points of every element, for phi (n,)."""
        bubble, slope = self.point_gradients(np.column_stack([field.bubble[source], potential]))
        return field.constant[source][:, None] + bubble - slope, slope

    def _element_vectors(self, vectors: Array, volume: Array) -> Array:
        """Element vectors (e, 10) of int v . grad N for v (e, 4, 3) at the points, over these volumes (e,)."""
        out = np.zeros(self.nodes.shape)
        given = (np.ascontiguousarray(vectors), self.gradients, volume, out)
        over_rows(tested_vectors, len(out), *given, work=self.work)
        return out

    def gradients_at_points(self, values: Array) -> Array:
        """Gradients (e, 4, 3, r) of functions (n, r) at the four points of every element."""
        out = np.empty((len(self.volume), 4, 3, values.shape[1]))
        arguments = (np.ascontiguousarray(values), self.nodes, self.gradients, out)
        over_rows(sample_gradients, len(out), *arguments, work=self.work * values.shape[1])
        return out

    def coil_field_at_points(self, field: CoilField) -> Array:
        """t (c, e, 4, 3) at the four points of every element."""
        return field.constant[:, :, None] + self.point_gradients(field.bubble.T)

    def strength_at_points(self, potential: Array, field: CoilField, material: Magnetisation) -> Array:
        """mu0 H (c, e, 4, 3) at the four points of every element, for phi (n, c); it does not need the material."""
        return self.coil_field_at_points(field) - self.point_gradients(potential)

    def point_gradients(self, values: Array) -> Array:
        """Gradients (c, e, 4, 3) of nodal values (n, c) at the four points of every element."""
        return np.ascontiguousarray(np.moveaxis(self.gradients_at_points(values), 3, 0))

    def tested(self, vectors: Array) -> Array:
        """Sums (c, n) of vectors (c, e, 4, 3) at the four points of every element times the gradients of the nodes'
        functions there: the transpose of `point_gradients`."""
        # Each point has a quarter of the volume.
        flat, four = self.nodes.ravel(), np.full(len(self.volume), 4.0)
        each = (self._element_vectors(of, four).ravel() for of in vectors)
        return np.stack([np.bincount(flat, of, self.count) for of in each], dtype=float)


def half_rule(count: int) -> tuple[Array, Array]:
    """Places (q,) along an edge, from 0 to 1, and weights (q,): `count` Gauss points on the first half of the edge,
    then on the second."""
    x, w = np.polynomial.legendre.leggauss(count)
    return np.concatenate([(x + 1) / 4, (x + 3) / 4]), np.concatenate([w, w]) / 4


def half_circulations(field: FieldOfPoints, points: Array, edges: Index, count: int) -> tuple[Array, Array]:
    """Line integrals (c, m) of fields field(points (n, 3)) -> (c, n, 3) along the first and the second half of edges
    (m, 2), by `count` points on each half."""
    where, weights = half_rule(count)
    halves = np.kron(np.eye(2), weights[:count]).astype(np.float64)
    means = field_means(field, points[edges], np.column_stack([1 - where, where]), halves)
    first, second = np.einsum("hcmd,md->hcm", means, points[edges[:, 1]] - points[edges[:, 0]])
    return first, second


def field_means(field: FieldOfPoints, corners: Array, rule: Array, weights: Array) -> Array:
    """Means (h, c, m, 3) of a field over simplices with corners (m, k, 3), by rules (q, k) with weights (h, q)."""
    parts = []
    for batch in np.array_split(corners, 1 + len(corners) * len(rule) // _BATCH):
        x = np.einsum("qk,mkd->qmd", rule, batch)
        value = field(x.reshape(-1, 3)).reshape(-1, *x.shape)
        parts.append(np.einsum("hq,cqmd->hcmd", weights, value))
    return np.concatenate(parts, axis=2)


def shape_gradients(barycentric: Array, gradients: Array) -> Array:
    """Gradients (n, 10, 3) of the second-order shape functions at points (n, 4) of elements with gradients (n, 4, 3).

    (4 l_i - 1) g_i for corners, 4 (l_a g_b + l_b g_a) for middles, as in `fieldmap.kernels.iron.quadratic_potential`.
    """
    out = np.empty((len(barycentric), 10, gradients.shape[2]))
    out[:, :4] = (4 * barycentric - 1)[:, :, None] * gradients
    a, b = TET_EDGES.T
    out[:, 4:] = 4 * (barycentric[:, a, None] * gradients[:, b] + barycentric[:, b, None] * gradients[:, a])
    return out


def _middles_and_means(triangles: Index, edges: Index, corners: int) -> tuple[Index, csr_matrix]:
    """Nodes (k, 3) in the middles of the sides of triangles (k, 3), and the matrix (k, n) of means over triangles."""
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [0, 2]]], axis=2)
    middles = corners + np.searchsorted(edge_keys(edges, corners), edge_keys(sides, corners))
    # The mean of a second-order function over a triangle is the mean of its three midpoint values.
    rows = np.repeat(np.arange(len(triangles)), 3)
    shape = (len(triangles), corners + len(edges))
    return middles, csr_matrix((np.full(rows.size, 1 / 3), (rows, middles.ravel())), shape=shape)
