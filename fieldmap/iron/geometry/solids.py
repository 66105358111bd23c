"""Iron bodies as solids of the CAD kernel, and all of them glued together for the mesher.

The kernel is Open CASCADE, reached through netgen. Inside it lengths are millimetres (`fieldmap.iron.geometry.shapes`
says why), elsewhere metres. Primitives stay true curved surfaces, onto which the mesher may curve elements.
"""

from __future__ import annotations

from collections.abc import Iterable

from fieldmap.device.model import Body, Device, Shape, StepFile
from fieldmap.errors import GeometryError, Problem
from fieldmap.iron.geometry.cad_kernel import kernel_errors, occ
from fieldmap.iron.geometry.own_meshes import solid_of_mesh
from fieldmap.iron.geometry.shapes import MILLIMETRES, local_solid, place


def device_label(device: Device) -> str:
    """How messages name the device: its file, or its name where it was not read from one."""
    return str(device.source) if device.source is not None else f"device '{device.name}'"


def body_solid(body: Body, source: str | None = None) -> occ.TopoDS_Shape:
    """The body as a solid in the global frame, mm: its parts added and cut in order.

    A body that is a mesh is what its tetrahedra fill.
    A body of several pieces is a compound of solids. Each solid carries the body's name and, as `maxh`, the
    mesh size in mm. Faces of one body that lie in one surface are merged: added parts leave no inner edges.
    source: the device file, for messages. Raises GeometryError where a part cannot be built.

    >>> import fieldmap.device.model as model
    >>> part = model.Part(model.Box((0.01, 0.02, 0.03)))
    >>> round(body_solid(model.Body("block", "iron", (part,), mesh_size=0.005)).mass, 6)
    6000.0
    """
    if body.has_own_mesh:
        own = solid_of_mesh(body)
        for piece in own.solids:
            piece.name = body.name
        return own
    where = f"{source + ': ' if source else ''}body '{body.name}'"
    solid: occ.TopoDS_Shape | None = None
    for number, part in enumerate(body.parts):
        try:
            piece = place(local_solid(part.shape), part.placement)
            solid = _combined(solid, piece, part.operation)
        except kernel_errors() as error:
            raise GeometryError(_cannot_build(f"{where}, part {number + 1}", part.shape, error)) from error
    if solid is None:
        raise GeometryError(
            Problem(where, "a body must have at least one part", "none", "add a part or remove the body")
        )
    for piece in solid.solids:
        piece.name = body.name
        piece.maxh = (body.mesh_size or 0.0) * MILLIMETRES
    return solid


def _combined(solid: occ.TopoDS_Shape | None, piece: occ.TopoDS_Shape, operation: str) -> occ.TopoDS_Shape:
    if solid is None:
        if operation == "cut":
            raise ValueError("the first part of a body must be added: there is nothing to cut from")
        return piece
    joined = solid - piece if operation == "cut" else solid + piece
    return joined.UnifySameDomain()


def _cannot_build(where: str, shape: Shape, error: Exception) -> Problem:
    reason = str(error).strip().rstrip(":") or type(error).__name__
    from_file = isinstance(shape, StepFile)
    return Problem(
        where,
        "a part must be a solid that the CAD kernel can build",
        f"{type(shape).__name__}: {reason}",
        "export it again as a solid" if from_file else "correct its dimensions",
    )


def glue_solids(solids: Iterable[occ.TopoDS_Shape]) -> occ.TopoDS_Shape:
    """One compound in which solids that touch share faces, edges and corners. Names and mesh sizes stay."""
    return occ.Glue([piece for solid in solids for piece in solid.solids])


def glue_bodies(device: Device) -> occ.TopoDS_Shape:
    """All bodies of the device in one compound, mm. Bodies that touch share the faces in which they touch.

    Every solid carries its body's name and, as `maxh`, its mesh size in mm. The device is taken to be sound;
    `fieldmap.iron.geometry.checks.check_geometry` says whether it is. Raises GeometryError where a body
    cannot be built or there is none.
    """
    source = device_label(device)
    if not device.bodies:
        raise GeometryError(
            Problem(source, "a device must have a body to mesh", "none", "solve it as coils alone")
        )
    return glue_solids(body_solid(body, source) for body in device.bodies)
