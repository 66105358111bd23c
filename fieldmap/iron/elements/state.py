"""Solved iron: charges for the air, and the field inside the elements.

In the potential form h is linear in each element, in the flux form b.

The solver treats the air in a thin drawn gap as a sheet of the iron's mesh. A force on one side of the gap needs the
bodies apart, with a surface and charges for each. The potential is known on all of their faces, also at the gap, and
determines the charges as in the air (`fieldmap.iron.elements.potential_form`). The faces on both sides of a gap are
equal, so that the small differences between the potentials of facing charges are taken at opposite points.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Union

import numpy as np
from scipy.linalg import cho_solve

from fieldmap.errors import InputError, Problem
from fieldmap.iron.elements.bh_law import Magnetisation
from fieldmap.iron.elements.nodal_elements import CoilField, NodalElements, shape_gradients
from fieldmap.iron.mesh.charged_faces import ChargedFaces
from fieldmap.iron.mesh.mesh import IronMesh
from fieldmap.iron.operators.mutual import cholesky_in_place
from fieldmap.iron.topology import build_faces
from fieldmap.kernels.simplex_rules import tetrahedron_rule
from fieldmap.records import Record
from fieldmap.typing import Array, Index


@dataclass(frozen=True, eq=False, repr=False)
class SeparatedFaces(Record):
    """mesh: without the sheets in drawn gaps; nodes (m, 3) of the faces of its surface, and the faces."""

    mesh: IronMesh
    nodes: Index
    faces: ChargedFaces

    @classmethod
    def of(cls, mesh: IronMesh) -> "SeparatedFaces":
        """The faces of a mesh with sheets in drawn gaps."""
        apart = mesh.without_drawn_sheets()
        topology = build_faces(apart.points, apart.tets)
        nodes = topology.nodes[topology.surface]
        return cls(apart, nodes, ChargedFaces.from_nodes(mesh.points, nodes))


@dataclass(frozen=True, eq=False, repr=False)
class SeparatedState(Record):
    """surface: of the bodies apart; potential (c, m): means over its faces for every source, T m."""

    surface: SeparatedFaces
    potential: Array

    @cached_property
    def density(self) -> Array:
        """Charge (c, m) per area, T. Costs a dense matrix of all faces and its factor in double precision."""
        faces = self.surface.faces
        matrix = faces.mutual_potential()
        scale = 1 / np.sqrt(np.diagonal(matrix))
        matrix *= scale
        matrix *= scale[:, None]
        # The matrix is symmetric: its transpose is the same matrix in Fortran's order.
        factor = matrix.T
        cholesky_in_place(factor)
        charge = scale[:, None] * cho_solve((factor, True), scale[:, None] * self.potential.T)
        return np.ascontiguousarray((charge / faces.areas[:, None]).T)


ElementField = Union["PotentialField", "LinearField"]
"""The field inside elements, as exactly as a form knows it: B and mu0 M at points (n, 4) of elements (n,)."""


@dataclass(frozen=True, eq=False, repr=False)
class IronState(Record):
    """Solved iron for one or several sources (columns c).

    faces: the m charged faces; density (c, m) in T: mu0 times magnetic charge per area; flux_density (c, e, 3):
    mean of every element, T; iterations: steps of the solver; residuals: its history, relative, worst column;
    inside: the field within elements, None for states that were read back from a file; separated: the same iron with
    air in thin drawn gaps, where the mesh has sheets in them.
    """

    faces: ChargedFaces
    density: Array
    flux_density: Array
    iterations: int
    residuals: tuple[float, ...]
    inside: ElementField | None = None
    separated: SeparatedState | None = None

    def flux_density_at(self, element: Index, barycentric: Array) -> Array:
        """B (c, n, 3) at points (n, 4) of elements (n,), or the elements' means if the state was read from a file."""
        if self.inside is None:
            return self.flux_density[:, element]
        return self.inside.flux_density(element, barycentric)

    def mean_polarisation(self, element: Index, weights: Array) -> Array:
        """Mean mu0 M (n, 3) in T of elements (n,), of the sources with these weights (c,).

        Raises InputError for a state that was read back from a file, which keeps charges and flux densities only.
        """
        if self.inside is None:
            received, remedy = "a solution read back from a file", "solve the device again"
            problem = Problem("magnetisation", "the field inside the iron is needed", received, remedy)
            raise InputError(problem)
        mean = np.zeros((len(element), 3))
        for point, share in zip(*tetrahedron_rule(2), strict=True):
            value = self.inside.polarisation(element, np.tile(point, (len(element), 1)))
            mean += share * np.tensordot(weights, value, 1)
        return mean


@dataclass(frozen=True, eq=False, repr=False)
class PotentialField(Record):
    """h = t - grad phi and b = b(h) + b_r: potential (n, c), coil field t and material."""

    elements: NodalElements
    potential: Array
    field: CoilField
    material: Magnetisation

    def flux_density(self, element: Index, barycentric: Array) -> Array:
        """B (c, n, 3), T, of every source at points (n, 4), in barycentric coordinates of elements (n,)."""
        return np.stack([h + m for h, m in self._fields(element, barycentric)])

    def polarisation(self, element: Index, barycentric: Array) -> Array:
        """mu0 M = B - mu0 H (c, n, 3)."""
        return np.stack([m for _, m in self._fields(element, barycentric)])

    def _fields(self, element: Index, barycentric: Array):
        of = replace(
            self.material, law=self.material.law[element], remanence=self.material.remanence[:, element]
        )
        shape = shape_gradients(barycentric, self.elements.gradients[element])
        nodes = self.elements.nodes[element]
        for c in range(self.potential.shape[1]):
            value = (self.field.bubble[c] - self.potential[:, c])[nodes]
            h = self.field.constant[c, element] + np.einsum("ni,nid->nd", value, shape)
            yield h, of.polarisation(h[:, None], c)[:, 0]


@dataclass(frozen=True, eq=False, repr=False)
class LinearField(Record):
    """Flux density and polarisation, linear in each element, by their values (c, e, 4, 3) in T at the four points of
    the degree-2 rule."""

    flux_density_at_points: Array
    polarisation_at_points: Array

    def flux_density(self, element: Index, barycentric: Array) -> Array:
        """B (c, n, 3)."""
        return _interpolated(self.flux_density_at_points, element, barycentric)

    def polarisation(self, element: Index, barycentric: Array) -> Array:
        """mu0 M (c, n, 3)."""
        return _interpolated(self.polarisation_at_points, element, barycentric)


def _interpolated(values: Array, element: Index, barycentric: Array) -> Array:
    at_points = barycentric @ np.linalg.inv(tetrahedron_rule(2)[0])
    return np.einsum("nq,cnqd->cnd", at_points, values[:, element])
