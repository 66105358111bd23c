"""Coils as solid windings, and arrows along their current. In mm."""

import numpy as np
import pyvista as pv

from fieldmap.device.model import CircularCoil, Coil, RoundedRectangleCoil
from fieldmap.plot.bodies import MM, placed
from fieldmap.plot.sweeps import closed_tube
from fieldmap.typing import Array

ARC_SEGMENTS = 24


def middle_line(coil: Coil) -> tuple[Array, Array]:
    """Middle line (n, 2) of the winding in its local plane, mm, and the unit normals (n, 2) to its right.

    It runs in the sense of a positive current at polarity +1; the normals point outward.
    """
    if isinstance(coil, CircularCoil):
        angle = 2.0 * np.pi * np.arange(4 * ARC_SEGMENTS) / (4 * ARC_SEGMENTS)
        normal = np.column_stack([np.cos(angle), np.sin(angle)])
        return 0.5 * MM * (coil.inner_radius + coil.outer_radius) * normal, normal
    if isinstance(coil, RoundedRectangleCoil):
        x, y = coil.half_width_x, coil.half_width_y
        return _rounded(MM * np.array([[x, -y], [x, y], [-x, y], [-x, -y]]), MM * coil.corner_radius)
    return _rounded(MM * np.asarray(coil.corners), MM * coil.corner_radius)


def _rounded(corners: Array, radius: float) -> tuple[Array, Array]:
    """Polygon (k, 2) with every corner replaced by an arc: points and right-hand normals (n, 2)."""
    points, normals = [], []
    step_in = corners - np.roll(corners, 1, axis=0)
    step_in /= np.linalg.norm(step_in, axis=1, keepdims=True)
    step_out = np.roll(step_in, -1, axis=0)
    for corner, before, after in zip(corners, step_in, step_out, strict=True):
        turn = np.arctan2(before[0] * after[1] - before[1] * after[0], before @ after)
        right = np.array([before[1], -before[0]])
        # A left turn has its centre on the left of the path.
        side = np.sign(turn) if turn else 1.0
        start = corner - radius * np.tan(abs(turn) / 2) * before
        centre = start - side * radius * right
        angle = np.arctan2(right[1], right[0]) + turn * np.linspace(0.0, 1.0, ARC_SEGMENTS + 1)
        normal = np.column_stack([np.cos(angle), np.sin(angle)])
        points.append(centre + side * radius * normal)
        normals.append(normal)
    return np.concatenate(points), np.concatenate(normals)


def winding_surface(coil: Coil) -> pv.PolyData:
    """The winding as a solid, global frame, mm."""
    line, normal = middle_line(coil)
    half_width, half_height = 0.5 * MM * thickness(coil), 0.5 * MM * coil.height
    section = [(-half_width, -half_height), (half_width, -half_height)]
    section += [(half_width, half_height), (-half_width, half_height)]
    rings = [np.column_stack([line + offset * normal, np.full(len(line), z)]) for offset, z in section]
    return placed(closed_tube(np.array(rings)), coil.placement)


def thickness(coil: Coil) -> float:
    """Radial width of the winding, m."""
    if isinstance(coil, CircularCoil):
        return coil.outer_radius - coil.inner_radius
    return coil.thickness


def current_arrow(coil: Coil, share: float = 0.3, away_from: tuple[float, float] = (0.0, 0.0)) -> pv.PolyData:
    """An arrow along a positive coil current on the outside of the winding, global frame, mm.

    share: the part of the turn that it covers, centred on the side that faces away from the vertical line
    through `away_from` (mm).
    """
    line, normal = middle_line(coil)
    gap = 0.5 * MM * thickness(coil) + 0.6
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
