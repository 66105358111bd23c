"""Plane polygons: whether they bound a region, and their outline with rounded corners.

Everything here is plain numbers in the unit of the caller; nothing knows the mesher.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RELATIVE_LENGTH = 1e-9
"""Lengths below this fraction of the polygon's size are rounding: corners this near to each other are one."""


def signed_area(points: Array) -> float:
    """Area of a closed polygon `points` (n, 2), positive when they run counter-clockwise."""
    x, y = points[:, 0], points[:, 1]
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def polygon_fault(points: Array) -> str | None:
    """What keeps `points` (n, 2) from being a simple polygon, in words, or None.

    Simple: at least three finite corners, no corner twice, no side of length zero, and no two sides that meet
    anywhere but at the corner between neighbours.
    """
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 3:
        return f"an array of shape {points.shape}"
    if not np.isfinite(points).all():
        return f"corner {int(np.argmax(~np.isfinite(points).all(axis=1)))} that is not finite"
    crossing = _meeting_sides(points)
    if crossing is not None:
        return f"sides {crossing[0]} and {crossing[1]} that meet (sides are counted from 0)"
    size = np.ptp(points, axis=0).max()
    if abs(signed_area(points)) <= RELATIVE_LENGTH * size**2:
        return "corners that enclose no area"
    return None


def _meeting_sides(points: Array) -> tuple[int, int] | None:
    """The first two sides that meet although they are not neighbours, or that fold back on each other."""
    n = len(points)
    ends = np.roll(points, -1, axis=0)
    tolerance = RELATIVE_LENGTH * max(np.ptp(points, axis=0).max(), np.finfo(float).tiny)
    for i in range(n):
        if np.linalg.norm(ends[i] - points[i]) <= tolerance:
            return i, (i + 1) % n
        back = (i + 1) % n
        if _folds_back(points[i], ends[i], ends[back]):
            return i, back
        for j in range(i + 2, n):
            if (j + 1) % n != i and _distance(points[i], ends[i], points[j], ends[j]) <= tolerance:
                return i, j
    return None


def _folds_back(first: Array, corner: Array, last: Array) -> bool:
    """True where the path turns by 180 degrees at `corner`."""
    u, v = corner - first, last - corner
    cross = u[0] * v[1] - u[1] * v[0]
    size = np.linalg.norm(u) * np.linalg.norm(v)
    return bool(u @ v < 0 and abs(cross) <= RELATIVE_LENGTH * size)


def _distance(a: Array, b: Array, c: Array, d: Array) -> float:
    """Shortest distance of the segments a-b and c-d in the plane."""

    def side(p: Array, q: Array, r: Array) -> float:
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

    def to_segment(r: Array, p: Array, q: Array) -> float:
        t = np.clip((r - p) @ (q - p) / ((q - p) @ (q - p) or 1.0), 0.0, 1.0)
        return float(np.linalg.norm(r - p - t * (q - p)))

    if side(a, b, c) * side(a, b, d) < 0 and side(c, d, a) * side(c, d, b) < 0:
        return 0.0
    return min(to_segment(a, c, d), to_segment(b, c, d), to_segment(c, a, b), to_segment(d, a, b))


@dataclass(frozen=True, eq=False)
class Corner:
    """A rounded corner: the arc enters at `start`, passes `middle`, leaves at `end` (each (2,)).

    The three points coincide where the radius is zero, and where the path goes straight on.
    """

    start: Array
    middle: Array
    end: Array


def rounded_outline(corners: Array, radius: float, offset: float) -> tuple[Corner, ...]:
    """The curve at distance `offset` to the left of a closed path whose corners are rounded with `radius`.

    corners (n, 2): where the straight pieces would meet, in order. The straight pieces run from one corner's
    `end` to the next one's `start`. Raises ValueError where a corner does not fit its sides or the offset is
    larger than the radius on the inner side of a bend.
    """
    along, lengths, turn = _sides(corners)
    before = np.roll(along, 1, axis=0)
    taken = radius * np.tan(np.abs(turn) / 2)
    slack = RELATIVE_LENGTH * lengths.max()
    for i, length in enumerate(lengths):
        if taken[i] + taken[(i + 1) % len(lengths)] > length + slack:
            raise ValueError(f"the corners at both ends of side {i} need more than its length")
    return tuple(
        _rounded_corner(corners[i], before[i], along[i], float(turn[i]), radius, offset, slack)
        for i in range(len(corners))
    )


def middle_length(corners: Array, radius: float) -> float:
    """Length of the closed path of `rounded_outline` itself (offset 0)."""
    _, lengths, turn = _sides(corners)
    return float(lengths.sum() + radius * (np.abs(turn) - 2 * np.tan(np.abs(turn) / 2)).sum())


def _sides(corners: Array) -> tuple[Array, Array, Array]:
    """Directions (n, 2) and lengths (n,) of the sides that leave the corners; turns (n,), left > 0."""
    along = np.roll(corners, -1, axis=0) - corners
    lengths = np.linalg.norm(along, axis=1)
    along = along / lengths[:, None]
    before = np.roll(along, 1, axis=0)
    cross = before[:, 0] * along[:, 1] - before[:, 1] * along[:, 0]
    return along, lengths, np.arctan2(cross, np.sum(before * along, axis=1))


def _rounded_corner(
    corner: Array, before: Array, after: Array, turn: float, radius: float, offset: float, slack: float
) -> Corner:
    """One corner of `rounded_outline`: directions `before` and `after`, turning angle `turn` (left > 0)."""
    left = np.array([-before[1], before[0]])
    if abs(turn) < RELATIVE_LENGTH:
        point = corner + offset * left
        return Corner(point, point, point)
    bent = np.sign(turn)
    inner = radius - bent * offset
    if inner < -slack:
        raise ValueError("half the thickness is larger than the corner radius")
    inner = max(inner, 0.0)
    centre = corner - radius * np.tan(abs(turn) / 2) * before + bent * radius * left
    towards = corner - centre
    start = centre - bent * inner * left
    end = centre - bent * inner * np.array([-after[1], after[0]])
    return Corner(start, centre + inner * towards / np.linalg.norm(towards), end)
