"""A plane winding of rectangular section as arcs and bars, for field, quadrature, solids and drawings.

The middle line is a closed plane curve of arcs and straight bars. Frame: axis along z, the winding in |z| <= height/2.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fieldmap.errors import InputError, Problem
from fieldmap.kernels.coils.pieces import Arc, Bar
from fieldmap.records import Record
from fieldmap.typing import Array

_STRAIGHT = 1e-12  # smallest turn of a corner, rad, and smallest length of a bar as a share of the path
_FULL_TURN = math.pi * (1 - 1e-12)  # an arc with a larger half angle is a circle


@dataclass(frozen=True, eq=False, repr=False)
class WindingPath(Record):
    """arcs (n, 8) and bars (m, 5), with the columns of `fieldmap.kernels.coils.pieces`; thickness and height in m.

    The pieces make a closed curve, in the sense of a positive current; their order does not matter. No arc turns by
    more than a right angle, the limit of the kernel's quadrature (`winding_path` divides longer arcs); only a circle is
    one arc of a full turn.
    """

    arcs: Array
    bars: Array
    thickness: float
    height: float

    @property
    def is_circle(self) -> bool:
        """Whether the winding is one arc of a full turn."""
        return len(self.arcs) == 1 and not len(self.bars) and bool(self.arcs[0, 4] > _FULL_TURN)

    @property
    def turning(self) -> float:
        """1 where the path runs counter-clockwise, -1 where it runs clockwise."""
        return math.copysign(1.0, float(self.arcs[:, 7] @ self.arcs[:, 4]))

    def outline(self, offset: float, points_per_arc: int) -> list[tuple[Array, Array]]:
        """The curve at `offset` (m) to the right of the middle line: points (k, 2) and unit normals to the right (k, 2)
        of each piece, in order along the path.

        An arc has `points_per_arc` points, its ends among them; a bar has its ends. Raises InputError where the pieces
        make no closed curve.
        """
        pieces = self._pieces(offset, points_per_arc)
        if self.is_circle:
            return pieces
        return [pieces[k] for k in _order([points for points, _ in self._pieces(0.0, 2)])]

    def _pieces(self, offset: float, points_per_arc: int) -> list[tuple[Array, Array]]:
        arcs = [_arc_points(Arc(*row), offset, points_per_arc) for row in self.arcs]
        return arcs + [_bar_points(Bar(*row), offset) for row in self.bars]


def arc(
    centre: Sequence[float] | Array,
    middle: float,
    half_angle: float,
    radius: float,
    thickness: float,
    sense: float = 1.0,
) -> Arc:
    """A row of `WindingPath.arcs`: an arc of the middle line about `centre` (m), from middle - half_angle to
    middle + half_angle (rad), `radius` at the middle line; sense 1 runs counter-clockwise, -1 clockwise."""
    inner, outer = max(radius - thickness / 2, 0.0), radius + thickness / 2
    x, y = centre
    return Arc(x, y, math.cos(middle), math.sin(middle), half_angle, inner, outer, sense)


def bar(start: Array, end: Array) -> Bar:
    """A row of `WindingPath.bars`: the straight piece from `start` to `end` (2,), m."""
    length = math.dist(start, end)
    (x, y), (along_x, along_y) = 0.5 * (start + end), (end - start) / length
    return Bar(x, y, along_x, along_y, 0.5 * length)


def winding_path(
    arcs: Sequence[Sequence[float]], bars: Sequence[Sequence[float]], thickness: float, height: float
) -> WindingPath:
    """The path of rows made by `arc` and `bar`. Arcs that turn by more than a right angle are divided into equal arcs
    below that limit."""
    divided = [row for wide in arcs for row in _divided(wide)]
    return WindingPath(
        np.array(divided, dtype=float).reshape(-1, 8),
        np.array(bars, dtype=float).reshape(-1, 5),
        thickness,
        height,
    )


def _divided(row: Sequence[float]) -> list[Arc]:
    wide = Arc(*row)
    pieces = math.ceil(wide.half_angle / (0.25 * math.pi) - 1e-9)
    if pieces < 2:
        return [wide]
    half, middle = wide.half_angle / pieces, math.atan2(wide.middle_y, wide.middle_x)
    angles = [middle + wide.sense * (2 * k + 1 - pieces) * half for k in range(pieces)]
    return [
        wide._replace(middle_x=math.cos(angle), middle_y=math.sin(angle), half_angle=half) for angle in angles
    ]


def rounded_path(
    name: str, corners: Array, corner_radius: float, thickness: float, height: float
) -> WindingPath:
    """The path of a polygon (n, 2) with rounded corners: each corner becomes an arc tangent to both edges.

    name: of the coil, for errors. Raises InputError where corners repeat or an edge is too short for its arcs.
    """
    if not np.isfinite(corners).all():
        problem = Problem(f"coil {name!r}, corners", "must be finite", f"{corners.tolist()}", "correct them")
        raise InputError(problem)
    if len(corners) < 3 or np.any(np.all(corners == np.roll(corners, 1, axis=0), axis=1)):
        received = f"{len(corners)} corners, or two equal ones in a row"
        must_hold = "a closed path needs three or more corners, each apart from the next"
        raise InputError.of(f"coil {name!r}, corners", must_hold, received, "correct the corners")
    edges = np.roll(corners, -1, axis=0) - corners  # edge k runs from corner k to corner k + 1
    lengths = np.hypot(edges[:, 0], edges[:, 1])
    directions = edges / lengths[:, None]
    before = np.roll(directions, 1, axis=0)
    cross = before[:, 0] * directions[:, 1] - before[:, 1] * directions[:, 0]
    turns = np.arctan2(cross, np.sum(before * directions, axis=1))  # positive to the left
    cuts = corner_radius * np.tan(np.abs(turns) / 2)  # from the corner to the beginning of its arc
    rest = lengths - cuts - np.roll(cuts, -1)
    _check_fit(name, corner_radius, thickness, rest, lengths)
    arcs = [
        _corner(corners[k], directions[k - 1], turns[k], corner_radius, thickness)
        for k in range(len(corners))
        if abs(turns[k]) > _STRAIGHT
    ]
    bars = [
        [*(corners[k] + (cuts[k] + rest[k] / 2) * directions[k]), *directions[k], rest[k] / 2]
        for k in range(len(corners))
        if rest[k] > _STRAIGHT * lengths.sum()
    ]
    return winding_path(arcs, bars, thickness, height)


def _corner(corner: Array, before: Array, turn: float, radius: float, thickness: float) -> Arc:
    """The arc of one corner."""
    sense = math.copysign(1.0, turn)
    start = corner - radius * math.tan(abs(turn) / 2) * before
    centre = start + sense * radius * np.array([-before[1], before[0]])
    first = math.atan2(start[1] - centre[1], start[0] - centre[0])
    return arc((centre[0], centre[1]), first + turn / 2, abs(turn) / 2, radius, thickness, sense)


def _check_fit(name: str, corner_radius: float, thickness: float, rest: Array, lengths: Array) -> None:
    problems = [
        Problem(
            f"coil {name!r}, edge {k + 1}",
            "each edge must be long enough for the rounding of both its corners",
            f"{lengths[k]:.6g} m, which is {-rest[k]:.3g} m too short",
            "make corner_radius smaller or move the corners apart",
        )
        for k in range(len(rest))
        if rest[k] < -1e-9 * lengths.sum()
    ]
    if corner_radius < thickness / 2 * (1 - 1e-9):
        problems.append(
            Problem(
                f"coil {name!r}, corner_radius",
                "corner_radius must be at least thickness/2",
                f"{corner_radius:.6g} m for a thickness of {thickness:.6g} m",
                "make the corner radius larger or the winding thinner",
            )
        )
    if problems:
        raise InputError(*problems)


def _arc_points(arc: Arc, offset: float, count: int) -> tuple[Array, Array]:
    middle = math.atan2(arc.middle_y, arc.middle_x)
    angle = middle + arc.sense * arc.half_angle * np.linspace(-1.0, 1.0, count)
    outward = np.column_stack([np.cos(angle), np.sin(angle)])
    radius = 0.5 * (arc.inner + arc.outer) + arc.sense * offset
    return np.array([arc.x, arc.y]) + radius * outward, arc.sense * outward


def _bar_points(bar: Bar, offset: float) -> tuple[Array, Array]:
    along, right = np.array([bar.along_x, bar.along_y]), np.array([bar.along_y, -bar.along_x])
    ends = np.array([[-bar.half_length], [bar.half_length]]) * along
    return np.array([bar.x, bar.y]) + ends + offset * right, np.stack([right, right])


def _order(pieces: list[Array]) -> list[int]:
    """Numbers of the pieces (first and last point, each (2,)) in order: each begins where the one before it ends."""
    first, last = (np.array([points[end] for points in pieces]) for end in (0, -1))
    waiting, order = list(range(1, len(pieces))), [0]
    while True:
        candidates = waiting or order[:1]
        gaps = np.linalg.norm(first[candidates] - last[order[-1]], axis=1)
        if not gaps.min() <= 1e-6 * np.abs(first - first[0]).max():
            received = f"a gap of {gaps.min():.3g} m"
            raise InputError.of("winding", "the pieces must make a closed curve", received, "correct them")
        if not waiting:
            return order
        order.append(waiting.pop(int(gaps.argmin())))
