"""The bodies cut by mirror planes: what of them lies in one chamber of the device's symmetry."""

from collections import Counter

import numpy as np
from netgen import occ

from fieldmap.device.model import Device
from fieldmap.iron.geometry.shapes import KERNEL_ERRORS, MILLIMETRES, point
from fieldmap.iron.geometry.solids import glue_bodies
from fieldmap.iron.symmetry.chamber import Chamber

# The pieces of all chambers must add up to the whole, to this fraction of its volume and of its outer surface.
_DEFECT = 1e-5


def glue_chamber(device: Device, chamber: Chamber) -> occ.TopoDS_Shape | None:
    """The bodies' pieces inside the chamber, glued like those of `glue_bodies`, mm.

    None where the kernel cannot cut them, or its pieces do not add up to the bodies.
    """
    whole = glue_bodies(device)
    try:
        cut = whole * _chamber_solid(chamber, whole)
    except KERNEL_ERRORS:
        return None
    sizes = {body.name: body.mesh_size * MILLIMETRES for body in device.bodies}
    for piece in cut.solids:
        if piece.name not in sizes:
            return None
        piece.maxh = sizes[piece.name]
    if abs(cut.mass * chamber.group.order / whole.mass - 1) > _DEFECT:
        return None
    area = _outer_area(cut, chamber) * chamber.group.order
    return cut if abs(area / _outer_area(whole, None) - 1) < _DEFECT else None


def _outer_area(shape: occ.TopoDS_Shape, chamber: Chamber | None) -> float:
    """Area of the faces that belong to one solid only, those in the chamber's walls left out."""
    owners = Counter(face for solid in shape.solids for face in solid.faces)
    return sum(face.mass for face, count in owners.items() if count == 1 and not _in_wall(face, chamber))


def _in_wall(face: occ.Face, chamber: Chamber | None) -> bool:
    if chamber is None:
        return False
    at = np.array([face.center.x, face.center.y, face.center.z]) / MILLIMETRES - chamber.group.centre
    # All of the face lies on one side: its centre is on the wall only where all of it is.
    return bool(np.abs(chamber.walls @ at).min() < chamber.group.tolerance)


def _chamber_solid(chamber: Chamber, whole: occ.TopoDS_Shape) -> occ.TopoDS_Shape:
    """The chamber as far as the whole reaches, and farther."""
    centre = chamber.group.centre * MILLIMETRES
    corners = np.array([(p.x, p.y, p.z) for p in whole.bounding_box])
    reach = 3.0 * float(np.linalg.norm(np.abs(corners - centre).max(axis=0)))
    space = None
    for wall in chamber.walls:
        # A cube that stands on the wall; the kernel's own half-spaces crash it.
        side = np.eye(3)[np.abs(wall).argmin()]
        side = side - (side @ wall) * wall
        frame = occ.Axes(point(*centre), n=occ.Dir(*map(float, wall)), h=occ.Dir(*map(float, side)))
        cube = occ.Box(point(-reach, -reach, 0.0), point(reach, reach, 2 * reach))
        cube = occ.gp_Trsf.Transformation(frame).Inverted()(cube)
        space = cube if space is None else space * cube
    return space
