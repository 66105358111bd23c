"""The operating point of a machine: the state and the outputs in equilibrium of forces and torques."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import scipy
from numpy.typing import ArrayLike

from fieldmap.arguments import check, check_signal
from fieldmap.core.machine import INSIDE, POSITION, TURN, sensed_point
from fieldmap.dynamics.machine import Machine
from fieldmap.dynamics.motion import state_of
from fieldmap.errors import NoEquilibrium
from fieldmap.records import Record
from fieldmap.typing import Array

# Largest residual of an equilibrium, as a share of the weight. It exceeds the steps of a map in harmonic form between
# cells, about 1e-7 of its field.
_ACCURACY = 1e-6
# Largest residual where the force steps over zero between cells of a coarse map, as a share of the weight.
_STEP = 2e-4
# For `is_step`, in the units below: largest distance to the zero by the slopes, and half-width of the differences.
_NEXT, _AROUND = 1e-2, 1e-3
# Units of the unknowns: 1 mm, 0.1 rad, 1 V; of the residual: the weight, and the weight times 10 mm.
_MILLI, _LEAN, _LEVER = 1e-3, 0.1, 0.01
# Offsets from the guess that are tried for every output except the first one, the lift.
_ASIDE = (0.0, 0.2, -0.2, 0.35, -0.35)


@dataclass(frozen=True, eq=False, repr=False)
class OperatingPoint(Record):
    """A machine in equilibrium: state (13,), currents (n,) A, outputs (m,), sensed point (3,) m; residual of force and
    torque, as shares of the weight and of the weight times 10 mm."""

    state: Array
    currents: Array
    outputs: Array
    sensed: Array
    residual: float


def find_operating_point(
    machine: Machine,
    sensed: ArrayLike,
    outputs: ArrayLike,
    guess: ArrayLike = (0.0, 0.0, 0.0),
    near: ArrayLike = (0.0, 0.0, 0.0),
) -> OperatingPoint:
    """Find the equilibrium with a given sensed point and given outputs; NaN marks unknowns.

    The unknowns are three numbers marked by NaN, and the lean of the body (2) unless it stays upright; the equations
    are three forces and two torques. With a given height the lift is unknown; either x or the x signal, and either y
    or the y signal are unknown. The amplifiers turn the outputs into currents without limits and rounding.

    Parameters
    ----------
    machine
        The machine.
    sensed
        (3,), m.
    outputs
        (m,).
    guess, near
        Outputs (m,) and sensed point (3,), m, from which the search for the unknowns begins.

    Returns
    -------
    OperatingPoint
        The operating point.

    Raises
    ------
    InputError
        If the number of NaN is not three.
    NoEquilibrium
        If the search ends with a residual above 1e-6 of the weight; above 2e-4 if the force steps over zero there, as
        between the cells of a coarse map: see `is_step`.
    """
    place, given = np.array(sensed, float), np.array(outputs, float)
    check_signal("find_operating_point(guess)", guess)
    begin = check_signal("find_operating_point(near)", near, columns=3)
    start = np.where(np.isnan(given), np.broadcast_to(np.asarray(guess, float), given.shape), given)
    free_place, free_output = np.isnan(place), np.isnan(given)
    count, must = int(free_place.sum() + free_output.sum()), "must leave three numbers free in all"
    remedy = "free the lift, and of x and y either the place or the signal"
    check(count == 3, "find_operating_point(sensed, outputs)", must, f"{count} NaN", remedy)
    body, weight = machine.body, machine.body.mass * machine.body.gravity
    core, free = (
        replace(machine, drag=None, plate=None, walls=None).core(1.0, search=True),
        int(free_place.sum()),
    )

    def parts(unknown: Array) -> tuple[Array, Array, Array]:
        """State, currents and outputs from the unknowns: positions, outputs, lean."""
        there, given = place.copy(), start.copy()
        there[free_place], given[free_output] = _MILLI * unknown[:free], unknown[free:3]
        lean = _LEAN * unknown[3:] if len(unknown) > 3 else np.zeros(2)
        angle = float(np.linalg.norm(lean))
        half = np.sinc(angle / 2 / np.pi) / 2
        state = state_of([0, 0, 0], quaternion=[np.cos(angle / 2), *(half * lean), 0.0])
        state[POSITION : POSITION + 3] = there - sensed_point(state, body.seen_at)
        return state, machine.drive.at_rest(machine.allocation.voltages(given)), given

    def residual(unknown: Array) -> Array:
        """Forces over the weight, torques about x and y over the weight times 10 mm; large outside the map."""
        state, currents, _ = parts(unknown)
        load = np.empty(6)
        inside = core.follow(np.ascontiguousarray(currents))
        if not inside or core.load(state, load)[0] != INSIDE:
            return np.full(len(unknown), 10.0 + float(np.abs(unknown).sum()))
        return np.concatenate([load[:3] / weight, load[3:5] / (weight * _LEVER)])[: len(unknown)]

    # Search from the position `near`, upright, at the guessed outputs and at offsets from them.
    lift, *others = start[free_output]
    best = None
    for share, *aside in product((1.0, 0.8, 1.25), *[_ASIDE] * len(others)):
        upright = np.zeros(0 if body.upright else 2)
        first = np.concatenate([begin[free_place] / _MILLI, [share * lift], np.add(others, aside), upright])
        found = scipy.optimize.root(residual, first, method="hybr", tol=1e-12)
        if best is None or np.abs(found.fun).max() < np.abs(best.fun).max():
            best = found
        if np.abs(best.fun).max() < _ACCURACY:
            break
    assert best is not None
    worst = float(np.abs(best.fun).max())
    if not (worst < _ACCURACY or (worst < _STEP and is_step(residual, best.x))):
        must, received = "forces and torques must balance", f"{worst:.1e} of the weight left over at best"
        remedy = "begin elsewhere in the map, or free another signal"
        raise NoEquilibrium.of("find_operating_point", must, received, remedy)
    state, currents, found_outputs = parts(best.x)
    seen = sensed_point(state, body.seen_at)
    state[TURN : TURN + 4] /= np.linalg.norm(state[TURN : TURN + 4])
    return OperatingPoint(state, currents, found_outputs, seen, worst)


def is_step(residual: Callable[[Array], Array], x: Array) -> bool:
    """Return whether a residual that does not vanish at x (n,) steps over zero there: its slopes about x predict a
    zero within 0.01. At a residual that only comes near zero, as at a fold, the slopes vanish and the predicted zero
    is far.

    >>> is_step(lambda x: x + 1e-4 * np.sign(x), np.array([1e-9])), is_step(lambda x: x**2 + 1e-4, np.array([1e-9]))
    (True, False)
    """
    steps = _AROUND * np.eye(len(x))
    slopes = np.column_stack([(residual(x + h) - residual(x - h)) / (2.0 * _AROUND) for h in steps])
    try:
        return bool(np.abs(np.linalg.solve(slopes, residual(x))).max() < _NEXT)
    except np.linalg.LinAlgError:
        return False
