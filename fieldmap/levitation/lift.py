"""The current that carries the weight at a given point; currents of least power that lift a magnet, or push it along
one axis only: docs/theory/closed_loop.md (23), (24)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_signal, raise_all
from fieldmap.device.model import Payload
from fieldmap.errors import Infeasible, NotConverged, OutsideMapError, Problem
from fieldmap.field import AnyField, Field, as_field, coil_currents, require_bounds
from fieldmap.levitation.balance import (
    Balance,
    BodyBalance,
    MagnetBalance,
    MagnetModel,
    held_at,
    magnet_balance,
    model_of,
    reaction_stated,
    rule_stated,
)
from fieldmap.levitation.places import check_centre, check_position
from fieldmap.lookup.actuation import wrench_actuation
from fieldmap.lookup.payload import check_payload
from fieldmap.plain import Plain, plain_fields, plain_items
from fieldmap.records import Record
from fieldmap.typing import Array

MAX_STATES = 15
_POSITION = "lift_current(position)"
# No step multiplies the current by more than this; beyond the knee of the B-H curve a secant can be far off.
_LARGEST_GROWTH = 3.0
# The slope dF/di is taken over at least this relative difference of currents, if the tried currents differ so much.
_SLOPE_WIDTH = 0.01


@dataclass(frozen=True, eq=False, repr=False)
class LiftCurrent(Record):
    """Currents whose lift equals the weight at a point.

    current: the common factor, A; currents (n_coils,) = current * shares. position (3,): the payload's centre, m.
    force (3,): magnetic force there, N; its z component is the weight, the other two are not balanced.
    force_per_ampere (3,), N/A of common current: dF/di at these currents. stiffness (3, 3) = -dF_i/dx_j, N/m.
    held: direction of the moment of the magnets and whether it turns, such as "moment down, fixed". field (3,): B in T
    in the middle of the payload's magnets and soft iron. volume_error: change of the current with a finer volume rule
    of the magnets, A; 0 where the rule is exact or no shape is known, NaN where the finer rule leaves the field.
    assumptions: of the numbers. history: (common current in A, lift in N) of every state that was solved; empty for a
    field that superposes, with or without a constant part.
    """

    current: float
    currents: Array
    position: Array
    force: Array
    force_per_ampere: Array
    stiffness: Array
    held: str
    field: Array
    volume_error: float
    assumptions: tuple[str, ...]
    history: tuple[tuple[float, float], ...] = ()

    def to_dict(self) -> dict[str, Plain]:
        """The result as plain Python, SI units; the entry "states" is `history`."""
        states = [{"current": current, "lift": newtons} for current, newtons in self.history]
        shown = plain_fields(self) | plain_items(lift_current=self.current, states=states)
        return {name: value for name, value in shown.items() if name not in ("current", "history")}


def lift_current(
    field: AnyField,
    payload: Payload | None,
    position: ArrayLike,
    shares: Any = None,
    first: float = 1.0,
    tolerance: float = 1e-4,
    on_state: Callable[[float, float], None] | None = None,
) -> LiftCurrent:
    """Common current that carries the weight at a position.

    The magnet has the payload's direction, and the current is negative if a positive one pulls it down. A field that is
    proportional to the currents gives i = m g / (lift per ampere), docs/theory/equilibrium.md. If the field has a
    constant part, i carries the rest of the weight. The secant method finds the current for any other field, for a
    payload with turning = "free", whose moment follows the field, and for soft iron, whose force grows with the square
    of the current. It evaluates about four currents: `first`, then `first` times weight over lift, then secants until
    |F_z - m g| <= tolerance m g. Once two currents bracket the weight, the secant stays between them. A payload of
    pieces stays upright. Magnets are integrated over their volume by the rule of the payload's `volume_level`; at level
    1, or without a shape, they are point dipoles.

    Parameters
    ----------
    field
        Any `fieldmap.field.Field` that has a box.
    payload
        The levitated body.
    position
        The payload's centre (3,), m. Its magnets, and the centres of its soft iron, must lie in the box.
    shares
        Current of each coil per ampere of common current (n_coils,); 1 in every coil unless given.
    first
        Common current of the first state, A, positive.
    tolerance
        Tolerance of the lift, as a share of the weight.
    on_state
        Called with the common current, A, and F_z / (m g) after each state.

    Returns
    -------
    LiftCurrent
        The currents, and force and stiffness there. force_per_ampere is exact for a field that superposes; for any
        other it is the difference quotient of two states, some per cent apart.

    Raises
    ------
    InputError
        For a payload, position, shares, first or tolerance that do not fit.
    OutsideMapError
        For a position at which the payload leaves the field's box, and a current beyond the field.
    Infeasible
        Where the field does not lift.
    NotConverged
        After MAX_STATES states; after four times as many for soft iron in a field that superposes.

    Examples
    --------
    >>> lift = lift_current(m, device.payload, [0, 0, -0.102])  # doctest: +SKIP
    >>> print(lift.current, "A in each coil")  # doctest: +SKIP
    >>> solver = fieldmap.iron.NonlinearSolver(device)  # doctest: +SKIP
    >>> lift = lift_current(solver, device.payload, [0, 0, -0.102], first=1.5)  # doctest: +SKIP
    """
    carried = check_payload(payload, "lift_current", pieces=True)
    source = as_field(field)
    weights = _checked(source, shares, first, tolerance)
    point = check_centre(require_bounds(source), carried, position, _POSITION)
    if source.affine and not carried.soft and _model(carried) == "fixed":
        return _superposed(source, carried, point, weights)
    return _by_secant(source, carried, point, weights, first, tolerance, on_state)


def _require_pull(balance: MagnetBalance, point: Array, force: Array) -> None:
    """Raise Infeasible if the force (3,), N, of the currents has no vertical part."""
    middle = (point + balance.arms.mean(axis=0))[None, :]
    size = balance.magnitude * np.linalg.norm(balance.source.gradient(middle, balance.currents))
    # Where the force vanishes, rounding leaves about 1e-16 of the gradient.
    if abs(force[2]) <= 1e-12 * size:
        raise no_lift("lift_current", point)


def no_lift(where: str, point: Array) -> Infeasible:
    """The error for a place (3,), m, at which the coils do not lift."""
    must_hold = "dBz/dz must not vanish where a vertical magnet is to be lifted"
    received, remedy = "no vertical force for the given shares", "choose another position or other shares"
    return Infeasible.of(_at(point, where), must_hold, received, remedy)


def _superposed(field: Field, payload: Payload, point: Array, shares: Array) -> LiftCurrent:
    """The lift current of a field that is the sum of its coils' fields and a constant, which may be zero."""
    at = point[None, :]
    balance = magnet_balance(field, shares, payload, point, _model(payload))
    check_position(balance.box, point, _POSITION)
    if field.proportional:
        without = balance.reaction_force(at)[0]
        held = "the field is proportional to the currents (no saturation)"
    else:
        without = replace(balance, currents=0.0 * shares).magnetic_force(at)[0]
        held = "a field that no current drives, and fields in proportion to the currents (no saturation)"
    by_coils = balance.magnetic_force(at)[0] - without
    _require_pull(balance, point, by_coils)
    current = float((balance.weight - without[2]) / by_coils[2])
    balance = replace(balance, currents=current * shares)
    return _lift(current, payload, balance, point, by_coils, (f"linear: {held}", _upright(payload)))


