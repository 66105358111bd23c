"""Equilibria of a levitated magnet as functions of a parameter such as a control signal, depth or current: along a
branch, and to first order in each coil's current (implicit function theorem)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check, check_not_negative, check_positive
from fieldmap.device.model import Payload
from fieldmap.errors import NoEquilibrium
from fieldmap.field import AnyField, Bounds, as_field, require_bounds, resolve_currents
from fieldmap.levitation.balance import (
    CURRENT_STEP,
    MagnetBalance,
    MagnetModel,
    force_stated,
    magnet_balance,
    model_assumptions,
    reaction_stated,
)
from fieldmap.levitation.continuation import Fold, follow_branch
from fieldmap.levitation.places import check_centre, check_point, check_position
from fieldmap.levitation.stationary import StationaryPoint, describe
from fieldmap.lookup.payload import check_payload
from fieldmap.records import Record
from fieldmap.typing import Array

_STEPS = 40
_CLOSE = 1e-8
_WELL_ENOUGH = 1e-6
"""Newton's method has converged when its step is shorter than `_CLOSE`, in later steps than `_WELL_ENOUGH`, m."""
_LEVEL_STEP = 1e-3
Path = Callable[[float, float], tuple[Array, float]]


@dataclass(frozen=True, eq=False, repr=False)
class EquilibriumBranch(Record):
    """Positions of the magnet along a branch, in the order in which it was followed.

    Attributes
    ----------
    parameters : (n,).
    positions : (n, 3), m.
    levels : (n,), current level, A; constant unless the height is held.
    at_stops : points at the stops that were reached before the first fold.
    levels_at_stops : current level at these.
    folds : points at which the branch turns back, with unknowns (x, y) or (x, y, level).
    ended : "last stop"; "edge" of the map or of the parameter's range; or "steps", after the largest number of steps.
    assumptions : of the model of the magnet.
    """

    parameters: Array
    positions: Array
    levels: Array
    at_stops: tuple[StationaryPoint, ...]
    levels_at_stops: Array
    folds: tuple[Fold, ...]
    ended: str
    assumptions: tuple[str, ...]

    @property
    def positions_at_stops(self) -> Array:
        """Positions (n, 3) at the stops that were reached, m."""
        return np.array([point.position for point in self.at_stops]).reshape(-1, 3)


def follow_equilibrium(
    field: AnyField,
    payload: Payload | None,
    path: Path,
    start: ArrayLike,
    stops: ArrayLike,
    level: float,
    hold_height: bool = False,
    field_scale: float = 1.0,
    moment: MagnetModel = "fixed",
    lever: float = 0.0,
    step: float = 0.05,
) -> EquilibriumBranch:
    """Follow the point without horizontal force through the parameters `stops`, around folds.

    Parameters
    ----------
    field
        Any field with a box.
    payload
        The levitated body.
    path
        path(parameter, level) gives currents (n_coils,), A, and the height z of the magnet, m, such as
        `lambda x, u: (divide_currents(u, x, 0.0, 1.25), -0.102)`.
    start
        (x, y), m, near the solution at the first stop.
    stops
        (n,), parameters in rising or falling order.
    level
        Current level, A; only its first value if the height is held.
    hold_height
        The level is an unknown, so that the lift equals the weight, as with a vertical controller. Otherwise
        the level is constant and there is no condition on the vertical force.
    field_scale
        Calibration: factor of every force except the iron's reaction to the magnets. Without a reaction it
        matters only if the height is held.
    moment, lever
        As in `magnet_balance`.
    step
        Largest step, in units of a quarter of the map's width, the range of the stops and the level.

    Returns
    -------
    EquilibriumBranch
        The branch, in the order in which it was followed.

    Raises
    ------
    InputError, OutsideMapError
        For arguments that do not fit.
    NotConverged
        If there is no solution near the start.
    """
    check_positive("follow_equilibrium", step=step)
    targets = np.asarray(stops, dtype=float)
    steps = np.diff(targets)
    ordered = targets.ndim == 1 and len(targets) > 1 and bool((steps > 0).all() or (steps < 0).all())
    must = "must be two or more parameters in rising or falling order"
    remedy = "begin with the parameter of the start"
    check(ordered, "follow_equilibrium(stops)", must, targets.tolist(), remedy)
    about = (field, payload, path, float(targets[0]), start, level, hold_height, field_scale, moment, lever)
    along, begin, (low, high) = _begin("follow_equilibrium", *about)
    width = 0.25 * float((high - low).max())
    followed = follow_branch(
        along.residual,
        begin,
        targets,
        [width, width, level, np.ptp(targets)] if hold_height else [width, width, np.ptp(targets)],
        slope=None if hold_height else along.slope,
        inside=lambda q: bool((q[:2] >= low).all() and (q[:2] <= high).all() and (q[2:] > 0).all()),
        step=step,
    )
    levels = np.array([along.level_of(q) for q in followed.unknowns])
    pairs = zip(followed.parameters, levels, strict=True)
    heights = [path(float(parameter), float(u))[1] for parameter, u in pairs]
    reached = zip(followed.at_stops, targets, strict=False)
    points = tuple(describe(*along.at(q, float(parameter))) for q, parameter in reached)
    return EquilibriumBranch(
        followed.parameters,
        np.column_stack([followed.unknowns[:, :2], heights]),
        levels,
        points,
        np.array([along.level_of(q) for q in followed.at_stops]),
        followed.folds,
        followed.ended,
        (
            *force_stated(along.payload, moment, (point.volume_error for point in points)),
            *model_assumptions(moment, lever),
            *reaction_stated(
                along.balance.source, along.payload, (point.reaction for point in points), "at most"
            ),
        ),
    )


