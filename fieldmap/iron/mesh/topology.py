"""Faces of a tetrahedral mesh: who owns them, which way they point, which lie on the surface."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from fieldmap.iron.mesh.distinct_rows import distinct_rows
from fieldmap.iron.mesh.mesh import IronMesh
from fieldmap.records import Record

_LOCAL_FACES = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])


@dataclass(frozen=True, eq=False, repr=False)
class Faces(Record):
    """All faces of a mesh, each once.

    nodes (f, 3); tet_faces (e, 4): face opposite local vertex k; sign (e, 4): +1 where the face's normal leaves the
    tet; owner (f, 2): tets on the side the normal leaves and enters (-1: air); surface (s,): faces between iron and
    air, whose normals point into the air. group_of_tet (e,), group_of_surface (s,): magnetic body, that is the
    connected piece of iron that the tet or surface face belongs to.
    """

    nodes: NDArray[np.int64]
    tet_faces: NDArray[np.int64]
    sign: NDArray[np.float64]
    owner: NDArray[np.int64]
    surface: NDArray[np.int64]
    group_of_tet: NDArray[np.int64]
    group_of_surface: NDArray[np.int64]


def build_faces(mesh: IronMesh) -> Faces:
    """Number and orient the faces of a mesh."""
    tets = mesh.tets
    flat = np.sort(tets[:, _LOCAL_FACES].reshape(-1, 3), axis=1)
    nodes, _, inverse, count = distinct_rows(flat)
    tet_faces = inverse.reshape(-1, 4)
    sign = _outward_sign(mesh, nodes, tet_faces)
    surface = np.flatnonzero(count == 1)
    is_surface = count == 1
    flip = np.zeros(len(nodes), bool)
    flip[tet_faces[(sign < 0) & is_surface[tet_faces]]] = True
    nodes[flip] = nodes[flip][:, [0, 2, 1]]
    sign[flip[tet_faces]] = 1.0
    owner = np.full((len(nodes), 2), -1)
    element = np.repeat(np.arange(len(tets)), 4)
    leaves = sign.ravel() > 0
    owner[tet_faces.ravel()[leaves], 0] = element[leaves]
    owner[tet_faces.ravel()[~leaves], 1] = element[~leaves]
    inner = owner[~is_surface]
    links = coo_matrix((np.ones(len(inner)), (inner[:, 0], inner[:, 1])), shape=(len(tets), len(tets)))
    group = connected_components(links)[1].astype(np.int64)
    return Faces(nodes, tet_faces, sign, owner, surface, group, group[owner[surface, 0]])


def _outward_sign(mesh: IronMesh, nodes, tet_faces):
    a, b, c = (mesh.points[nodes[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    centre = mesh.points[mesh.tets].mean(axis=1)
    out = (a + b + c)[tet_faces] / 3 - centre[:, None, :]
    return np.sign(np.einsum("eij,eij->ei", normal[tet_faces], out))
