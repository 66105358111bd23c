"""Which bodies touch: the connected pieces of iron, and what belongs to each."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from fieldmap.iron.meshing.mesh import IronMesh
from fieldmap.iron.operators.surface import ChargedFaces

Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class MagneticBodies:
    """Connected pieces of iron, numbered from 0: of_element (e,), of_face (m,), number of each charged face's piece."""

    of_element: Index
    of_face: Index

    def touched_by(self, mesh: IronMesh, body: str) -> tuple[str, ...]:
        """Names of all bodies that share a piece of iron with this one, itself included."""
        pieces = np.unique(self.of_element[mesh.body == mesh.body_names.index(body)])
        bodies = np.unique(mesh.body[np.isin(self.of_element, pieces)])
        return tuple(mesh.body_names[k] for k in bodies)


def magnetic_bodies(mesh: IronMesh, faces: ChargedFaces) -> MagneticBodies:
    """Sort elements and charged faces by the piece of iron they belong to; the faces' corners are mesh points."""
    count = len(mesh.points)
    first = np.repeat(mesh.tets[:, 0], 3)
    links = coo_matrix((np.ones(len(first)), (first, mesh.tets[:, 1:].ravel())), shape=(count, count))
    piece = connected_components(links, directed=False)[1]
    # Points that no element uses are pieces of their own; number those in use from 0.
    used, of_element = np.unique(piece[mesh.tets[:, 0]], return_inverse=True)
    corners = faces.corners[:, 0]
    _, number = np.unique(np.concatenate([mesh.points, corners]), axis=0, return_inverse=True)
    number = number.ravel()
    point_of = np.empty(number.max() + 1, dtype=np.int64)
    point_of[number[:count]] = np.arange(count)
    of_face = np.searchsorted(used, piece[point_of[number[count:]]])
    return MagneticBodies(of_element, of_face)