def equilibrium_at(
    field: AnyField,
    payload: Payload | None,
    path: Callable[[float], tuple[Array, float]],
    start: ArrayLike,
    level: float,
    hold_height: bool = False,
    field_scale: float = 1.0,
    moment: MagnetModel = "fixed",
    lever: float = 0.0,
) -> tuple[StationaryPoint, float]:
    """Find the point without horizontal force near a start, by Newton's method, and the current level.

    Parameters
    ----------
    field
        Any field with a box.
    payload
        The levitated body.
    path
        path(level) gives currents (n_coils,), A, and the height z of the magnet, m.
    start
        (x, y), m.
    level
        Current level, A; only its first value if the height is held.
    hold_height, field_scale, moment, lever
        As in `follow_equilibrium`.

    Returns
    -------
    tuple[StationaryPoint, float]
        The point, and the level, A.

    Raises
    ------
    InputError, OutsideMapError
        For arguments that do not fit.
    NoEquilibrium
        If there is no solution near the start.
    """
    about = (field, payload, lambda _, u: path(u), 0.0, start, level, hold_height, field_scale, moment, lever)
    along, q, (low, high) = _begin("equilibrium_at", *about)
    begin, last = q[:2].copy(), np.inf
    for count in range(_STEPS):
        try:
            step = np.linalg.solve(_square(along, q), along.residual(q, 0.0))
        except np.linalg.LinAlgError:
            # The force does not depend on the position.
            break
        # A step is limited to a fifth of the map, and of the level.
        q -= step / max(1.0, float(np.abs(step[:2]).max() / (0.2 * (high - low).min())))
        q[:2] = np.clip(q[:2], low, high)
        q[2:] = np.clip(q[2:], 0.8 * (q + step)[2:], 1.25 * (q + step)[2:])
        # The interpolated force may jump between cells of a map by its error. Steps then stay
        # larger than `_CLOSE`.
        close = _CLOSE if count < _STEPS // 4 else _WELL_ENOUGH
        last = float(np.abs(step[:2]).max())
        if last < close and (not hold_height or abs(step[2]) < close / _CLOSE * 1e-8 * level):
            return describe(*along.at(q, 0.0)), along.level_of(q)
    what = "the horizontal force and the lift less weight" if hold_height else "the horizontal force"
    where = f"equilibrium_at, from {1e3 * begin} mm at {level:.4g} A"
    received = f"a last step of {1e3 * last:.2g} mm at {1e3 * q[:2]} mm after {count + 1} steps"
    remedy = "look for all points with stationary_points, and start near one of them"
    raise NoEquilibrium.of(where, f"{what} must vanish near", received, remedy)


