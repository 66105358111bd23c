"""The current that carries the weight where iron saturates: a secant iteration over whole states."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.device.model import Payload
from fieldmap.errors import InputError, NotConverged, Problem
from fieldmap.levitation.balance import Balance
from fieldmap.levitation.checks import check_payload, check_position
from fieldmap.levitation.conventions import GRAVITY
from fieldmap.levitation.dipole import dipole_force
from fieldmap.levitation.interface import LevitationField
from fieldmap.levitation.lift import LiftCurrent, direction_of_lift
from fieldmap.typing import Array

StateAt = Callable[[Array], LevitationField]

MAX_STATES = 15
# No step multiplies the current by more than this; beyond the knee of the B-H curve a secant can be far off.
_LARGEST_GROWTH = 3.0
# The slope dF/di is taken over at least this relative difference of currents, where there is one.
_SLOPE_WIDTH = 0.01
_WHERE = "lift_current_nonlinear(position)"


@dataclass(frozen=True, eq=False)
class _Trial:
    """One state: common current (A), the gradient (3, 3) at the magnet, and the field."""

    current: float
    gradient: Array
    field: LevitationField


def lift_current_nonlinear(
    solve_at: StateAt,
    payload: Payload | None,
    position: ArrayLike,
    shares: ArrayLike,
    first: float = 1.0,
    tolerance: float = 1e-4,
    on_state: Callable[[float, float], None] | None = None,
) -> LiftCurrent:
    """Common current that carries the weight at a position when force is not proportional to current.

    solve_at(currents (n_coils,)): the field at these currents, as a `LevitationField` that need hold for no
    others (`FixedCurrents`); it is called some four times, each time near the last, so that it may start from
    there. position (3,): the magnet's centre, m. shares (n_coils,): current of each coil per ampere of common
    current. first: common current of the first state, A, positive; the second one follows by proportion, all
    others by the secant, kept inside the bracket once there is one. Done when |F_z - m g| <= tolerance m g.
    on_state(common current in A, F_z / (m g)) is called after each state.

    Returns a `LiftCurrent`; its force balances the weight to `tolerance`, its force_per_ampere is dF/di, by the
    difference of two states some per cent apart, and `history` lists the states. Raises InputError for a payload,
    position, shares, first or tolerance that do not fit, Infeasible when the field does not lift there,
    NotConverged after MAX_STATES.

    Example::

        solver = fieldmap.iron.NonlinearSolver(device)
        def solve_at(currents):
            return DifferencedField(FixedCurrents(solver.solve(currents)), lower, upper)
        lift = lift_current_nonlinear(solve_at, device.payload, [0, 0, -0.102], np.ones(6), first=1.5)
    """
    carried = check_payload(payload, "lift_current_nonlinear")
    weights = _check_numbers(shares, first, tolerance)
    weight = carried.mass * GRAVITY
    trials = [_trial(solve_at, first, weights, position)]
    point = check_position(trials[0].field, position, _WHERE)
    moment = carried.moment * direction_of_lift(point, carried.moment, trials[0].gradient)
    while True:
        tried = [(trial.current, moment * trial.gradient[2, 2] / weight - 1.0) for trial in trials]
        if on_state is not None:
            on_state(tried[-1][0], tried[-1][1] + 1.0)
        if abs(tried[-1][1]) <= tolerance and len(trials) > 1:
            return _result(trials, carried, moment, point, weights)
        if len(trials) == MAX_STATES:
            raise _not_converged(point, tried)
        trials.append(_trial(solve_at, _next_current(tried), weights, position))


def _trial(solve_at: StateAt, current: float, shares: Array, position: ArrayLike) -> _Trial:
    field = solve_at(current * shares)
    point = check_position(field, position, _WHERE)
    return _Trial(current, field.gradient(point[None, :], current * shares)[0], field)


def _next_current(tried: Sequence[tuple[float, float]]) -> float:
    """Where F_z / (m g) - 1 should vanish, from (current, its value) of the states so far."""
    current, value = tried[-1]
    if len(tried) == 1:
        # Force in proportion to current; a current that is right already is left a little, for the slope.
        guess = current / (1.0 + value)
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


def _result(
    trials: list[_Trial], payload: Payload, moment: float, point: Array, shares: Array
) -> LiftCurrent:
    found, vertical = trials[-1], np.array([0.0, 0.0, moment])
    currents = found.current * shares
    balance = Balance(found.field, currents, payload.mass, payload.moment, vertical)
    force = dipole_force(vertical, found.gradient)
    others = sorted(trials[:-1], key=lambda trial: abs(trial.current - found.current))
    wide = [t for t in others if abs(t.current - found.current) >= _SLOPE_WIDTH * abs(found.current)]
    other = (wide or others)[0]
    return LiftCurrent(
        current=found.current,
        currents=currents,
        position=point,
        force=force,
        force_per_ampere=(force - dipole_force(vertical, other.gradient)) / (found.current - other.current),
        stiffness=balance.stiffness(point),
        field=found.field.field(point[None, :], currents)[0],
        assumptions=(
            "nonlinear iron: a state of its own for each set of currents, no hysteresis",
            "the magnet is a vertical point dipole at its centre and does not magnetise the iron",
        ),
        history=tuple((trial.current, float(moment * trial.gradient[2, 2])) for trial in trials),
    )


def _check_numbers(shares: ArrayLike, first: float, tolerance: float) -> Array:
    weights = np.asarray(shares, dtype=float)
    problems = []
    if weights.ndim != 1 or not np.isfinite(weights).all() or not weights.any():
        must = "must hold one finite number per coil, not all of them zero"
        problems.append(
            Problem("lift_current_nonlinear(shares)", must, f"{weights.tolist()}", "try np.ones(n_coils)")
        )
    if not (np.isfinite(first) and first > 0):
        problems.append(
            Problem("lift_current_nonlinear(first)", "must be a positive current", f"{first}", "try 1.0")
        )
    if not 0 < tolerance < 1:
        problems.append(
            Problem(
                "lift_current_nonlinear(tolerance)", "must lie between 0 and 1", f"{tolerance}", "try 1e-4"
            )
        )
    if problems:
        raise InputError(*problems)
    return weights


def _not_converged(point: Array, tried: list[tuple[float, float]]) -> NotConverged:
    last = ", ".join(f"{value + 1.0:.4g} at {current:.4g} A" for current, value in tried[-4:])
    return NotConverged(
        Problem(
            f"lift_current_nonlinear at {(1e3 * point).round(3).tolist()} mm",
            f"the lift must reach the weight within {MAX_STATES} states",
            f"lift / weight at the last of them: {last}",
            "choose a position nearer to the iron, other shares, or a first current nearer to the answer",
        ),
        residuals=tuple(abs(value) for _, value in tried),
    )
