"""Coils as solid windings, and arrows along their current. In mm."""

import numpy as np
import pyvista as pv

from fieldmap.device.coils import Coil
from fieldmap.plot.bodies import MM, placed
from fieldmap.plot.sweeps import closed_tube
from fieldmap.typing import Array

ARC_SEGMENTS = 24


def middle_line(coil: Coil) -> tuple[Array, Array]:
    """Middle line (n, 2) of the winding in its local plane, mm, and the unit normals (n, 2) to its right.

    It runs in the sense of a positive current at polarity +1; the normals point outward.
    """
    path = coil.winding()
    if path.is_circle:
        (points, normals), *_ = path.outline(0.0, 4 * ARC_SEGMENTS + 1)
        return MM * points[:-1], normals[:-1]
    arcs = [piece for piece in path.outline(0.0, ARC_SEGMENTS + 1) if len(piece[0]) > 2]
    points, normals = (np.concatenate([piece[k] for piece in arcs]) for k in range(2))
    return MM * points, normals


def winding_surface(coil: Coil) -> pv.PolyData:
    """The winding as a solid, global frame, mm."""
    line, normal = middle_line(coil)
    half_width, half_height = 0.5 * MM * coil.winding().thickness, 0.5 * MM * coil.height
    section = [(-half_width, -half_height), (half_width, -half_height)]
    section += [(half_width, half_height), (-half_width, half_height)]
    rings = [np.column_stack([line + offset * normal, np.full(len(line), z)]) for offset, z in section]
    return placed(closed_tube(np.array(rings)), coil.placement)


def current_arrow(coil: Coil, share: float = 0.3, away_from: tuple[float, float] = (0.0, 0.0)) -> pv.PolyData:
    """An arrow along a positive coil current on the outside of the winding, global frame, mm.

    share: the part of the turn that it covers, centred on the side that faces away from the vertical line
    through `away_from` (mm).
    """
    line, normal = middle_line(coil)
    gap = 0.5 * MM * coil.winding().thickness + 0.6
    loop = np.column_stack([line + gap * normal, np.zeros(len(line))])
    outward = placed(pv.PolyData(loop), coil.placement).points[:, :2] - np.array(away_from)
    loop = _arc_about(loop, int(np.argmax(np.linalg.norm(outward, axis=1))), share)
    if coil.polarity < 0:
        loop = loop[::-1]
    size = 0.09 * MM * coil.height
    shaft = pv.Spline(loop, 200).tube(radius=0.25 * size, n_sides=16)
    tip = pv.Cone(
        center=loop[-1], direction=loop[-1] - loop[-3], height=2.4 * size, radius=0.8 * size, resolution=32
    )
    return placed(pv.merge([shaft, tip.extract_surface(algorithm=None)], merge_points=False), coil.placement)


def _arc_about(loop: Array, middle: int, share: float) -> Array:
    """The part of a closed line (n, 3) whose length is `share` of the whole, centred on point `middle`."""
    step = np.linalg.norm(np.roll(loop, -1, axis=0) - loop, axis=1)
    along = np.concatenate([[0.0], np.cumsum(step)])
    closed = np.vstack([loop, loop[:1]])
    where = along[middle] + along[-1] * share * np.linspace(-0.5, 0.5, 60)
    return np.column_stack([np.interp(where % along[-1], along, closed[:, axis]) for axis in range(3)])