def _begin(
    where: str,
    field: AnyField,
    payload: Payload | None,
    path: Path,
    parameter: float,
    start: ArrayLike,
    level: float,
    hold_height: bool,
    field_scale: float,
    moment: MagnetModel,
    lever: float,
) -> tuple[_Along, Array, Bounds]:
    """The balance along a path, the unknowns (2,) or (3,) at its start, and the corners (2,) of the box of centres."""
    carried = check_payload(payload, where, pieces=True)
    check_positive(where, level=level, field_scale=field_scale)
    begin, source = np.asarray(start, dtype=float), as_field(field)
    currents, height = path(parameter, level)
    near = check_point(np.append(begin, height), f"{where}(start)")
    balance = magnet_balance(source, np.asarray(currents, dtype=float), carried, near, moment, lever)
    low, high = balance.box
    check_position((low, high), near, f"{where}(start)")
    along = _Along(carried, balance, path, level, hold_height, field_scale)
    return along, np.append(begin, level) if hold_height else begin.copy(), (low[:2], high[:2])


def _square(along: _Along, q: Array) -> Array:
    """Derivative of the residual by x and y, from the stiffness, and by the level, from a central difference."""
    if not along.hold_height:
        return along.slope(q, 0.0)
    balance, place = along.at(q, 0.0)
    matrix = np.empty((3, 3))
    matrix[:, :2] = -balance.scaled_stiffness(place, along.field_scale)[:, :2] / balance.weight
    ahead, behind = q.copy(), q.copy()
    ahead[2] *= 1.0 + _LEVEL_STEP
    behind[2] *= 1.0 - _LEVEL_STEP
    change = along.residual(ahead, 0.0) - along.residual(behind, 0.0)
    matrix[:, 2] = change / (ahead[2] - behind[2])
    return matrix


@dataclass(frozen=True, eq=False)
class _Along:
    """The horizontal force (and the lift) over the weight, along a path."""

    payload: Payload
    balance: MagnetBalance
    path: Path
    level: float
    hold_height: bool
    field_scale: float

    def at(self, q: Array, parameter: float) -> tuple[MagnetBalance, Array]:
        """The balance with the currents at unknowns q, and the position (3,) of the magnet, m."""
        currents, height = self.path(parameter, self.level_of(q))
        balance = replace(self.balance, currents=np.asarray(currents, dtype=float))
        return balance, np.array([q[0], q[1], height])

    def level_of(self, q: Array) -> float:
        """The current level, A."""
        return float(q[2]) if self.hold_height else self.level

    def residual(self, q: Array, parameter: float) -> Array:
        """(F_x, F_y) / weight, and F_z / weight - 1 where the height is held."""
        balance, place = self.at(q, parameter)
        force = balance.scaled_force(place[None, :], self.field_scale)[0] / balance.weight
        return np.array([*force[:2], force[2] - 1.0]) if self.hold_height else np.asarray(force[:2])

    def slope(self, q: Array, parameter: float) -> Array:
        """Derivative (2, 2) of the residual by x and y."""
        balance, place = self.at(q, parameter)
        return -balance.scaled_stiffness(place, self.field_scale)[:2, :2] / balance.weight


