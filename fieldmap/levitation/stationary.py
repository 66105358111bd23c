"""All points of a horizontal window at which the horizontal force on a magnet vanishes, and a check of their number."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_count, check_ordered
from fieldmap.device.model import Payload
from fieldmap.field import AnyField, Bounds, require_bounds, resolve_currents
from fieldmap.levitation.balance import (
    MagnetBalance,
    MagnetModel,
    force_stated,
    magnet_balance,
    model_assumptions,
    reaction_stated,
)
from fieldmap.levitation.places import check_point, check_position
from fieldmap.lookup.payload import check_payload
from fieldmap.records import Record
from fieldmap.typing import Array

Kind = Literal["stable", "saddle", "unstable"]

_STEPS = 30
_CLOSE = 1e-9
"""Newton's method has converged when its step is shorter than this, m."""
_WELL_ENOUGH = 1e-6
"""The last step, m, that is accepted after all iterations: an interpolated force may jump between cells."""
_ROUNDS = 3


@dataclass(frozen=True, eq=False, repr=False)
class StationaryPoint(Record):
    """A point with no horizontal force, at a fixed height.

    Attributes
    ----------
    position : (3,), m.
    stiffness : (3, 3), -dF_i/dx_j, N/m.
    horizontal : (2,), eigenvalues of the horizontal part of the stiffness, ascending, N/m.
    kind : "stable" if both eigenvalues are positive, "saddle" if one is, "unstable" if none is.
    lift : vertical magnetic force, N.
    volume_error : change of the force with a finer volume rule of the magnets, N; 0 where the rule is exact or no
        shape is known, NaN where the finer rule leaves the field.
    reaction : vertical force of the iron's reaction to the magnets, N, part of the lift; 0 for a field without the
        reaction.
    """

    position: Array
    stiffness: Array
    horizontal: Array
    kind: Kind
    lift: float
    volume_error: float
    reaction: float

    @property
    def trace(self) -> float:
        """Trace of the stiffness over its norm: 0 for a fixed moment in a harmonic field (Earnshaw)."""
        return float(np.trace(self.stiffness) / np.linalg.norm(self.stiffness))


@dataclass(frozen=True, eq=False, repr=False)
class StationarySet(Record):
    """All points found in a window, and the number that checks them.

    By the theorem of Poincare and Hopf the number of stable and unstable points minus the number of saddles equals
    `boundary_index`. `complete` compares the two. It does not notice pairs of missing points that cancel.

    Attributes
    ----------
    points : in the order of their distance from the middle of the window.
    boundary_index : number of turns of the horizontal force along the edge of the window.
    lower, upper : (2,), corners of the window, m.
    height : z of the magnet's centre, m.
    assumptions : of the points.
    """

    points: tuple[StationaryPoint, ...]
    boundary_index: int
    lower: Array
    upper: Array
    height: float
    assumptions: tuple[str, ...]

    def of(self, kind: Kind) -> tuple[StationaryPoint, ...]:
        """The points of one kind.

        Parameters
        ----------
        kind
            The kind.

        Returns
        -------
        tuple[StationaryPoint, ...]
            The points.
        """
        return tuple(point for point in self.points if point.kind == kind)

    @property
    def index(self) -> int:
        """Number of stable and unstable points found, minus the number of saddles."""
        return len(self.points) - 2 * len(self.of("saddle"))

    @property
    def complete(self) -> bool:
        """Whether the points account for the turns of the force along the edge."""
        return self.index == self.boundary_index


def stationary_points(
    field: AnyField,
    currents: Any,
    payload: Payload | None,
    height: float,
    window: tuple[ArrayLike, ArrayLike] | None = None,
    moment: MagnetModel = "fixed",
    samples: int = 24,
    lever: float = 0.0,
) -> StationarySet:
    """Find all points of a horizontal window at which the horizontal force on a magnet vanishes, at one height.

    Parameters
    ----------
    field, currents, payload
        As in `find_equilibrium`.
    height
        z of the magnet's centre, m.
    window
        Lower and upper corner (2,), m, for the payload's centre; unless given, all places at which the payload
        lies in the box of the field.
    moment, lever
        As in `magnet_balance`.
    samples
        Intervals along each side of the grid from which the search begins. They are halved up to two times if
        the points found disagree with the turns of the force along the edge of the window.

    Returns
    -------
    StationarySet
        The points, and the number that checks them.

    Raises
    ------
    InputError
        For arguments that do not fit.
    OutsideMapError
        For a window in which the payload leaves the map.
    """
    carried = check_payload(payload, "stationary_points", pieces=True)
    source, amperes = resolve_currents(field, currents)
    check_count("stationary_points", samples=samples)
    given = [corner[:2] for corner in require_bounds(source)] if window is None else window
    corners = [check_point(np.append(corner, height), "stationary_points(window)") for corner in given]
    balance = magnet_balance(source, amperes, carried, np.mean(corners, axis=0), moment, lever)
    low, high = _window(balance.box, None if window is None else corners, height)
    middle = np.append(0.5 * (low + high), height)
    turns = _boundary_index(balance, low, high, height)
    for attempt in range(_ROUNDS):
        count = samples * 2**attempt
        found = _search(balance, low, high, height, count)
        if sum(np.sign(np.linalg.det(balance.stiffness(p)[:2, :2])) for p in found) == turns:
            break
    found.sort(key=lambda p: float(np.linalg.norm(p - middle)))
    points = tuple(describe(balance, p) for p in found)
    rule = force_stated(carried, moment, (point.volume_error for point in points))
    drawn = reaction_stated(source, carried, (point.reaction for point in points), "at most")
    held = model_assumptions(moment, lever)
    return StationarySet(points, turns, low, high, height, (*rule, *held, *drawn))


