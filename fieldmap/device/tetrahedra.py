"""Meshes of tetrahedra: their boundary, and the faults of a mesh that fills no solid."""

import numpy as np

from fieldmap.arguments import LARGEST_NUMBER
from fieldmap.typing import Array, Index

# Faces of a tetrahedron of positive volume, counter-clockwise seen from outside; face k is opposite corner k.
OUTWARD = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
# A tetrahedron with less volume than this times the cube of its longest edge is flat.
_FLAT = 1e-12

Fault = tuple[str, str, str]
"""What must hold, what was received, the remedy."""


def volumes(points: Array, tets: Index) -> Array:
    """Signed volumes (m,) of tetrahedra (m, 4)."""
    a, b, c, d = (points[tets[:, k]] for k in range(4))
    return np.asarray(np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)) / 6, np.float64)


def oriented(points: Array, tets: Index) -> Index:
    """The same tetrahedra (m, 4) with positive volume."""
    negative = volumes(points, tets) < 0
    tets = tets.copy()
    tets[negative] = tets[negative][:, [0, 2, 1, 3]]
    return tets


def boundary(points: Array, tets: Index) -> Index:
    """Triangles (k, 3) that belong to one tetrahedron only, counter-clockwise seen from outside."""
    faces = oriented(points, tets)[:, OUTWARD].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[first[count == 1]]


def longest_edge(points: Array, tets: Index) -> float:
    """Longest edge of all tetrahedra, in the unit of the points."""
    corners = points[tets]
    return max(
        float(np.linalg.norm(corners[:, i] - corners[:, j], axis=1).max()) for i in range(4) for j in range(i)
    )


def subdivided(points: Array, tets: Index) -> tuple[Array, Index]:
    """Each tetrahedron cut into eight of equal volume (Bey, Computing 55, 1995), with all edges halved."""
    pairs = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
    ends, number = np.unique(np.sort(tets[:, pairs].reshape(-1, 2), axis=1), axis=0, return_inverse=True)
    middle = len(points) + number.reshape(-1, 6)
    nodes = np.column_stack([tets, middle])
    # Nodes 0 to 3 are corners, 4 to 9 midpoints of `pairs`. The octahedron inside is cut along its diagonal 5-8.
    corners = [[0, 4, 5, 6], [4, 1, 7, 8], [5, 7, 2, 9], [6, 8, 9, 3]]
    inside = [[4, 5, 6, 8], [4, 5, 7, 8], [5, 6, 8, 9], [5, 7, 8, 9]]
    return np.vstack([points, 0.5 * (points[ends[:, 0]] + points[ends[:, 1]])]), nodes[
        :, corners + inside
    ].reshape(-1, 4)


def tetrahedra_fault(points: Array, tets: Index) -> Fault | None:
    """The fault of a mesh that fills no solid; None for a mesh that fills one.

    points (n, 3) in any unit, tets (m, 4): numbers of points, in any order of the corners. Faults are wrong numbers,
    flat or repeated tetrahedra, faces of more than two tetrahedra, neighbours on the same side of their face, and edges
    in which the boundary touches itself. A boundary that cuts itself elsewhere is found when the solid is built.

    >>> corners = np.vstack([np.zeros(3), np.eye(3)])
    >>> tetrahedra_fault(corners, np.array([[0, 1, 2, 3]])) is None
    True
    >>> tetrahedra_fault(corners, np.array([[0, 1, 2, 3], [1, 0, 3, 2]]))[1]
    'tetrahedra 0 and 1 with the corners 0, 1, 2, 3 (1 pair in all)'
    """
    return (
        _fault_of_numbers(points, tets)
        or _flat(points, tets)
        or _twice(tets)
        or _fault_of_faces(points, tets)
        or _touching_edges(points, tets)
    )


def _fault_of_numbers(points: Array, tets: Index) -> Fault | None:
    if not len(tets):
        return "a mesh has at least one tetrahedron", "none", "export the cells of the volume"
    wrong = ((tets < 0) | (tets >= len(points))).any(axis=1)
    if wrong.any():
        received = f"{tets[wrong][0].tolist()} as tetrahedron {np.argmax(wrong)}"
        return f"tetrahedra are numbers of points, 0 to {len(points) - 1}", received, "number them from 0"
    lost = ~(np.abs(points[tets]) <= LARGEST_NUMBER).all(axis=(1, 2))
    if lost.any():
        received = f"a point of tetrahedron {np.argmax(lost)} that is no number, or beyond {LARGEST_NUMBER:g}"
        return "points are finite numbers", received, "write the mesh again"
    return None


def _flat(points: Array, tets: Index) -> Fault | None:
    corners = points[tets]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    flat = np.abs(volumes(points, tets)) <= _FLAT * longest**3
    if not flat.any():
        return None
    number = int(np.argmax(flat))
    received = f"tetrahedron {number} with corners {tets[number].tolist()} is flat ({int(flat.sum())} in all)"
    return "each tetrahedron has a volume", received, "mesh the solid again, or optimise the mesh"


def _twice(tets: Index) -> Fault | None:
    _, first, number, count = np.unique(
        np.sort(tets, axis=1), axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    if count.max() == 1:
        return None
    group = int(np.argmax(count > 1))
    one, other = np.flatnonzero(number.ravel() == group)[:2].tolist()
    corners = ", ".join(map(str, sorted(tets[first[group]].tolist())))
    pairs = int((count > 1).sum())
    received = (
        f"tetrahedra {one} and {other} with the corners {corners} ({pairs} pair{'s' * (pairs > 1)} in all)"
    )
    return (
        "each tetrahedron is there once",
        received,
        "name the region that is meant, or write each cell once",
    )


def _fault_of_faces(points: Array, tets: Index) -> Fault | None:
    faces = np.sort(tets[:, OUTWARD].reshape(-1, 3), axis=1)
    rows, number, count = np.unique(faces, axis=0, return_inverse=True, return_counts=True)
    number = number.ravel()
    if count.max() > 2:
        row = rows[int(np.argmax(count > 2))].tolist()
        received = f"{int(count.max())} at the face of points {row[0]}, {row[1]} and {row[2]}"
        return "a face belongs to one tetrahedron or two", received, "mesh the solid again: its cells overlap"
    order = np.argsort(number, kind="stable")
    one = np.flatnonzero(np.diff(number[order]) == 0)
    first, second = order[one], order[one + 1]
    a, b, c = (points[faces[first, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    sides = [np.einsum("kd,kd->k", points[tets[half // 4, half % 4]] - a, normal) for half in (first, second)]
    folded = sides[0] * sides[1] > 0
    if not folded.any():
        return None
    k = int(np.argmax(folded))
    received = (
        f"tetrahedra {first[k] // 4} and {second[k] // 4} on one side of theirs ({int(folded.sum())} in all)"
    )
    return "neighbours lie on two sides of their face", received, "mesh the solid again: its cells overlap"


def _touching_edges(points: Array, tets: Index) -> Fault | None:
    faces = boundary(points, tets)
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    rows, count = np.unique(sides, axis=0, return_counts=True)
    if count.max(initial=2) <= 2:
        return None
    one, other = rows[int(np.argmax(count > 2))].tolist()
    received = (
        f"pieces that touch only in the edge from point {one} to {other} ({int((count > 2).sum())} in all)"
    )
    return "the surface of a mesh does not touch itself", received, "fill the gap, or move the pieces apart"