@dataclass(frozen=True, eq=False, repr=False)
class Sensitivity(Record):
    """Derivatives of an equilibrium by the coil currents.

    position (3,), m, and currents (n_coils,), A: of the equilibrium. stiffness (3, 3), N/m; force_per_current
    (3, n_coils), N/A. at_held_height (2, n_coils), m/A: dx/di and dy/di at constant height, before the vertical
    controller reacts. with_lift_held (2, n_coils), m/A: the same after the controller has scaled all currents alike to
    keep the lift; level_per_current (n_coils,), 1/A: the relative change of this scale. All are singular at a fold,
    where the horizontal stiffness is singular. assumptions: of the numbers.
    """

    position: Array
    currents: Array
    stiffness: Array
    force_per_current: Array
    at_held_height: Array
    with_lift_held: Array
    level_per_current: Array
    assumptions: tuple[str, ...]

    def noise(self, deviation: ArrayLike, lift_held: bool = False) -> Array:
        """Covariance of x and y for noise of the currents that is slow enough for the magnet to follow.

        Parameters
        ----------
        deviation
            Independent standard deviations of the currents, a number or (n_coils,), A.
        lift_held
            Whether the lift is held.

        Returns
        -------
        Array
            Covariance (2, 2), m^2.
        """
        spread = np.broadcast_to(np.asarray(deviation, dtype=float), self.currents.shape)
        check_not_negative("Sensitivity.noise", deviation=float(spread.min()))
        by_current = self.with_lift_held if lift_held else self.at_held_height
        return np.asarray((by_current * spread**2) @ by_current.T)


def equilibrium_sensitivity(
    field: AnyField,
    currents: Any,
    payload: Payload | None,
    position: ArrayLike,
    moment: MagnetModel = "fixed",
    lever: float = 0.0,
    step: float | None = None,
) -> Sensitivity:
    """Derivatives of the horizontal equilibrium at a position by every coil's current.

    F_h(x, i) = 0 gives dx_h/di = K_hh^-1 dF_h/di. To hold the lift, a common factor of the currents is solved for, too.

    Parameters
    ----------
    field
        Any `fieldmap.field.Field` with a box, which must hold at these currents.
    currents
        (n_coils,), A.
    payload
        The levitated body.
    position
        The magnet's centre (3,), m.
    moment, lever
        As in `magnet_balance`.
    step
        Step of the central differences in each current, A; 1 % of the largest current unless given. They are
        exact where the field is linear in the currents, and of second order in the step where iron saturates.

    Returns
    -------
    Sensitivity
        The derivatives, m/A.

    Raises
    ------
    InputError
        For arguments that do not fit, a position where the horizontal stiffness is singular, or currents that do
        not lift.
    """
    carried = check_payload(payload, "equilibrium_sensitivity", pieces=True)
    where = "equilibrium_sensitivity(position)"
    source, amperes = resolve_currents(field, currents)
    point = check_centre(require_bounds(source), carried, position, where)
    width = CURRENT_STEP * float(np.abs(amperes).max()) if step is None else step
    check_positive("equilibrium_sensitivity", step=width)
    balance = magnet_balance(source, amperes, carried, point, moment, lever)
    check_position(balance.box, point, where)
    stiffness = balance.stiffness(point)
    by_current = balance.force_per_signal(point, np.eye(len(amperes)), np.full(len(amperes), width))
    regular = abs(np.linalg.det(stiffness[:2, :2])) > 1e-10 * np.linalg.norm(stiffness) ** 2
    must = "the horizontal stiffness must not be singular: at a fold the equilibrium has no derivative"
    received = f"{stiffness[:2, :2].tolist()} N/m"
    remedy = "choose currents or a height away from the fold"
    check(regular, where, must, received, remedy)
    # The common factor 1 + s of all currents: d force / d s.
    by_level = by_current @ amperes
    matrix = np.zeros((3, 3))
    matrix[:, :2], matrix[:, 2] = stiffness[:, :2], -by_level
    must, received = "the force must follow the currents upward too", f"{by_level.tolist()} N"
    lifts = bool(np.linalg.matrix_rank(matrix) == 3)
    check(lifts, "equilibrium_sensitivity(currents)", must, received, "choose currents that lift")
    held: Array = np.asarray(np.linalg.solve(matrix, by_current), dtype=float)
    horizontal = np.asarray(np.linalg.solve(stiffness[:2, :2], by_current[:2]), dtype=float)
    off = float(np.linalg.norm(balance.rule_error(point)))
    drawn = [float(np.linalg.norm(balance.reaction_force(point[None, :])))]
    about = (
        *force_stated(carried, moment, [off]),
        *model_assumptions(moment, lever),
        *reaction_stated(source, carried, drawn, "at the place"),
    )
    return Sensitivity(point, amperes, stiffness, by_current, horizontal, held[:2], held[2], about)
