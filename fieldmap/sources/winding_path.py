"""The middle line of a plane winding as arcs and bars, in the form that `fieldmap.kernels.coils.path` takes."""

import math
from dataclasses import dataclass

import numpy as np

from fieldmap.device.model import PathCoil, RoundedRectangleCoil
from fieldmap.errors import InputError, Problem
from fieldmap.typing import Array

_STRAIGHT = 1e-12  # a corner that turns by less is no corner; a bar shorter than this times the path is none


@dataclass(frozen=True, eq=False)
class WindingPath:
    """arcs (n, 8) and bars (m, 5) as documented in `fieldmap.kernels.coils.path`; thickness and height in m."""

    arcs: Array
    bars: Array
    thickness: float
    height: float


def winding_path(coil: RoundedRectangleCoil | PathCoil) -> WindingPath:
    """Arcs and bars of a coil in its local frame, for one ampere-turn, counter-clockwise for positive current.

    Raises InputError where corners repeat or their roundings do not fit between each other.
    """
    corners = np.asarray(coil.corners if isinstance(coil, PathCoil) else _rectangle(coil), dtype=float)
    if len(corners) < 3 or np.any(np.all(corners == np.roll(corners, 1, axis=0), axis=1)):
        received = f"{len(corners)} corners, or two equal ones in a row"
        must_hold = "a closed path needs three or more corners, each apart from the next"
        raise InputError(Problem(f"coil {coil.name!r}, corners", must_hold, received, "correct the corners"))
    return _rounded(coil, corners)


def _rectangle(coil: RoundedRectangleCoil) -> Array:
    x, y = coil.half_width_x, coil.half_width_y
    return np.array([[x, y], [-x, y], [-x, -y], [x, -y]])


def _arc(
    centre: tuple[float, float], middle: float, span: float, inner: float, outer: float, sense: float
) -> list[float]:
    return [*centre, math.cos(middle), math.sin(middle), span, inner, outer, sense]


def _rounded(coil: RoundedRectangleCoil | PathCoil, corners: Array) -> WindingPath:
    """Cut every corner by an arc that touches both edges, and keep what is left of the edges as bars."""
    edges = np.roll(corners, -1, axis=0) - corners  # edge k runs from corner k to corner k + 1
    lengths = np.hypot(edges[:, 0], edges[:, 1])
    directions = edges / lengths[:, None]
    turns = _turns(directions)
    cuts = coil.corner_radius * np.tan(np.abs(turns) / 2)  # from the corner to where its arc begins
    rest = lengths - cuts - np.roll(cuts, -1)
    _check_fit(coil, rest, lengths)
    arcs = [
        arc
        for k in range(len(corners))
        if abs(turns[k]) > _STRAIGHT
        for arc in _corner(corners[k], directions[k - 1], turns[k], coil.corner_radius, coil.thickness)
    ]
    bars = [
        [*(corners[k] + (cuts[k] + rest[k] / 2) * directions[k]), *directions[k], rest[k] / 2]
        for k in range(len(corners))
        if rest[k] > _STRAIGHT * lengths.sum()
    ]
    return WindingPath(
        np.array(arcs).reshape(-1, 8), np.array(bars).reshape(-1, 5), coil.thickness, coil.height
    )


def _turns(directions: Array) -> Array:
    """Angle by which the path turns at each corner, positive to the left."""
    before = np.roll(directions, 1, axis=0)
    cross = before[:, 0] * directions[:, 1] - before[:, 1] * directions[:, 0]
    return np.arctan2(cross, np.sum(before * directions, axis=1))


def _corner(corner: Array, before: Array, turn: float, radius: float, thickness: float) -> list[list[float]]:
    """The arc of one corner, in two halves where it turns by more than a right angle."""
    sense = math.copysign(1.0, turn)
    start = corner - radius * math.tan(abs(turn) / 2) * before
    centre = start + sense * radius * np.array([-before[1], before[0]])
    first = math.atan2(start[1] - centre[1], start[0] - centre[0])
    pieces = 1 if abs(turn) <= math.pi / 2 + 1e-9 else 2
    step = turn / pieces
    return [
        _arc(
            (centre[0], centre[1]),
            first + (k + 0.5) * step,
            abs(step) / 2,
            max(radius - thickness / 2, 0.0),
            radius + thickness / 2,
            sense,
        )
        for k in range(pieces)
    ]


def _check_fit(coil: RoundedRectangleCoil | PathCoil, rest: Array, lengths: Array) -> None:
    problems = [
        Problem(
            f"coil {coil.name!r}, edge {k + 1}",
            "each edge must be long enough for the rounding of both its corners",
            f"{lengths[k]:.6g} m, which is {-rest[k]:.3g} m too short",
            "make corner_radius smaller or move the corners apart",
        )
        for k in range(len(rest))
        if rest[k] < -1e-9 * lengths.sum()
    ]
    if coil.corner_radius < coil.thickness / 2 * (1 - 1e-9):
        problems.append(
            Problem(
                f"coil {coil.name!r}, corner_radius",
                "corner_radius must be at least thickness/2",
                f"{coil.corner_radius:.6g} m for a thickness of {coil.thickness:.6g} m",
                "make the corner radius larger or the winding thinner",
            )
        )
    if problems:
        raise InputError(*problems)
