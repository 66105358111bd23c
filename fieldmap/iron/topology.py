"""Edges and faces of meshes as rows of node numbers: distinct ones, their owners, and connected parts."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from fieldmap.records import Record, tuple_line
from fieldmap.typing import Array, Index

TET_EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
TET_FACES = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
"""Face k is opposite corner k."""
TRIANGLE_SIDES = np.array([[0, 1], [0, 2], [1, 2]])
TRIANGLE_TURN = np.array([[0, 1], [1, 2], [2, 0]])
"""The sides of a triangle in cyclic order, each from the end of the one before."""


class DistinctRows(NamedTuple):
    """rows (m, k), sorted; first, times (m,): place of the first and number of all equal given rows; number (n,): the
    distinct row of each given row."""

    rows: Index
    first: Index
    number: Index
    times: Index

    def __repr__(self) -> str:
        return tuple_line(self)


def distinct_rows(rows: Index) -> DistinctRows:
    """The distinct rows among rows (n, k) of numbers from 0 on, in lexicographic order.

    `numpy.unique(rows, axis=0)` compares rows byte by byte. Here the numbers of a row are digits of one integer, and
    sorting takes a tenth of the time. Raises OverflowError if the integer has more than 63 bits.

    >>> found = distinct_rows(np.array([[1, 2], [0, 5], [1, 2]]))
    >>> found.rows.tolist(), found.first.tolist(), found.number.tolist(), found.times.tolist()
    ([[0, 5], [1, 2]], [1, 0], [1, 0, 1], [1, 2])
    """
    base = int(rows.max(initial=0)) + 1
    width = rows.shape[1]
    if base**width > 2**63:
        raise OverflowError(f"{width} numbers below {base} do not fit into 63 bits")
    digits = base ** np.arange(width - 1, -1, -1, dtype=np.int64)
    keys, first, number, times = np.unique(
        rows.astype(np.int64) @ digits, return_index=True, return_inverse=True, return_counts=True
    )
    return DistinctRows(keys[:, None] // digits % base, first, number, times)


def distinct_parts(elements: Index, parts: Index) -> DistinctRows:
    """The distinct edges or faces, corners rising, of elements (m, k); parts (p, j): corners of one element's parts."""
    return distinct_rows(np.sort(elements[:, parts].reshape(-1, parts.shape[1]), axis=1))


def common_sides(triangles: Index) -> tuple[Index, Index]:
    """Sides (k,) and (k,) in which two of these triangles (m, 3) meet; 3 t + i: side i (`TRIANGLE_TURN`) of t."""
    sides = np.sort(triangles[:, TRIANGLE_TURN].reshape(-1, 2), axis=1)
    order = np.lexsort(sides.T)
    same = np.flatnonzero((sides[order[1:]] == sides[order[:-1]]).all(axis=1))
    return order[same], order[same + 1]


def edge_keys(edges: Index, count: int) -> Index:
    """A number for each edge (..., 2) of `count` nodes, in lexicographic order."""
    return edges[..., 0] * count + edges[..., 1]


def connected(pairs: Index, count: int) -> Index:
    """Number (count,) of the connected part of each of `count` things; pairs (k, 2) of things are connected."""
    links = coo_matrix((np.ones(len(pairs)), tuple(pairs.T)), shape=(count, count))
    return connected_components(links)[1].astype(np.int64)


def area_vectors(corners: Array) -> Array:
    """Normals (n, 3) of triangles (n, 3, 3) by the right-hand rule, as long as twice their areas."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def barycentric_gradients(corners: Array) -> Array:
    """Gradients (e, 4, 3) of the barycentric coordinates of tetrahedra (e, 4, 3)."""
    last = np.swapaxes(np.linalg.inv(corners[:, 1:] - corners[:, :1]), 1, 2)
    return np.ascontiguousarray(np.concatenate([-last.sum(axis=1, keepdims=True), last], axis=1))


@dataclass(frozen=True, eq=False, repr=False)
class Faces(Record):
    """All faces of a mesh, each once.

    nodes (f, 3); tet_faces (e, 4): face opposite local vertex k; sign (e, 4): +1 where the face's normal leaves the
    tet; owner (f, 2): tets on the side the normal leaves and enters (-1: air); surface (s,): faces between iron and
    air, whose normals point into the air. group_of_tet (e,), group_of_surface (s,): magnetic body, that is the
    connected piece of iron that the tet or surface face belongs to.
    """

    nodes: Index
    tet_faces: Index
    sign: Array
    owner: Index
    surface: Index
    group_of_tet: Index
    group_of_surface: Index


def build_faces(points: Array, tets: Index) -> Faces:
    """Number and orient the faces of tetrahedra (e, 4) of points (n, 3)."""
    nodes, _, number, count = distinct_parts(tets, TET_FACES)
    tet_faces = number.reshape(-1, 4)
    corners = points[nodes]
    outward = (corners[:, 0] + corners[:, 1] + corners[:, 2])[tet_faces] / 3
    outward -= points[tets].mean(axis=1)[:, None]
    sign = np.sign(np.einsum("eij,eij->ei", area_vectors(corners)[tet_faces], outward))
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
    group = connected(owner[~is_surface], len(tets))
    return Faces(nodes, tet_faces, sign, owner, surface, group, group[owner[surface, 0]])