def _lift(
    current: float,
    payload: Payload,
    balance: MagnetBalance,
    point: Array,
    force_per_ampere: Array,
    assumptions: tuple[str, ...],
    history: tuple[tuple[float, float], ...] = (),
) -> LiftCurrent:
    held, notes = held_at(balance, payload, point)
    off = abs(float(balance.rule_error(point)[2] / force_per_ampere[2]))
    rule = rule_stated(payload, _model(payload), off, "A of the current")
    drawn = [float(np.linalg.norm(balance.reaction_force(point[None, :])))]
    notes = (*reaction_stated(balance.source, payload, drawn, "at the place"), *notes)
    return LiftCurrent(
        current=current,
        currents=balance.currents,
        position=point,
        force=balance.magnetic_force(point[None, :])[0],
        force_per_ampere=force_per_ampere,
        stiffness=balance.stiffness(point),
        held=held,
        field=balance.flux_density(point),
        volume_error=off,
        assumptions=(*rule, *assumptions, *notes),
        history=history,
    )


def _by_secant(
    field: Field,
    payload: Payload,
    point: Array,
    shares: Array,
    first: float,
    tolerance: float,
    on_state: Callable[[float, float], None] | None,
) -> LiftCurrent:
    """The lift current by the secant method, from `first` on, to 1e-9 for a field that superposes, which is cheap."""
    at = point[None, :]
    balance = magnet_balance(field, first * shares, payload, point, _model(payload))
    check_position(balance.box, point, _POSITION)
    limit, most = (1e-9, 4 * MAX_STATES) if field.affine else (tolerance, MAX_STATES)
    tried: list[tuple[float, float]] = []
    forces: list[Array] = []
    current = first
    while True:
        balance = replace(balance, currents=current * shares)
        try:
            forces.append(balance.magnetic_force(at)[0])
        except OutsideMapError as error:
            if not tried:
                raise
            must_hold = "the lift must reach the weight at a current that the field holds"
            received = (
                f"lift / weight {_last(tried)}; {payload.held()}; the field does not hold {current:.4g} A"
            )
            remedy = "choose a position nearer to the iron, or a field that holds more current"
            if tried[0][1] < -1.0:
                remedy = 'turn the shares around, or the magnet (payload.direction = "down" or "up")'
            raise OutsideMapError.of(_at(point), must_hold, received, remedy) from error
        if not tried and not payload.soft:
            _require_pull(balance, point, forces[0] - balance.reaction_force(at)[0])
        tried.append((current, float(forces[-1][2] / balance.weight - 1.0)))
        if on_state is not None:
            on_state(current, tried[-1][1] + 1.0)
        if abs(tried[-1][1]) <= limit and len(tried) > 1:
            break
        if len(tried) == most:
            must_hold = f"the lift must reach the weight within {most} states"
            received = f"lift / weight at the last of them: {_last(tried)}"
            remedy = (
                "choose a position nearer to the iron, other shares, or a first current nearer to the answer"
            )
            problem = Problem(_at(point), must_hold, received, remedy)
            raise NotConverged(problem, residuals=tuple(abs(value) for _, value in tried))
        if payload.soft and forces[0][2] <= 0.0:
            must_hold = "the field must pull the payload up at the first current"
            remedy = (
                "choose another position, other shares, or another first current; where every coil may carry its "
                "own: fieldmap currents --lift, or currents_for of the map"
            )
            received = f"{payload.description}, {first:g} A, no lift"
            raise Infeasible.of(_at(point), must_hold, received, remedy)
        # The pull on soft iron grows with the square of the current.
        current = _next_current(tried, 0.5 if payload.soft else 1.0)
    if field.affine and isinstance(balance, BodyBalance):
        about = wrench_actuation(field, point, balance.body, balance.currents, balance.orientation)
        slope = about.matrix[:3] @ shares
    else:
        far = [k for k in range(len(tried) - 1) if abs(tried[k][0] / current - 1.0) >= _SLOPE_WIDTH]
        other = min(far or range(len(tried) - 1), key=lambda k: abs(tried[k][0] - current))
        slope = (forces[-1] - forces[other]) / (current - tried[other][0])
    history = () if field.affine else tuple((i, float((v + 1.0) * balance.weight)) for i, v in tried)
    soft = balance.body.assumptions if isinstance(balance, BodyBalance) else ()
    held = (
        ()
        if field.affine
        else ("nonlinear iron: a state of its own for each set of currents, no hysteresis",)
    )
    return _lift(current, payload, balance, point, slope, (*held, _upright(payload), *soft), history)


