"""Points and polygons in the plane, as complex numbers."""

import numpy as np
from numpy.typing import NDArray

from fieldmap.typing import Array

Complex = NDArray[np.complex128]


def inside(points: Complex, polygon: Complex) -> NDArray[np.bool_]:
    """Whether points (n,) lie in a simple polygon (winding number; either side on its edges)."""
    to_corners = polygon[None, :] - points[:, None]
    turns = np.angle(np.roll(to_corners, -1, axis=1) * to_corners.conj()).sum(axis=1)
    return np.abs(turns) > np.pi


def distance_to_edges(points: Complex, polygon: Complex) -> Array:
    """Distance (n,) to the nearest edge of a polygon."""
    start, step = polygon[None, :], (np.roll(polygon, -1) - polygon)[None, :]
    along = np.clip(((points[:, None] - start) / step).real, 0.0, 1.0)
    return np.abs(points[:, None] - start - along * step).min(axis=1)


def edges_cross(first: Complex, second: Complex) -> bool:
    """Whether an edge of one polygon runs through an edge of the other (touching is not crossing)."""
    p, q = first[:, None], np.roll(first, -1)[:, None]
    a, b = second[None, :], np.roll(second, -1)[None, :]
    tolerance = 1e-9 * np.abs(q - p) * np.abs(b - a)

    def side(start: Complex, end: Complex, point: Complex) -> Array:
        area = ((end - start).conj() * (point - start)).imag
        return np.where(np.abs(area) <= tolerance, 0.0, np.sign(area))

    return bool(np.any((side(p, q, a) * side(p, q, b) < 0) & (side(a, b, p) * side(a, b, q) < 0)))
