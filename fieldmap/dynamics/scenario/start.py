"""Start of a scenario: the currents that carry the body, the control allocation, the operating point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.currents import IndependentCurrents
from fieldmap.device import Payload
from fieldmap.dynamics.allocation import ControlAllocation, ParametrisedAllocation, least_power_allocation
from fieldmap.dynamics.machine import Machine
from fieldmap.dynamics.operating_point import OperatingPoint, find_operating_point
from fieldmap.dynamics.rigid_body import RigidBody
from fieldmap.errors import Infeasible, NotConverged, Problem, ScenarioError
from fieldmap.inputs.document import AtKey
from fieldmap.levitation import force_per_ampere, lift_current, lift_shares
from fieldmap.lookup import FieldMap, division_domain, saturates, wrench_actuation
from fieldmap.records import Record
from fieldmap.typing import Array

# A height that the program chooses takes at most this share of the lasting currents of amplifiers and supply; the rest
# is left for control.
_EASY = 0.5
# Currents for soft iron are first looked for within this share of the lasting currents: there may be several solutions,
# and the limits exclude uneven ones.
_EASIER = 0.9
# Number of heights of the map at which a start is tried.
_HEIGHTS = 21


@dataclass(frozen=True, eq=False, repr=False)
class Lift(Record):
    """First guess of the operating point: currents that approximately carry a body in a map.

    Attributes
    ----------
    opened : the map.
    payload, body : what is carried.
    scale : factor of the map's field.
    limits : lowest and highest lasting currents (n,), A.
    divided : whether the currents are divided by lift and directions.
    """

    opened: FieldMap
    payload: Payload
    body: RigidBody
    scale: float
    limits: tuple[Array, Array]
    divided: bool

    @property
    def weight(self) -> float:
        """Weight of the body, N."""
        return self.body.mass * self.body.gravity

    def currents(self, point: Array) -> Array:
        """Currents (n,), A, that approximately carry the body with the magnet at a point (3,), m.

        Raises ScenarioError for a point outside the map, Infeasible if no currents carry the body.
        """
        lower, upper = self.opened.lower, self.opened.upper
        if not (lower <= point).all() or not (point <= upper).all():
            received = f"the magnet at {[round(1e3 * float(p), 3) for p in point]} mm"
            corners = " to ".join(str([round(1e3 * float(v), 3) for v in c]) for c in (lower, upper))
            must, remedy = f"must be inside the map, {corners} mm", "begin elsewhere, or make a larger map"
            raise ScenarioError(AtKey("start", must, received, remedy))
        soft, saturating = bool(self.body.magnet.soft), saturates(self.opened)
        free = isinstance(self.opened.parametrisation, IndependentCurrents)
        if saturating and not (soft and free):
            return self._equal(point)
        if self.divided and not saturating:
            return lift_current(self.opened, self.payload, point).currents / self.scale
        return self._for_soft_iron(point) if soft else self._least_power(point)

    def height(self, x: float, y: float) -> float:
        """Height of the magnet, m, at x and y at which the body is carried easily.

        It is the height nearest to the middle of the map at which half of the lasting currents carry the body. If the
        body may turn, its moment must point along the field there. If there is no such height, it is the one that takes
        the least share of the lasting currents; the middle if no height is possible.
        """
        low, high = (float(corner[2]) for corner in (self.opened.lower, self.opened.upper))
        middle, room = 0.5 * (low + high), 0.05 * (high - low)
        chosen, least = middle, np.inf
        heights = np.linspace(low + room, high - room, _HEIGHTS)
        for height in sorted(heights, key=lambda z: abs(z - middle)):
            point = np.array([x, y, height])
            try:
                currents = self.currents(point)
            except Infeasible:
                continue
            moment = self.body.magnet.moments.sum(axis=0)
            along = bool(self.body.magnet.soft) or float(self.opened.field(point, currents) @ moment) > 0.0
            limit = np.where(currents > 0.0, self.limits[1], -self.limits[0])
            share = float(np.max(np.abs(currents) / np.maximum(limit, 1e-12)))
            if share < least and (along or self.body.upright):
                chosen, least = float(height), share
            if least <= _EASY:
                break
        return chosen

    def allocation(self, point: Array, currents: Array, gain: float) -> ControlAllocation:
        """The allocation by least power, linearised at a point (3,), m, and currents (n,), A; gain: of the amplifiers,
        A/V.

        Its scale is the largest of the currents that carry the body. If something that no current drives lifts too,
        these may be zero or pull down; the scale is then that of currents that carry the weight alone.
        """
        force = self._force_per_ampere(point, currents)
        if self.opened.fixed_sources:
            shares = lift_shares(force)
            largest = self.weight / float(self.scale * force[2] @ shares)
        else:
            largest = float(np.abs(currents).max())
            shares = currents / largest
        return least_power_allocation(force, shares, largest / gain)

    def _force_per_ampere(self, point: Array, currents: Array) -> Array:
        """Force per ampere (3, n), N/A, of the map without its scale. For soft iron it depends on the currents, and is
        taken at the currents times the scale."""
        if not self.body.magnet.soft:
            return force_per_ampere(self.opened, self.body.magnet.moments.sum(axis=0), point, currents)
        return wrench_actuation(self.opened, point, self.body.magnet, self.scale * currents).matrix[:3]

    def _for_soft_iron(self, point: Array) -> Array:
        """Currents of least power that carry a body of soft iron.

        The horizontal force is zero and the currents keep a distance from their limits, if the coils can do that. Then
        the conditions are dropped one after the other.
        """
        low, high = self.limits
        within = _EASIER * self.scale * low, _EASIER * self.scale * high
        upward, free = np.array([0.0, 0.0, self.weight]), np.array([np.nan, np.nan, self.weight])
        problem: Problem | None = None
        for force, limits in ((upward, within), (upward, None), (free, None)):
            try:
                return self.opened.currents_for(point, force, self.body.magnet, limits) / self.scale
            except (Infeasible, NotConverged) as error:
                problem = error.problems[0]
        assert problem is not None
        raise _at_start(problem)

    def _least_power(self, point: Array) -> Array:
        """Currents of least power that carry the weight, for linear iron."""
        moment, ones = self.body.magnet.moments.sum(axis=0), np.ones(len(self.opened.coil_names))
        force = self.scale * force_per_ampere(self.opened, moment, point, ones)
        try:
            shares = lift_shares(force)
        except Infeasible as error:
            raise _at_start(error.problems[0]) from None
        carried = shares * self.weight
        if self.opened.fixed_sources:
            carried -= shares * self.scale * float(moment @ self.opened.constant_gradient(point)[:, 2])
        return np.asarray(carried / (force[2] @ shares))

    def _equal(self, point: Array) -> Array:
        """Equal currents in all coils that carry the weight, for saturating iron."""
        opened, scale = self.opened, self.scale
        coils, domain, reduced = len(opened.coil_names), division_domain(opened), opened.info.reduced_model
        levels = np.linspace(domain[0][0], domain[1][0], 9) if domain else np.linspace(0.3, 3.0, 10)
        if opened.fixed_sources and not domain and isinstance(opened.parametrisation, IndependentCurrents):
            # A source that no current drives may lift too much, so negative currents are tried too.
            assert reduced is not None
            levels = np.linspace(float(reduced.lower.max()), float(reduced.upper.min()), 25)
        equal = [np.full(coils, level) for level in levels]
        if self.body.magnet.soft:
            lift = np.array([opened.wrench(point, self.body.magnet, scale * each)[2] for each in equal])
        else:
            moment = self.body.magnet.moments[:, 2].sum() * scale
            lift = moment * np.array([opened.gradient(point, each)[2, 2] for each in equal])
        if opened.fixed_sources and lift[0] > lift[-1]:
            levels, lift = levels[::-1], lift[::-1]
        if lift.max() < self.weight:
            must = f"equal currents of {levels[0]:.3g} to {levels[-1]:.3g} A must carry the body at the start"
            received = f"{lift.max() / self.weight:.2g} of the weight at most"
            raise Infeasible(AtKey("field.scale", must, received, "raise the scale, or begin higher"))
        return np.full(coils, float(np.interp(self.weight, lift, levels)))


def _at_start(problem: Problem) -> Infeasible:
    return Infeasible(AtKey("start", problem.must_hold, problem.received, problem.remedy))


def outputs_near(machine: Machine, opened: FieldMap, currents: Array) -> list[float]:
    """Outputs (3,) that approximately give currents (n,), A: the first guess of the search for the operating point."""
    divided = isinstance(machine.allocation, ParametrisedAllocation)
    level = float(np.mean(currents) if divided else np.abs(currents).max())
    if not divided and opened.fixed_sources:
        lift = machine.allocation.voltages(np.array([1.0, 0.0, 0.0]))
        level = float(currents @ lift / (lift @ lift))
    return [level / machine.drive.amplifier.gain, 0.0, 0.0]


def floating(machine: Machine, held: tuple[Array, Array], guess: ArrayLike) -> OperatingPoint:
    """Find the operating point of a machine.

    Parameters
    ----------
    machine
        The machine.
    held
        Sensed point (3,), m, and outputs (3,); NaN for components that are free.
    guess
        (3,), outputs near the solution.

    Raises
    ------
    NoEquilibrium
        If there is none.
    Infeasible
        If its currents are beyond the amplifiers or the supply.
    """
    point = find_operating_point(machine, *held, guess)
    low, high = machine.drive.steady
    beyond = np.maximum(point.currents - high, low - point.currents)
    worst = int(np.argmax(beyond))
    if beyond[worst] > 1e-9 * max(1.0, abs(point.currents[worst])):
        limit = (high if point.currents[worst] > 0 else low)[worst]
        must = f"the body must float within the limits of amplifiers and supply, {limit:.4g} A"
        received = f"{point.currents[worst]:.3g} A"
        remedy = "begin higher or nearer to the axis, take a lighter payload, or state a field.scale; "
        remedy += "a start without depth_mm is at the height that takes least already"
        raise Infeasible(AtKey("start", must, received, remedy))
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
        Of the sensed point, m.

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
            known[height] = floating(machine, (np.array([x, y, height]), outputs), known[nearest].outputs)
    return [known[height] for height in heights]
