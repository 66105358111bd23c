"""Iron bodies as solids of the CAD kernel, and all of them glued together for the mesher.

The kernel is Open CASCADE, reached through netgen. Inside it lengths are millimetres (`fieldmap.iron.geometry.shapes`
says why), elsewhere metres. Primitives stay true curved surfaces, onto which the mesher may curve elements. For a body
that the user gives as a mesh, the solid is the space that its tetrahedra fill.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from fieldmap.device.mesh_files import read_mesh
from fieldmap.device.model import Body, Device, MeshFile, Shape, StepFile, VolumeMesh
from fieldmap.device.surfaces import crossing_triangles
from fieldmap.device.tetrahedra import boundary, oriented, tetrahedra_fault, volumes
from fieldmap.errors import GeometryError, InputError, Problem
from fieldmap.iron.geometry import shapes
from fieldmap.iron.topology import area_vectors, connected
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
        raise GeometryError.of(where, must_hold, f"{len(body.parts)} parts", remedy)
    (part,) = body.parts
    shape = part.shape
    if isinstance(shape, MeshFile):
        try:
            mesh = read_mesh(shape.path, shape.region)
        except InputError as error:
            problems = (replace(one, where=f"{where}: {one.where}") for one in error.problems)
            raise GeometryError(*problems) from error
        local, tets = shape.scale * mesh.points, mesh.tets
    elif isinstance(shape, VolumeMesh):
        local, tets = np.asarray(shape.points, np.float64), np.asarray(shape.tetrahedra, np.int64)
        fault = tetrahedra_fault(local, tets)
        if fault is not None:
            raise GeometryError.of(where, *fault)
    else:
        raise GeometryError.of(where, "must be a mesh", type(shape).__name__, "see help(fieldmap.Body)")
    placement = part.placement
    points = local @ np.asarray(placement.rotation, np.float64).T + np.asarray(placement.position, np.float64)
    return points, oriented(points, tets)


def joined(meshes: Sequence[tuple[Array, Index]]) -> tuple[Array, list[Index]]:
    """One list of points (n, 3), merged where nearer than the kernel's contact distance, and each mesh's tetrahedra."""
    points = np.concatenate([points for points, _ in meshes])
    pairs = cKDTree(points).query_pairs(_ONE_POINT, output_type="ndarray")
    label = connected(pairs, len(points))
    first = np.unique(label, return_index=True)[1]
    order = np.argsort(first)
    rank = np.argsort(order)
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
    return float(np.linalg.norm(area_vectors(points[common]), axis=1).sum() / 2)


def higher_order_cells(body: Body) -> int:
    """Number of tetrahedra in the body's file that have more nodes than their corners."""
    shape = body.parts[0].shape
    return read_mesh(shape.path, shape.region).higher_order if isinstance(shape, MeshFile) else 0


def solid_of_mesh(body: Body) -> shapes.occ.TopoDS_Shape:
    """The space that a body's tetrahedra fill, as a solid of the CAD kernel, mm. Boundary triangles in one plane become
    one face. Raises GeometryError where the boundary cuts itself or pieces of the mesh overlap.
    """
    points, tets = own_mesh(body)
    corners, where = points * shapes.MILLIMETRES, f"body '{body.name}'"
    faces = boundary(corners, tets)
    crossing = crossing_triangles(corners, faces)
    if crossing is not None:
        at = ", ".join(f"{x:.6g}" for x in corners[faces[crossing[0]]].mean(axis=0))
        remedy = "mesh the solid again: its cells overlap"
        must_hold = "the boundary of a mesh must not cut itself"
        raise GeometryError.of(where, must_hold, f"two faces that do, at ({at}) mm", remedy)
    volume = float(volumes(corners, tets).sum())
    try:
        solid = shapes.inside_shells(corners, faces)
        filled = float(solid.mass)
    except shapes.kernel_errors() as error:
        received = str(error).strip() or type(error).__name__
        must_hold, remedy = "the boundary of a mesh must enclose a solid", "mesh the solid again"
        raise GeometryError.of(where, must_hold, received, remedy) from error
    if abs(filled - volume) > _SAME_VOLUME * volume:
        received = f"tetrahedra of {volume:.6g} mm^3 that fill {filled:.6g} mm^3"
        remedy = "mesh the solid again: its cells overlap"
        raise GeometryError.of(where, "tetrahedra must not overlap", received, remedy)
    return solid


