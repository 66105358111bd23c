"""Is a closed polygon a simple one? Pure geometry, no files."""

import math
from collections.abc import Sequence

PlanePoints = Sequence[Sequence[float]]


def signed_area(points: PlanePoints) -> float:
    """Positive if the corners run counter-clockwise (shoelace formula)."""
    total = 0.0
    for (x1, y1), (x2, y2) in _edges(points):
        total += x1 * y2 - x2 * y1
    return total / 2


def polygon_fault(points: PlanePoints) -> str | None:
    """What keeps the closed polygon from being simple (corners counted from 1), or None.

    >>> polygon_fault([[0, 0], [1, 1], [1, 0], [0, 1]])
    'edge 1-2 meets edge 3-4'
    """
    count = len(points)
    if count < 3:
        return f"only {count} corners"
    for k, (start, end) in enumerate(_edges(points)):
        if tuple(start) == tuple(end):
            return f"corners {k + 1} and {(k + 1) % count + 1} are the same point"
    meeting = _first_meeting(points)
    if meeting is not None:
        return meeting
    if abs(signed_area(points)) <= 1e-12 * _extent(points) ** 2:
        return "all corners lie on one line"
    return None


def rounding_fault(points: PlanePoints, radius: float) -> str | None:
    """Which edge is too short for its two rounded corners, or None.

    An arc of radius R that turns by the angle a uses R tan(a/2) of both edges at its corner.
    """
    count = len(points)
    used = [radius * math.tan(_turn(points, k) / 2) for k in range(count)]
    for k, (start, end) in enumerate(_edges(points)):
        length, needed = math.dist(start, end), used[k] + used[(k + 1) % count]
        if needed > length * (1 + 1e-9):
            return f"edge {k + 1}-{(k + 1) % count + 1} is {length:g} mm long but its arcs need {needed:g} mm"
    return None


def _edges(points: PlanePoints) -> list[tuple[Sequence[float], Sequence[float]]]:
    return [(points[k], points[(k + 1) % len(points)]) for k in range(len(points))]


def _extent(points: PlanePoints) -> float:
    return max(math.dist(points[0], point) for point in points)


def _turn(points: PlanePoints, k: int) -> float:
    """Angle by which the path turns at corner k, 0 <= angle < pi."""
    before, here, after = points[k - 1], points[k], points[(k + 1) % len(points)]
    ux, uy = here[0] - before[0], here[1] - before[1]
    vx, vy = after[0] - here[0], after[1] - here[1]
    return math.atan2(abs(ux * vy - uy * vx), ux * vx + uy * vy)


def _first_meeting(points: PlanePoints) -> str | None:
    edges, count = _edges(points), len(points)
    for i in range(count):
        for j in range(i + 1, count):
            neighbours = j == i + 1 or (i == 0 and j == count - 1)
            meet = _folds_back(edges[i], edges[j]) if neighbours else _meet(*edges[i], *edges[j])
            if meet:
                return f"edge {i + 1}-{i + 2} meets edge {j + 1}-{(j + 1) % count + 1}"
    return None


def _side(a: Sequence[float], b: Sequence[float], p: Sequence[float]) -> int:
    """On which side of the line a-b the point p lies: 1, -1, or 0 on it (to rounding)."""
    cross = (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])
    if abs(cross) <= 1e-12 * math.dist(a, b) * max(math.dist(a, p), math.dist(b, p)):
        return 0
    return 1 if cross > 0 else -1


def _between(a: Sequence[float], b: Sequence[float], p: Sequence[float]) -> bool:
    return all(min(a[k], b[k]) <= p[k] <= max(a[k], b[k]) for k in (0, 1))


def _meet(a: Sequence[float], b: Sequence[float], c: Sequence[float], d: Sequence[float]) -> bool:
    """Do the closed segments a-b and c-d share a point?"""
    sides = _side(a, b, c), _side(a, b, d), _side(c, d, a), _side(c, d, b)
    if sides[0] * sides[1] < 0 and sides[2] * sides[3] < 0:
        return True
    ends = ((a, b, c), (a, b, d), (c, d, a), (c, d, b))
    return any(side == 0 and _between(*end) for side, end in zip(sides, ends, strict=True))


def _folds_back(
    first: tuple[Sequence[float], Sequence[float]], second: tuple[Sequence[float], Sequence[float]]
) -> bool:
    """Do two edges that share a corner run back over each other?"""
    corner = next(p for p in first if any(tuple(p) == tuple(q) for q in second))
    p = next(q for q in first if tuple(q) != tuple(corner))
    q = next(r for r in second if tuple(r) != tuple(corner))
    ahead = (p[0] - corner[0]) * (q[0] - corner[0]) + (p[1] - corner[1]) * (q[1] - corner[1])
    return _side(corner, p, q) == 0 and ahead > 0


def reflected_polygon(points: PlanePoints, axis: int) -> list[list[float]]:
    """The polygon with the sign of one coordinate (0 or 1) changed, its corners in the opposite order: it runs the same
    way round.

    >>> reflected_polygon([[0, 0], [2, 0], [2, 1]], 0)
    [[-2.0, 1.0], [-2.0, 0.0], [0.0, 0.0]]
    """
    signs = [-1.0 if k == axis else 1.0 for k in range(2)]
    return [[sign * float(x) + 0.0 for sign, x in zip(signs, point, strict=True)] for point in points][::-1]
