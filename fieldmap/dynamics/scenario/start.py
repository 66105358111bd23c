"""Start of a scenario: the height, the currents that carry the body, the control allocation, the operating point."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.dynamics.allocation import ControlAllocation, least_power_allocation
from fieldmap.dynamics.machine import Machine
from fieldmap.dynamics.operating_point import OperatingPoint, find_operating_point
from fieldmap.dynamics.weight_balance import WeightBalance
from fieldmap.errors import Infeasible, NoEquilibrium, OutsideMapError, Problem, ScenarioError
from fieldmap.inputs.document import AtKey
from fieldmap.levitation import lift_shares
from fieldmap.typing import Array

# A height that the program chooses takes at most this share of the lasting currents of amplifiers and supply; the rest
# is left for control.
_EASY = 0.5
# Number of heights of the map at which a start is tried.
_HEIGHTS = 21


def carrying(balance: WeightBalance, place: Array, where: str) -> Array:
    """Currents (n,), A, of least power that carry the body with the magnet at a place (3,), m; where: for messages.

    Raises ScenarioError for a place outside the map, Infeasible if no currents carry the body.
    """
    lower, upper = balance.field.lower, balance.field.upper
    try:
        if (lower <= place).all() and (place <= upper).all():
            return balance.currents(place)
    except OutsideMapError:
        pass
    except Infeasible as error:
        (problem,) = error.problems
        raise Infeasible(_at(where, problem), share=error.share) from None
    received = f"the magnet at {[round(1e3 * float(p), 3) for p in place]} mm"
    corners = " to ".join(str([round(1e3 * float(v), 3) for v in c]) for c in (lower, upper))
    must, remedy = f"the body must be inside the map, {corners} mm", "begin elsewhere, or make a larger map"
    raise ScenarioError(AtKey(where, must, received, remedy))


def easy_height(balance: WeightBalance, x: float, y: float, where: str) -> float:
    """Height of the magnet, m, at x and y at which the body is carried easily.

    It is the height nearest to the middle of the map at which half of the lasting currents carry the body; if there is
    none, the one that takes the least share of them. A body that may turn floats where the field points along its
    moment, if there is such a height. Raises Infeasible where no height is possible, ScenarioError where the body is
    outside the map at all of them.
    """
    magnet, (lower, upper) = balance.body.magnet, balance.limits
    low, high = (float(corner[2]) for corner in (balance.field.lower, balance.field.upper))
    middle, room = 0.5 * (low + high), 0.05 * (high - low)
    best: tuple[bool, float, float] | None = None
    refused: list[Infeasible] = []
    outside: ScenarioError | None = None
    for height in sorted(np.linspace(low + room, high - room, _HEIGHTS), key=lambda z: abs(z - middle)):
        place = np.array([x, y, height])
        try:
            currents = carrying(balance, place, where)
        except Infeasible as error:
            refused.append(error)
            continue
        except ScenarioError as error:
            outside = error
            continue
        moment = magnet.moments.sum(axis=0)
        stays = balance.body.upright or bool(magnet.soft)
        against = not stays and float(balance.field.field(place, currents) @ moment) <= 0.0
        share = float(np.max(np.abs(currents) / np.maximum(np.where(currents > 0.0, upper, -lower), 1e-12)))
        # All that are easy count alike: the one nearest to the middle comes first.
        this = (against, max(share, _EASY), float(height))
        if best is None or this[:2] < best[:2]:
            best = this
        if not against and share <= _EASY:
            break
    if best is None and not refused:
        assert outside is not None
        raise outside
    if best is None:
        (problem,) = max(refused, key=lambda error: error.share or 0.0).problems
        must = f"{problem.must_hold}, or elsewhere between z = {1e3 * low:g} and {1e3 * high:g} mm"
        remedy = "take a lighter payload, allow larger currents, or begin at other x and y"
        raise Infeasible(AtKey(where, must, problem.received, remedy))
    return best[2]


def allocation_about(
    balance: WeightBalance, place: Array, currents: Array, gain: float, where: str
) -> ControlAllocation:
    """The allocation by least power, linearised at a place (3,), m, and currents (n,), A; gain: of the amplifiers, A/V.

    Its scale is the largest of the currents that carry the body. If something that no current drives lifts too, these
    may be zero or pull down; the scale is then that of currents that carry the weight alone.
    """
    force = balance.force_per_ampere(place, currents)
    largest = float(np.abs(currents).max())
    shares = currents / (largest or 1.0)
    if balance.field.fixed_sources:
        try:
            shares = lift_shares(force)
        except Infeasible as error:
            (problem,) = error.problems
            raise Infeasible(_at(where, problem)) from None
        largest = balance.weight / float(force[2] @ shares)
    return least_power_allocation(force, shares, largest / gain)


def _at(where: str, problem: Problem) -> Problem:
    return AtKey(where, problem.must_hold, problem.received, problem.remedy)


def floating(
    machine: Machine, held: tuple[Array, Array], guess: ArrayLike, near: ArrayLike, where: str
) -> OperatingPoint:
    """Find the operating point of a machine.

    Parameters
    ----------
    machine
        The machine.
    held
        Sensed point (3,), m, and outputs (3,); NaN for components that are free.
    guess
        (3,), outputs near the solution.
    near
        Sensed point (3,), m, near the solution.
    where
        For messages: key of the scenario, or words.

    Raises
    ------
    NoEquilibrium
        If there is none.
    Infeasible
        If its currents are beyond the amplifiers or the supply.
    """
    try:
        point = find_operating_point(machine, *held, guess, near)
    except NoEquilibrium as error:
        raise NoEquilibrium(*(_at(where, problem) for problem in error.problems)) from None
    low, high = machine.drive.steady
    beyond = np.maximum(point.currents - high, low - point.currents)
    worst = int(np.argmax(beyond))
    if beyond[worst] > 1e-9 * max(1.0, abs(point.currents[worst])):
        limit = (high if point.currents[worst] > 0 else low)[worst]
        must = f"the body must float within the limits of amplifiers and supply, {limit:.4g} A"
        received = f"{point.currents[worst]:.3g} A"
        remedy = "begin at another place, take a lighter payload, or allow larger currents"
        raise Infeasible(AtKey(where, must, received, remedy))
    return point


def floating_at(
    machine: Machine, held: tuple[Array, Array], start: OperatingPoint, heights: Sequence[float]
) -> list[OperatingPoint]:
    """Operating points with the sensed point at several heights.

    Each search begins at the nearest height that is solved already.

    Parameters
    ----------
    machine, held
        As in `floating`; the held height is replaced.
    start
        A known operating point.
    heights
        Heights of the sensed point, m.

    Raises
    ------
    NoEquilibrium, Infeasible
        As in `floating`.
    """
    (x, y, _), outputs = held
    begin = float(start.sensed[2])
    known = {begin: start}
    for height in sorted(heights, key=lambda height: abs(height - begin)):
        nearest = min(known, key=lambda there: abs(there - height))
        if abs(nearest - height) < 1e-12:
            known[height] = known[nearest]
        else:
            there, where = known[nearest], f"the sensed point at z = {1e3 * height:.6g} mm"
            place = np.array([x, y, height])
            known[height] = floating(machine, (place, outputs), there.outputs, there.sensed, where)
    return [known[height] for height in heights]