def _model(payload: Payload) -> MagnetModel:
    """The model of the payload; pieces stay upright here, even if the payload may turn."""
    return "fixed" if payload.pieces else model_of(payload)


def _upright(payload: Payload) -> str:
    what = f"the payload of {payload.description}" if payload.pieces else "the magnet"
    how = "stays upright" if _model(payload) == "fixed" else "stays parallel to the local field"
    return f"{what} {how}"


def _next_current(tried: Sequence[tuple[float, float]], power: float = 1.0) -> float:
    """The current at which F_z / (m g) - 1 should vanish, from (current, its value) of the states so far.

    power: after the first state, the current is divided by F_z / (m g) to this power.
    """
    current, value = tried[-1]
    if len(tried) == 1:
        # If the first current is right already, the next one still differs from it, for the slope.
        guess = current / (1.0 + value) ** power
        return guess if abs(guess / current - 1.0) > _SLOPE_WIDTH else (1.0 + 2.0 * _SLOPE_WIDTH) * guess
    before, before_value = tried[-2]
    fall = value - before_value
    guess = current - value * (current - before) / fall if fall else np.inf
    low = max((t for t in tried if t[1] < 0), key=lambda t: t[1], default=None)
    high = min((t for t in tried if t[1] >= 0), key=lambda t: t[1], default=None)
    if low is not None and high is not None:
        inside = min(low[0], high[0]) < guess < max(low[0], high[0])
        return guess if inside else 0.5 * (low[0] + high[0])
    largest = _LARGEST_GROWTH * max(abs(i) for i, _ in tried)
    return float(np.clip(guess, -largest, largest))


def _checked(field: Field, shares: Any, first: float, tolerance: float) -> Array:
    """Shares (n_coils,), if these and the other numbers fit. Raises InputError."""
    weights = coil_currents(1.0 if shares is None else shares, field.coil_names)
    positive = bool(np.isfinite(first)) and first > 0
    rules = (
        (weights.any(), "shares", "must not all be zero", weights.tolist(), "try np.ones(n_coils)"),
        (positive, "first", "must be a positive current", first, "try 1.0"),
        (0 < tolerance < 1, "tolerance", "must lie between 0 and 1", tolerance, "try 1e-4"),
    )
    raise_all(
        Problem(f"lift_current({name})", must_hold, f"{received}", remedy)
        for holds, name, must_hold, received, remedy in rules
        if not holds
    )
    return weights