def device_label(device: Device) -> str:
    """The device in messages: its file, or its name if it was not read from a file."""
    return str(device.source) if device.source is not None else f"device '{device.name}'"


def body_solid(body: Body, source: str | None = None) -> shapes.occ.TopoDS_Shape:
    """The body as a solid in the global frame, mm: its parts added and cut in order.

    A body of several pieces is a compound of solids. Each solid carries the body's name and, as `maxh`, the
    mesh size in mm. Faces of one body that lie in one surface are merged: added parts leave no inner edges.
    source: the device file, for messages. Raises GeometryError where a part cannot be built.

    >>> import fieldmap.device.model as model
    >>> part = model.Part(model.Box((0.01, 0.02, 0.03)))
    >>> round(body_solid(model.Body("block", "iron", (part,), mesh_size=0.005)).mass, 6)
    6000.0
    """
    if body.has_own_mesh:
        return shapes.named(solid_of_mesh(body), body.name)
    where = f"{source + ': ' if source else ''}body '{body.name}'"
    solid: shapes.occ.TopoDS_Shape | None = None
    for number, part in enumerate(body.parts):
        try:
            piece = shapes.place(shapes.local_solid(part.shape), part.placement)
            solid = _combined(solid, piece, part.operation)
        except shapes.kernel_errors() as error:
            raise GeometryError(_cannot_build(f"{where}, part {number + 1}", part.shape, error)) from error
    if solid is None:
        raise GeometryError.of(
            where, "a body must have at least one part", "none", "add a part or remove the body"
        )
    for piece in shapes.named(solid, body.name).solids:
        piece.maxh = (body.mesh_size or 0.0) * shapes.MILLIMETRES
    return solid


def _combined(
    solid: shapes.occ.TopoDS_Shape | None, piece: shapes.occ.TopoDS_Shape, operation: str
) -> shapes.occ.TopoDS_Shape:
    if solid is None:
        if operation == "cut":
            raise ValueError("the first part of a body must be added: there is nothing to cut from")
        return piece
    joined = solid - piece if operation == "cut" else solid + piece
    return joined.UnifySameDomain()


def _cannot_build(where: str, shape: Shape, error: Exception) -> Problem:
    reason = str(error).strip().rstrip(":") or type(error).__name__
    from_file = isinstance(shape, StepFile)
    must_hold = "a part must be a solid that the CAD kernel can build"
    remedy = "export it again as a solid" if from_file else "correct its dimensions"
    return Problem(where, must_hold, f"{type(shape).__name__}: {reason}", remedy)


def glue_solids(solids: Iterable[shapes.occ.TopoDS_Shape]) -> shapes.occ.TopoDS_Shape:
    """One compound in which solids that touch share faces, edges and corners. Names and mesh sizes stay."""
    return shapes.occ.Glue([piece for solid in solids for piece in solid.solids])


def glue_bodies(device: Device) -> shapes.occ.TopoDS_Shape:
    """All bodies of the device in one compound, mm. Bodies that touch share the faces in which they touch.

    Every solid carries its body's name and, as `maxh`, its mesh size in mm. The device is taken to be sound;
    `fieldmap.iron.geometry.checks.check_geometry` says whether it is. Raises GeometryError where a body
    cannot be built or there is none.
    """
    source = device_label(device)
    if not device.bodies:
        raise GeometryError.of(source, "a device must have a body to mesh", "none", "solve it as coils alone")
    return glue_solids(body_solid(body, source) for body in device.bodies)
