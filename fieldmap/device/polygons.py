"""Simple closed polygons, and the rules for outlines and radii that shapes and coils share."""

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field, ValidationInfo

from fieldmap.inputs.tables import PlanePoint, Point, broken
from fieldmap.typing import Array

PlanePoints = Sequence[Sequence[float]]
FourPoints = Annotated[list[Point], Field(min_length=4)]
Polygon = Annotated[list[PlanePoint], Field(min_length=3)]


def _edges(points: PlanePoints | Array) -> tuple[Array, Array]:
    """First and last points (n, 2) of the edges."""
    start = np.asarray(points, dtype=float).reshape(-1, 2)
    return start, np.roll(start, -1, axis=0)


def _cross(one: Array, other: Array) -> Array:
    return np.asarray(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0])


def signed_area(points: PlanePoints | Array) -> float:
    """Signed area, positive if the corners run counter-clockwise (shoelace formula)."""
    return float(_cross(*_edges(points)).sum() / 2)


def polygon_fault(points: PlanePoints | Array) -> str | None:
    """The reason why a closed polygon is not simple (corners counted from 1), or None.

    >>> polygon_fault([[0, 0], [1, 1], [1, 0], [0, 1]])
    'edge 1-2 meets edge 3-4'
    """
    start, end = _edges(points)
    count = len(start)
    if count < 3:
        return f"only {count} corners"
    same = np.flatnonzero((start == end).all(axis=1))
    if same.size:
        return f"corners {same[0] + 1} and {(same[0] + 1) % count + 1} are the same point"
    for i in range(count):
        meeting = np.flatnonzero(_meeting(start, end, i)[i + 1 :])
        if meeting.size:
            j = i + 1 + int(meeting[0])
            return f"edge {i + 1}-{i + 2} meets edge {j + 1}-{(j + 1) % count + 1}"
    extent = np.linalg.norm(start - start[0], axis=1).max()
    return "all corners lie on one line" if abs(signed_area(points)) <= 1e-12 * extent**2 else None


def _meeting(start: Array, end: Array, i: int) -> Any:
    """Which edges (n,) share a point with edge i. Its two neighbours count only if they run back over it."""
    ours, theirs = _sides(start[i], end[i], start), _sides(start, end, start[i])
    their_end = _sides(start, end, end[i])
    meeting = (ours * np.roll(ours, -1) < 0) & (theirs * their_end < 0)
    touching = (ours == 0) & _between(start[i], end[i], start)
    meeting |= touching | np.roll(touching, -1)
    meeting |= ((theirs == 0) & _between(start, end, start[i])) | (
        (their_end == 0) & _between(start, end, end[i])
    )
    before, after = (i - 1) % len(start), (i + 1) % len(start)
    meeting[after] = ours[(i + 2) % len(start)] == 0 and (start[i] - end[i]) @ (end[after] - end[i]) > 0
    meeting[before] = ours[before] == 0 and (end[i] - start[i]) @ (start[before] - start[i]) > 0
    return meeting


def _sides(a: Array, b: Array, p: Array) -> Array:
    """On which side of the line a-b points p lie: 1, -1, or 0 on it (to rounding)."""
    cross = _cross(b - a, p - a)
    far = np.maximum(np.linalg.norm(p - a, axis=-1), np.linalg.norm(p - b, axis=-1))
    return np.where(np.abs(cross) <= 1e-12 * np.linalg.norm(b - a, axis=-1) * far, 0.0, np.sign(cross))


def _between(a: Array, b: Array, p: Array) -> Any:
    return ((np.minimum(a, b) <= p) & (p <= np.maximum(a, b))).all(axis=-1)


def rounding_fault(points: PlanePoints, radius: float) -> str | None:
    """Which edge is too short for its two rounded corners, or None.

    An arc of radius R that turns by the angle a uses R tan(a/2) of both edges at its corner.
    """
    start, end = _edges(points)
    after, before = end - start, np.roll(end - start, 1, axis=0)
    used = radius * np.tan(np.arctan2(np.abs(_cross(before, after)), (before * after).sum(axis=1)) / 2)
    length, needed = np.linalg.norm(after, axis=1), used + np.roll(used, -1)
    short = np.flatnonzero(needed > length * (1 + 1e-9))
    if not short.size:
        return None
    k, count = int(short[0]), len(start)
    return f"edge {k + 1}-{(k + 1) % count + 1} is {length[k]:g} mm long but its arcs need {needed[k]:g} mm"


def reflected_polygon(points: PlanePoints, axis: int) -> list[list[float]]:
    """The polygon with the sign of one coordinate (0 or 1) changed, and its corners in the opposite order, so that
    their sense of rotation stays.

    >>> reflected_polygon([[0, 0], [2, 0], [2, 1]], 0)
    [[-2.0, 1.0], [-2.0, 0.0], [0.0, 0.0]]
    """
    signs = [-1.0 if k == axis else 1.0 for k in range(2)]
    reflected: list[list[float]] = (np.asarray(points, dtype=float)[::-1] * signs + 0.0).tolist()
    return reflected


# ---- rules of files ----


def require_simple(points: list[list[float]]) -> list[list[float]]:
    """Raise unless the corners make a simple polygon."""
    fault = polygon_fault(points)
    if fault is not None:
        raise broken(
            "the corners must make a simple polygon: no repeated corner, no edge that meets another one",
            fault,
            "list the corners once round the outline, in order, without repeating the first one",
        )
    return points


SimplePolygon = Annotated[Polygon, AfterValidator(require_simple)]


def counter_clockwise(points: list[list[float]]) -> list[list[float]]:
    """The same polygon with its corners in counter-clockwise order."""
    return points if signed_area(points) > 0 else points[::-1]


def require_larger_radius(outer: float, info: ValidationInfo) -> None:
    """Raise unless the outer radius is larger than the inner one, which is read first."""
    inner = info.data.get("inner_radius_mm")
    if inner is not None and outer <= inner:
        raise broken(
            f"outer_radius_mm must be larger than inner_radius_mm = {inner:g}",
            f"{outer:g}",
            "swap the two, or correct one (both are radii, not diameters)",
        )
