"""Points in a box for the evaluation of a field, and grids of them. Boxes in m, grids in mm."""

import numpy as np
import pyvista as pv
from numpy.typing import ArrayLike

from fieldmap.arguments import check_choice
from fieldmap.field import Bounds
from fieldmap.typing import Array

MM = 1e3
AXES = "xyz"


def pose(rotation: Array, at: Array) -> Array:
    """Matrix (4, 4) of a rotation (3, 3) and a translation (3,)."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, at
    return matrix


def inside(box: Bounds) -> tuple[Array, Array]:
    """Corners (3,), m, slightly inside the box, so that rounding leaves no point outside."""
    lower, upper = (np.asarray(corner, dtype=float) for corner in box)
    inset = 1e-9 * (upper - lower)
    return lower + inset, upper - inset


def grid_points(grid: pv.DataSet, box: Bounds) -> Array:
    """Points (n, 3), m, of a grid that lies in a box."""
    return np.clip(np.asarray(grid.points) / MM, *inside(box))


def plane_of(
    box: Bounds, normal: str, at: float | None, count: tuple[int, int]
) -> tuple[Array, tuple[int, int]]:
    """Points (n, 3), m, in the middle of `count` cells of a plane through a box, the first axis slowest; and the two
    axes of the plane.

    at: where the plane crosses the axis `normal`, m; the middle of the box unless given.
    """
    check_choice("normal", normal, AXES)
    lower, upper = (np.asarray(corner, dtype=float) for corner in box)
    across = AXES.index(normal)
    first, second = (k for k in range(3) if k != across)
    x, y = (
        lower[k] + (np.arange(n) + 0.5) / n * (upper - lower)[k]
        for k, n in zip((first, second), count, strict=True)
    )
    places = np.empty((*count, 3))
    places[..., across] = 0.5 * (lower + upper)[across] if at is None else at
    places[..., first], places[..., second] = x[:, None], y
    return places.reshape(-1, 3), (first, second)


def box_grid(box: Bounds, counts: ArrayLike) -> pv.ImageData:
    """A grid of `counts` points along each axis that fills a box."""
    lower, upper = (np.asarray(corner, dtype=float) for corner in box)
    x, y, z = np.asarray(counts, dtype=int).tolist()
    spacing = MM * (upper - lower) / np.maximum([x - 1, y - 1, z - 1], 1)
    return pv.ImageData(dimensions=(x, y, z), spacing=spacing, origin=MM * lower)


def plane_grids(box: Bounds, points: int = 61, floor: bool = True) -> list[pv.ImageData]:
    """Grids on the planes x = middle and y = middle of a box, and on its floor."""
    lower, upper = (np.asarray(corner, dtype=float) for corner in box)
    middle = 0.5 * (lower + upper)
    planes = []
    for axis, at in ((0, middle[0]), (1, middle[1]), (2, lower[2]))[: 3 if floor else 2]:
        flat = np.arange(3) == axis
        ends = np.where(flat, at, lower), np.where(flat, at, upper)
        planes.append(box_grid(ends, np.where(flat, 1, points)))
    return planes
