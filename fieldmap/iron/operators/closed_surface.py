"""Harmonic fields by their values on a closed surface: the flux of a potential into the inside and the outside of it.

On a closed surface with outward normals let V be the single layer of charges that are constant on each triangle, K the
double layer of a potential u that is linear on each triangle and continuous, M the means over triangles, and D the
hypersingular operator, by Maue's formula a single layer of the surface curls n x grad u. A potential that is harmonic
inside, with the trace u, has the normal derivative V^-1 (M/2 + K) u; a decaying one outside has the negative of
V^-1 (M/2 - K) u. Put into the second of Calderon's equations this gives, in both cases, a symmetric, positive matrix

    S = D + B^T V^-1 B,      B = M/2 + K inside,  M/2 - K outside,                 (S u) . v = int grad u . grad v dV

the Steklov-Poincare operator (M. Costabel, Boundary Elements IX (1987) 411; O. Steinbach, Numerical Approximation
Methods for Elliptic Boundary Value Problems, Springer 2008, section 6.6). Constants have no field inside: B 1 = 0. The
rows of K are corrected so that this holds exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix

from fieldmap.iron.mesh.charged_faces import NEAR_RADII, ChargedFaces
from fieldmap.iron.operators.mutual import DenseMutualPotential
from fieldmap.kernels.iron.double_layer import double_layer
from fieldmap.records import Record
from fieldmap.threads import over_rows
from fieldmap.typing import Array, Index

# Refinements of the inverse of W, whose factor is in single precision: twelve digits.
_REFINEMENTS = 2


@dataclass(frozen=True, eq=False, repr=False)
class ClosedSurface(Record):
    """One or several closed surfaces with the matrices of their potentials.

    nodes (v,): numbers of the points in use; triangles (n, 3): numbers in `nodes`; faces: the triangles as charged
    ones; mutual: W, mean potentials of unit charges; double (n, v): K, mean potentials of double layers that
    are 1 at a node.
    """

    nodes: Index
    triangles: Index
    faces: ChargedFaces
    mutual: DenseMutualPotential
    double: Array

    @classmethod
    def of(cls, points: Array, triangles: Index) -> ClosedSurface:
        """Triangles (n, 3) of points (p, 3), with outward normals. Takes 18 bytes times the square of n."""
        nodes, number = np.unique(triangles, return_inverse=True)
        local = number.reshape(-1, 3).astype(np.int64)
        faces = ChargedFaces.from_nodes(points, triangles)
        double = np.zeros((len(triangles), len(nodes)))
        of_points = np.ascontiguousarray(np.repeat(faces.normals, 3, axis=0).T)
        geometry = (faces.kernel_geometry(), local, faces.far_points(), of_points, NEAR_RADII)
        over_rows(double_layer, len(double), *geometry, double, work=9.0 * len(double))
        return cls(nodes, local, faces, DenseMutualPotential(faces.mutual_potential()), double)

    def part(self, chosen: Index) -> ClosedSurface:
        """Some of the closed surfaces, by their triangles (k,). Their matrices are copied, not computed."""
        if len(chosen) == len(self.triangles):
            return self
        used, number = np.unique(self.triangles[chosen], return_inverse=True)
        mutual = DenseMutualPotential(np.ascontiguousarray(self.mutual.matrix[np.ix_(chosen, chosen)]))
        double = np.ascontiguousarray(self.double[np.ix_(chosen, used)])
        triangles = number.reshape(-1, 3).astype(np.int64)
        return ClosedSurface(self.nodes[used], triangles, self.faces.part(chosen), mutual, double)

    def correct_constants(self, chosen: Index) -> None:
        """Correct K so that inside these triangles (k,), which bound one piece, constants have no field.

        The sum of a row is -1/2; the error of the quadrature is corrected at the triangle's own corners.
        """
        corners = self.triangles[chosen]
        used = np.unique(corners)
        missing = -0.5 - self.double[np.ix_(chosen, used)].sum(axis=1)
        for k in range(3):
            self.double[chosen, corners[:, k]] += missing / 3

    @cached_property
    def means(self) -> csr_matrix:
        """M (n, v): means over the triangles."""
        rows = np.repeat(np.arange(len(self.triangles)), 3)
        shape = self.double.shape
        return csr_matrix((np.full(rows.size, 1 / 3), (rows, self.triangles.ravel())), shape=shape)

    @cached_property
    def curls(self) -> tuple[csr_matrix, ...]:
        """Three components (n, v) of the surface curl n x grad u of a nodal potential, times the triangles' areas."""
        rows = np.repeat(np.arange(len(self.triangles)), 3)
        shapes = corner_curls(self.faces)
        return tuple(
            csr_matrix((shapes[:, :, d].ravel(), (rows, self.triangles.ravel())), shape=self.double.shape)
            for d in range(3)
        )

    @cached_property
    def hypersingular(self) -> Array:
        """D (v, v)."""
        total = np.zeros((len(self.nodes),) * 2)
        for curl in self.curls:
            across = curl.T.tocsr()
            total += across @ (across @ self.mutual.matrix).T
        return total

    def charge(self, means: Array) -> Array:
        """Charges (n, c) with the mean potentials (n, c)."""
        return self.mutual.solve(means, _REFINEMENTS)


