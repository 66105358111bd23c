"""Second-order flux elements on the iron's tetrahedra (Brezzi, Douglas and Marini), hybridised.

The flux density is linear in every element and free of divergence; its normal component is linear on every face. What
makes neighbours agree about it are potentials on the faces, linear as well: the only unknowns left, three a face.
The coil field is that of `fieldmap.iron.elements.nodal_elements`: free of curl by construction, so that flux around a
closed circuit is driven by the exact circulation, however permeable the iron.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from fieldmap.iron.elements.bh_law import Magnetisation
from fieldmap.iron.elements.nodal_elements import NodalElements
from fieldmap.iron.mesh.chamber import MeshSymmetry
from fieldmap.iron.mesh.distinct_rows import distinct_rows
from fieldmap.iron.mesh.topology import Faces
from fieldmap.iron.operators.element_sums import ElementSums
from fieldmap.iron.operators.sparse_cholesky import nested_dissection
from fieldmap.kernels.iron import linear_flux as kernel
from fieldmap.records import Record
from fieldmap.threads import over_rows
from fieldmap.typing import Array, Index

_WORK = 80.0  # of one element, as `over_rows` counts it
_PAIRS = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))


@dataclass(frozen=True, eq=False, repr=False)
class FluxElements(Record):
    """Unknown 3 f + i is the potential of face f at its corner i.

    unknowns (e, 12): those of the elements, see `fieldmap.kernels.iron.linear_flux`; area (e, 4, 3): outward area
    vectors; volume (e,); count: number of unknowns; face_mean (s, n): takes them to their means over the surface
    faces; nodal: the elements that carry the coil field.
    """

    unknowns: Index
    area: Array
    volume: Array
    count: int
    face_mean: csr_matrix
    nodal: NodalElements

    @classmethod
    def from_mesh(cls, nodal: NodalElements, topology: Faces) -> "FluxElements":
        """Elements on the same tetrahedra as the nodal ones."""
        tets = nodal.nodes[:, :4]
        corners = tets[:, kernel.CORNERS]
        place = (topology.nodes[topology.tet_faces][:, :, None, :] == corners[..., None]).argmax(axis=-1)
        dofs = (3 * topology.tet_faces[:, :, None] + place).reshape(-1, 12)
        area = -3 * nodal.volume[:, None, None] * nodal.gradients
        count, faces = 3 * len(topology.nodes), topology.surface
        mean = _means(faces, count)
        return cls(dofs, np.ascontiguousarray(area), nodal.volume, count, mean, nodal)

    def mean_over(self, triangles: Index, topology: Faces) -> csr_matrix:
        """Takes the unknowns to their means (k, n) over faces with these nodes (k, 3)."""
        both = np.sort(np.concatenate([topology.nodes, triangles]), axis=1)
        number = distinct_rows(both).number
        face = np.empty(number.max() + 1, np.int64)
        face[number[: len(topology.nodes)]] = np.arange(len(topology.nodes))
        return _means(face[number[len(topology.nodes) :]], self.count)

    def elimination_order(self) -> Index:
        """Order (n,) in which the unknowns are eliminated: that of nested dissection for the faces, all three of one
        face together."""
        faces = ElementSums(self.unknowns[:, ::3] // 3, self.count // 3)
        return (3 * nested_dissection(faces.pattern)[:, None] + np.arange(3)).ravel()

    def coil_field_at_points(self, field: Array) -> Array:
        """t as it is."""
        return field

    def no_field(self) -> Array:
        """One source that is zero."""
        return np.zeros((1, len(self.volume), 4, 3))

    def coil_field(self, field: Callable[[Array], Array], symmetry: MeshSymmetry | None = None) -> Array:
        """t (c, e, 4, 3) of flux densities field(points (n, 3)) -> (c, n, 3), in T; free of curl in the iron."""
        return self.nodal.coil_field_at_points(self.nodal.coil_field(field, symmetry))

    def from_nodal(self, potential: Array) -> Array:
        """Face potentials (n, c) closest to nodal potentials (k, c): of each face the linear part of the second-order
        function on it, in the mean-square sense."""
        values = potential[self.nodal.nodes]
        out = np.zeros((self.count, potential.shape[1]))
        for face, corners in enumerate(kernel.CORNERS):
            at = values[:, corners]
            for a, b, opposite in ((0, 1, 2), (0, 2, 1), (1, 2, 0)):
                pair = (int(corners[a]), int(corners[b]))
                bubble = values[:, 4 + _PAIRS.index(pair)] - 0.5 * (values[:, pair[0]] + values[:, pair[1]])
                # 4 l_a l_b is closest to 0.6 (l_a + l_b) - 0.2 l_c.
                for corner, share in ((a, 0.6), (b, 0.6), (opposite, -0.2)):
                    at[:, corner] = at[:, corner] + share * bubble
            out[self.unknowns[:, 3 * face : 3 * face + 3]] = at
        return out

    def joined(self, field: Array, more: Array) -> Array:
        """The same sources, then `more`."""
        return np.concatenate([field, more])

    def residual(self, potential: Array, field: Array, source: int, material: Magnetisation) -> Array:
        """Element vectors (e, 12): outward flux moments, less those of t if the iron were air."""
        law = (material.law, material.remanence[source], *material.tables.arrays)
        out = np.zeros((len(material.law), 12))
        over_rows(kernel.residual, len(out), *self._arrays(potential, field, source), *law, out, work=_WORK)
        return out

    def tangent(self, potential: Array, field: Array, source: int, material: Magnetisation) -> Array:
        """Element matrices (e, 12, 12): minus the derivative of the outward flux moments by the potentials."""
        law = (material.law, *material.tables.arrays)
        out = np.zeros((len(material.law), 12, 12))
        over_rows(
            kernel.tangent, len(out), *self._arrays(potential, field, source), *law, out, work=3 * _WORK
        )
        return out

    def mean_fields(
        self, potential: Array, field: Array, source: int, material: Magnetisation
    ) -> tuple[Array, Array]:
        """Mean flux density (e, 3) of every element and the largest mu0 H (e,) at its points, for potentials (n,)."""
        count, tables = len(material.law), material.tables.arrays
        h, mean, largest = np.empty((count, 4, 3)), np.zeros((count, 3)), np.zeros(count)
        arrays = self._arrays(potential, field, source)
        over_rows(kernel.strength, count, *arrays, material.law, *tables, h, work=_WORK)
        law = (material.law, material.remanence[source], *tables)
        over_rows(kernel.mean_fields, count, h, *law, mean, largest, work=_WORK)
        return mean, largest

    def strength_at_points(self, potential: Array, field: Array, material: Magnetisation) -> Array:
        """mu0 H (c, e, 4, 3) at the four points of every element, for potentials (n, c)."""
        law = (material.law, *material.tables.arrays)
        out = np.empty((potential.shape[1], len(material.law), 4, 3))
        for c, h in enumerate(out):
            over_rows(kernel.strength, len(h), *self._arrays(potential[:, c], field, c), *law, h, work=_WORK)
        return out

    def _arrays(self, potential, field, source):
        """The arguments that all kernels begin with; rows in order, for which alone they are compiled."""
        values, coils = np.ascontiguousarray(potential), np.ascontiguousarray(field[source])
        return values, coils, kernel.SHAPE, self.area, self.volume, self.unknowns


def _means(faces: Index, count: int) -> csr_matrix:
    """Takes unknowns (count,) to their means over faces (k,)."""
    columns = (3 * faces[:, None] + np.arange(3)).ravel()
    rows = np.repeat(np.arange(len(faces)), 3)
    return csr_matrix((np.full(rows.size, 1 / 3), (rows, columns)), shape=(len(faces), count))
