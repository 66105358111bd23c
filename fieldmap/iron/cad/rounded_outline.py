"""Closed plane paths with rounded corners, and the curves at a constant distance beside them.

Everything here is plain numbers in the unit of the caller; nothing knows the mesher.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RELATIVE_LENGTH = 1e-9
"""Lengths below this fraction of the longest side, and turns below this angle, are rounding."""


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
    `end` to the next one's `start`; `fieldmap.device.polygons.rounding_fault` says whether corners fit sides.
    Raises ValueError where the offset is larger than the radius on the inner side of a bend.
    """
    along, lengths, turn = _sides(corners)
    before = np.roll(along, 1, axis=0)
    slack = RELATIVE_LENGTH * lengths.max()
    return tuple(
        _rounded_corner(corners[i], before[i], along[i], float(turn[i]), radius, offset, slack)
        for i in range(len(corners))
    )


def outline_points(outline: tuple[Corner, ...]) -> Array:
    """Points (n, 2) along an outline in order: the ends and the middle of every arc, once each."""
    points = [point for corner in outline for point in (corner.start, corner.middle, corner.end)]
    slack = RELATIVE_LENGTH * max(np.ptp(points, axis=0))
    return np.array([p for i, p in enumerate(points) if np.linalg.norm(p - points[i - 1]) > slack])


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
