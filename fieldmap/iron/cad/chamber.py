"""The bodies cut by mirror planes: what of them lies in one chamber of the device's symmetry."""

import numpy as np
from netgen import occ
from numpy.typing import NDArray

from fieldmap.device.model import Device
from fieldmap.device.symmetry.chamber import Chamber
from fieldmap.iron.cad.shapes import KERNEL_ERRORS, MILLIMETRES, point
from fieldmap.iron.cad.solids import body_solid, device_label, glue_solids

Array = NDArray[np.float64]
# The pieces of all chambers must add up to the whole, to this fraction of its volume.
_VOLUME_DEFECT = 1e-5


def glue_chamber(device: Device, chamber: Chamber) -> occ.TopoDS_Shape | None:
    """The bodies' pieces inside the chamber, glued like `glue_bodies`, mm.

    None where the kernel cannot cut them, or its pieces do not add up to the bodies.
    """
    solids = [body_solid(body, device_label(device)) for body in device.bodies]
    try:
        space = _chamber_solid(chamber, solids)
        cut = [solid * space for solid in solids]
    except KERNEL_ERRORS:
        return None
    whole = sum(solid.mass for solid in solids)
    volume = sum(solid.mass for solid in cut) * chamber.group.order
    if abs(volume - whole) > _VOLUME_DEFECT * whole:
        return None
    for body, solid in zip(device.bodies, cut, strict=True):
        for piece in solid.solids:
            piece.name = body.name
            piece.maxh = body.mesh_size * MILLIMETRES
    return glue_solids(cut)


def _chamber_solid(chamber: Chamber, solids: list[occ.TopoDS_Shape]) -> occ.TopoDS_Shape:
    """The chamber as far as the solids reach, and farther."""
    centre = chamber.group.centre * MILLIMETRES
    corners = np.array([[(p.x, p.y, p.z) for p in solid.bounding_box] for solid in solids])
    reach = 3.0 * float(np.linalg.norm(corners - centre, axis=2).max())
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