def _last(tried: Sequence[tuple[float, float]]) -> str:
    return ", ".join(f"{value + 1.0:.4g} at {current:.4g} A" for current, value in tried[-4:])


def _at(point: Array, where: str = "lift_current") -> str:
    return f"{where} at {(1e3 * point).round(3).tolist()} mm"


# A combination of coils whose force per ampere is less than this share of the largest is left out: it would need more
# than a thousand times the current.
_WEAKEST = 1e-3
# Coils push along x or y alone if no component of their force has an error above this share of the force.
_LEFT = 0.1


def force_per_ampere(field: Field, moment: Array, point: Array, currents: Array) -> Array:
    """Force of a point dipole per ampere in each coil.

    By central differences, 1 % of the largest current to either side. They are exact for a field that is proportional
    to the currents, and of second order in the step where iron saturates.

    Parameters
    ----------
    field
        Any field.
    moment
        Of the dipole (3,), A m^2.
    point
        Its position (3,), m.
    currents
        Currents (n,), A, at which the derivative is taken.

    Returns
    -------
    Array
        dF/di (3, n), N/A.
    """
    return Balance(field, currents, 0.0, float(np.linalg.norm(moment)), moment).force_per_current(point)


def lift_shares(force_per_ampere: ArrayLike) -> Array:
    """Currents of least power that lift, with the smallest possible sideways force.

    Parameters
    ----------
    force_per_ampere
        Force of the magnet by the coils' currents (3, n), N/A.

    Returns
    -------
    Array
        (n,), scaled to a largest size of 1.

    Raises
    ------
    Infeasible
        If the coils do not lift.

    Examples
    --------
    >>> lift_shares([[0.1, -0.1], [0.0, 0.0], [0.3, 0.3]]).round(9).tolist()
    [1.0, 1.0]
    """
    return _towards(force_per_ampere, 2)


def push_shares(force_per_ampere: ArrayLike, axis: int) -> Array:
    """Currents of least power that push along x or y only.

    Parameters
    ----------
    force_per_ampere
        Force of the magnet by the coils' currents (3, n), N/A.
    axis
        0 for x, 1 for y.

    Returns
    -------
    Array
        (n,), scaled to a largest size of 1.

    Raises
    ------
    Infeasible
        If the coils cannot push along that axis alone.

    Examples
    --------
    >>> push_shares([[0.1, -0.1], [0.0, 0.0], [0.3, 0.3]], axis=0).round(9).tolist()
    [1.0, -1.0]
    """
    return _towards(force_per_ampere, axis)


def signal_pushes(force_per_ampere: ArrayLike) -> tuple[Array, tuple[str, ...]]:
    """Currents (n, 2) of `push_shares` along x and y, zero for an axis along which the coils cannot push alone; and the
    names of such axes."""
    pushes, idle = [], []
    for axis in (0, 1):
        try:
            pushes.append(push_shares(force_per_ampere, axis))
        except Infeasible:
            pushes.append(np.zeros(np.shape(force_per_ampere)[1]))
            idle.append("xy"[axis])
    return np.column_stack(pushes), tuple(idle)


def idle_note(axis: str) -> str:
    """The assumption for an axis along which the coils cannot push alone."""
    return f"the coils do not push along {axis} by themselves: that signal does nothing"


def _towards(force_per_ampere: ArrayLike, axis: int) -> Array:
    """Currents (n,) of least power that push along one axis only, scaled to a largest size of 1. Raises Infeasible if
    there are none."""
    given = np.transpose(force_per_ampere)
    force, wanted = check_signal("least_power(force_per_ampere).T", given, columns=3).T, np.eye(3)[axis]
    currents = np.linalg.pinv(force, rcond=_WEAKEST) @ wanted
    made = force @ currents
    # The lift may also push sideways, because a stiffness or another signal balances that. A direction signal may not.
    left = abs(made[2] - 1.0) if axis == 2 else float(np.abs(made - wanted).max())
    if left > (0.5 if axis == 2 else _LEFT):
        must = f"the coils must push the magnet along {'xyz'[axis]}"
        received = f"{force[axis].tolist()} N/A along it, of at most {np.abs(force).max():.2g} N/A"
        remedy = "begin at another place, or turn or add a coil"
        raise Infeasible.of("least_power", must, received, remedy)
    return np.asarray(currents / np.abs(currents).max())
