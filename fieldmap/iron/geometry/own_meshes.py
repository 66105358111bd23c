"""Bodies that are meshes of the user's own: their tetrahedra in the global frame, and their solids."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from fieldmap.device.mesh_files import read_mesh
from fieldmap.device.model import Body, MeshFile, VolumeMesh
from fieldmap.device.surfaces import crossing_triangles, enclosed_volume
from fieldmap.device.tetrahedra import boundary, oriented, tetrahedra_fault, volumes
from fieldmap.errors import GeometryError, InputError, Problem
from fieldmap.iron.geometry.cad_kernel import kernel_errors, occ
from fieldmap.iron.geometry.shapes import MILLIMETRES, polygon_face
from fieldmap.typing import Array, Index

_SAME_VOLUME = 1e-6
# m; the kernel's contact distance.
_ONE_POINT = 1e-10


def own_mesh(body: Body) -> tuple[Array, Index]:
    """Points (n, 3) in m, global frame, and tetrahedra (m, 4) of positive volume, of a body that is a mesh.

    Raises GeometryError for a file that cannot be read and for tetrahedra that fill no solid.
    """
    where = f"body '{body.name}'"
    if len(body.parts) != 1 or body.parts[0].operation != "add":
        must_hold, remedy = "a mesh must be a body of its own", "mesh the solid after all cuts"
        raise GeometryError(Problem(where, must_hold, f"{len(body.parts)} parts", remedy))
    (part,) = body.parts
    shape = part.shape
    if isinstance(shape, MeshFile):
        try:
            mesh = read_mesh(shape.path, shape.region)
        except InputError as error:
            problems = (
                Problem(f"{where}: {one.where}", one.must_hold, one.received, one.remedy)
                for one in error.problems
            )
            raise GeometryError(*problems) from error
        local, tets = shape.scale * mesh.points, mesh.tets
    elif isinstance(shape, VolumeMesh):
        local, tets = np.asarray(shape.points, np.float64), np.asarray(shape.tetrahedra, np.int64)
        fault = tetrahedra_fault(local, tets)
        if fault is not None:
            raise GeometryError(Problem(where, *fault))
    else:
        raise GeometryError(Problem(where, "must be a mesh", type(shape).__name__, "see help(fieldmap.Body)"))
    placement = part.placement
    points = local @ np.asarray(placement.rotation, np.float64).T + np.asarray(placement.position, np.float64)
    return points, oriented(points, tets)


def joined(meshes: Sequence[tuple[Array, Index]]) -> tuple[Array, list[Index]]:
    """One list of points (n, 3), those nearer than the kernel's contact distance once, and the tetrahedra of each."""
    points = np.concatenate([points for points, _ in meshes])
    pairs = cKDTree(points).query_pairs(_ONE_POINT, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(points),) * 2)
    count, label = connected_components(graph)
    first = np.full(count, len(points))
    np.minimum.at(first, label, np.arange(len(points)))
    order = np.argsort(first)
    rank = np.empty(count, np.int64)
    rank[order] = np.arange(count)
    starts = np.cumsum([0, *(len(points) for points, _ in meshes)])
    return points[first[order]], [
        rank[label[start + tets]] for start, (_, tets) in zip(starts[:-1], meshes, strict=True)
    ]


def common_area(one: tuple[Array, Index], other: tuple[Array, Index]) -> float:
    """Area, m^2, of the boundary faces that two meshes have in common."""
    points, tets = joined([one, other])
    faces = [boundary(points, each) for each in tets]
    keys = [set(map(tuple, np.sort(each, axis=1).tolist())) for each in faces]
    common = np.array(sorted(keys[0] & keys[1]), np.int64).reshape(-1, 3)
    a, b, c = (points[common[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def higher_order_cells(body: Body) -> int:
    """How many of its tetrahedra have nodes beside their corners in its file."""
    shape = body.parts[0].shape
    return read_mesh(shape.path, shape.region).higher_order if isinstance(shape, MeshFile) else 0


def solid_of_mesh(body: Body) -> occ.TopoDS_Shape:
    """What its tetrahedra fill, as a solid of the CAD kernel, mm: boundary triangles sewn together, those in one plane
    one face. Raises GeometryError where the boundary cuts itself or pieces of the mesh overlap.
    """
    points, tets = own_mesh(body)
    corners, where = points * MILLIMETRES, f"body '{body.name}'"
    faces = boundary(corners, tets)
    crossing = crossing_triangles(corners, faces)
    if crossing is not None:
        at = ", ".join(f"{x:.6g}" for x in corners[faces[crossing[0]]].mean(axis=0))
        remedy = "mesh the solid again: its cells overlap"
        must_hold = "the boundary of a mesh must not cut itself"
        raise GeometryError(Problem(where, must_hold, f"two faces that do, at ({at}) mm", remedy))
    volume = float(volumes(corners, tets).sum())
    try:
        solid = _inside(corners, faces)
        filled = float(solid.mass)
    except kernel_errors() as error:
        received = str(error).strip() or type(error).__name__
        must_hold, remedy = "the boundary of a mesh must enclose a solid", "mesh the solid again"
        raise GeometryError(Problem(where, must_hold, received, remedy)) from error
    if abs(filled - volume) > _SAME_VOLUME * volume:
        received = f"tetrahedra of {volume:.6g} mm^3 that fill {filled:.6g} mm^3"
        remedy = "mesh the solid again: its cells overlap"
        raise GeometryError(Problem(where, "tetrahedra must not overlap", received, remedy))
    return solid


def _inside(points: Array, faces: Index) -> occ.TopoDS_Shape:
    """The solid within closed shells: the largest first, what is in a hole of another after the hole."""
    shells = [(enclosed_volume(points, shell), shell) for shell in _shells(faces)]
    shells.sort(key=lambda pair: -abs(pair[0]))
    pieces = [
        occ.Solid(occ.Sew([polygon_face(points[face]) for face in (shell if volume > 0 else shell[:, ::-1])]))
        for volume, shell in shells
    ]
    solid = pieces[0].UnifySameDomain()
    for (volume, _), piece in zip(shells[1:], pieces[1:], strict=True):
        other = piece.UnifySameDomain()
        solid = solid + other if volume > 0 else solid - other
    return solid


def _shells(faces: Index) -> list[Index]:
    """Triangles that hang together through their edges."""
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    order = np.lexsort(sides.T)
    one, other = order[::2] // 3, order[1::2] // 3
    pairs = coo_matrix((np.ones(len(one)), (one, other)), shape=(len(faces),) * 2)
    count, label = connected_components(pairs)
    return [faces[label == k] for k in range(count)]