def describe(balance: MagnetBalance, position: Array) -> StationaryPoint:
    """Stiffness, kind and lift at a position (3,)."""
    stiffness = balance.stiffness(position)
    values = np.asarray(np.linalg.eigvalsh(0.5 * (stiffness + stiffness.T)[:2, :2]), dtype=float)
    kind: Kind = "stable" if values[0] > 0 else "unstable" if values[1] <= 0 else "saddle"
    lift = float(balance.magnetic_force(position[None, :])[0, 2])
    off = float(np.linalg.norm(balance.rule_error(position)))
    drawn = float(balance.reaction_force(position[None, :])[0, 2])
    return StationaryPoint(position, stiffness, values, kind, lift, off, drawn)


def to_equilibrium(balance: MagnetBalance, start: Array, low: Array, high: Array) -> Array | None:
    """Newton's method on the horizontal force from a point (3,), m.

    Returns
    -------
    Array | None
        The stationary point (3,); None if the iteration leaves the window (corners low and high (2,)) or does
        not converge.
    """
    point, largest = start.copy(), 0.25 * float((high - low).min())
    step = np.full(2, np.inf)
    for _ in range(_STEPS):
        force = balance.magnetic_force(point[None, :])[0, :2]
        slope = balance.stiffness(point)[:2, :2]
        if abs(np.linalg.det(slope)) < 1e-14 * np.abs(slope).max() ** 2:
            return None
        step = np.linalg.solve(slope, force)
        length = float(np.linalg.norm(step))
        point[:2] += step if length <= largest else step * (largest / length)
        if (point[:2] < low).any() or (point[:2] > high).any():
            return None
        if length < _CLOSE:
            return point
    return point if np.linalg.norm(step) < _WELL_ENOUGH else None


def _window(box: Bounds, corners: list[Array] | None, height: float) -> tuple[Array, Array]:
    """The given corners (2,), or the corners of the whole box. Raises InputError and OutsideMapError."""
    lower, upper = box if corners is None else corners
    inset = 1e-9 * float((upper - lower)[:2].max()) if corners is None else 0.0
    low, high = lower[:2] + inset, upper[:2] - inset
    for a, b in zip(low, high, strict=True):
        check_ordered("stationary_points(window)", float(a), float(b))
    for corner in (low, high):
        check_position(box, np.append(corner, height), "stationary_points(window)")
    return low, high


def _search(balance: MagnetBalance, low: Array, high: Array, height: float, count: int) -> list[Array]:
    """Apply Newton's method in every square of a grid in which both components of the force change sign."""
    x, y = (np.linspace(low[k], high[k], count + 1) for k in range(2))
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    points = np.concatenate([grid, np.full((*grid.shape[:2], 1), height)], axis=-1)
    force = balance.magnetic_force(points.reshape(-1, 3))[:, :2].reshape(count + 1, count + 1, 2)
    corners = np.stack([force[:-1, :-1], force[1:, :-1], force[:-1, 1:], force[1:, 1:]])
    spread = np.abs(np.ptp(corners, axis=0))
    # Squares that just miss a change of sign count as well: a curved zero line may enter and leave through one side.
    changes = ((corners.min(axis=0) <= 0.2 * spread) & (corners.max(axis=0) >= -0.2 * spread)).all(axis=-1)
    apart = 1e-3 * float((high - low).max()) / count
    found: list[Array] = []
    for i, j in np.argwhere(changes):
        start = 0.25 * (points[i, j] + points[i + 1, j] + points[i, j + 1] + points[i + 1, j + 1])
        point = to_equilibrium(balance, start, low, high)
        if point is not None and all(np.linalg.norm(point - other) > apart for other in found):
            found.append(point)
    return found


def _boundary_index(balance: MagnetBalance, low: Array, high: Array, height: float) -> int:
    """Turns of the horizontal force along the window's edge, anticlockwise."""
    for count in (64, 256, 1024, 4096):
        t = np.linspace(0.0, 1.0, count, endpoint=False)[:, None]
        a, b, c, d = low, np.array([high[0], low[1]]), high, np.array([low[0], high[1]])
        edge = np.concatenate([p + t * (q - p) for p, q in ((a, b), (b, c), (c, d), (d, a))])
        force = balance.magnetic_force(np.column_stack([edge, np.full(len(edge), height)]))
        angle = np.arctan2(force[:, 1], force[:, 0])
        step = np.diff(np.append(angle, angle[0]))
        step -= 2 * np.pi * np.round(step / (2 * np.pi))
        if np.abs(step).max() < 0.5 * np.pi:
            break
    return int(np.round(step.sum() / (2 * np.pi)))
