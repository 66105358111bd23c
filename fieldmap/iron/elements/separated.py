"""Bodies on both sides of thin drawn gaps, each with a surface and charges of its own.

The solver takes the air in such a gap for a sheet of the iron's mesh. Forces on one side need the bodies apart: the
potential is known on all of their faces, those at the gap among them, and charges that make it follow as they do in the
air (`fieldmap.iron.operators.exterior`). The faces on both sides of a gap are equal, so that what little the potentials
of facing charges differ by is found from points that lie opposite to each other.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_solve

from fieldmap.iron.mesh.mesh import IronMesh
from fieldmap.iron.mesh.topology import build_faces
from fieldmap.iron.operators.lapack import cholesky_in_place
from fieldmap.iron.operators.surface import ChargedFaces
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
        """Of a mesh with sheets in drawn gaps."""
        apart = mesh.without_drawn_sheets()
        topology = build_faces(apart)
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
        # Symmetric: the transposed one is the same matrix in Fortran's order.
        factor = matrix.T
        cholesky_in_place(factor)
        charge = scale[:, None] * cho_solve((factor, True), scale[:, None] * self.potential.T)
        return np.ascontiguousarray((charge / faces.areas[:, None]).T)