def corner_curls(faces: ChargedFaces) -> Array:
    """Surface curls (n, 3, 3) of the three barycentric coordinates of each triangle, times its area."""
    corners = faces.corners
    return np.stack([0.5 * (corners[:, (k + 1) % 3] - corners[:, (k + 2) % 3]) for k in range(3)], axis=1)


@dataclass(frozen=True, eq=False, repr=False)
class Potentials(Record):
    """Potentials c on a closed surface, which may jump along a cut round a handle: their surface curls times area
    (n, 3, c), and B u (n, c), in which the double layer includes the cut's."""

    curl: Array
    means: Array

    def __add__(self, other: Potentials) -> Potentials:
        return Potentials(self.curl + other.curl, self.means + other.means)

    def part(self, columns: slice) -> Potentials:
        """Some of the potentials."""
        return Potentials(self.curl[:, :, columns], self.means[:, columns])


@dataclass(frozen=True, eq=False, repr=False)
class Side(Record):
    """The inside or the outside of a closed surface, with its B and S."""

    surface: ClosedSurface
    inside: bool

    @property
    def _sign(self) -> float:
        return 1.0 if self.inside else -1.0

    def potentials(self, nodal: Array) -> Potentials:
        """The potentials of nodal values (v, c), without cuts."""
        curl = np.stack([component @ nodal for component in self.surface.curls], axis=1)
        return Potentials(curl, self._means(nodal))

    def _means(self, nodal: Array) -> Array:
        """B u (n, c) for u (v, c)."""
        return 0.5 * (self.surface.means @ nodal) + self._sign * (self.surface.double @ nodal)

    def apply(self, nodal: Array) -> Array:
        """S u (v, c) for nodal values (v, c) without cuts."""
        return self.surface.hypersingular @ nodal + self._tested(self._means(nodal))

    def flux(self, of: Potentials) -> Array:
        """S u (v, c): the flux through the surface, tested with the functions of the nodes."""
        out = self._tested(of.means)
        for d, component in enumerate(self.surface.curls):
            out = out + component.T @ (self.surface.mutual @ of.curl[:, d])
        return out

    def _tested(self, means: Array) -> Array:
        """B^T V^-1 m (v, c) for m (n, c)."""
        # With one refinement S is a symmetric, fixed map, exact to seven digits.
        charge = self.surface.mutual.solve(means, 1)
        return 0.5 * (self.surface.means.T @ charge) + self._sign * (self.surface.double.T @ charge)

    def energy(self, one: Potentials, other: Potentials) -> Array:
        """Integrals (c, k) over the side of products of the potentials' gradients."""
        out = one.means.T @ self.surface.charge(other.means)
        for d in range(3):
            out = out + one.curl[:, d].T @ (self.surface.mutual @ other.curl[:, d])
        return out

    def normal_derivative(self, of: Potentials) -> Array:
        """Derivative (n, c) along the outward normal, mean over each triangle."""
        return self._sign * self.surface.charge(of.means) / self.surface.faces.areas[:, None]
