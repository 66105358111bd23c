"""Currents of least power that meet a demand: a linear problem is solved directly, any other one by iteration.

docs/theory/actuation.md (5) and (8).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fieldmap.core.least_power import BEYOND_LIMITS, FOUND, NO_END, OUT_OF_RANGE
from fieldmap.errors import FieldmapError, Infeasible, NotConverged
from fieldmap.lookup.demand import Demand
from fieldmap.lookup.inverse_problem import Goal, Variables
from fieldmap.typing import Array

_ROUNDING = 1e-13
_FAINT = 1e-6  # least scale of a component, a share of `Goal.undirected`; weakest combination in use
_ROUNDING_OF_MODELS = 1e-12
_HALVINGS = 50
_NO_SHARE = 1e-9
# Accepted error of a component, as a share of the largest one of its unit, and strength of a combination of components,
# as a share of the strongest, below which it is used only if the stronger ones do not suffice. At a place of symmetry a
# demand may have more components than coils, and the mesh of the iron is less symmetric than the machine.
_NEARLY, _COMMANDED = 1e-4, 1e-3
_MOST_STEPS, _MOST_CHANGES = 100, 10
MOST_EVALUATIONS = 500
"""Most evaluations of the field at new values in all searches of one call."""
_NO_PROGRESS = 1e-4  # a share of the step below which the search gives up
# A search gives up if more than the share _FAR of the demand is missing and _PATIENCE steps have reduced this share by
# no more than a tenth. At limits it would creep towards the nearest reachable values.
_FAR, _PATIENCE = 1e-2, 10


def linear_currents(goal: Goal) -> Array:
    """Least-power currents (n,), A, that meet a linear goal. Raises Infeasible."""
    constant, matrix = goal.about(np.zeros(len(goal.variables.cost)))
    wanted = goal.demand.values - constant
    # If the constant meets a component to rounding, the currents need not add to it.
    wanted[np.abs(wanted) <= _ROUNDING * np.abs(constant)] = 0.0
    status, found, active = goal.variables.least_power(matrix, wanted)
    if status == OUT_OF_RANGE:
        nearly = _nearly(goal, matrix, wanted)
        if nearly is not None:
            return nearly
    if status != FOUND:
        raise _refusal(goal, status, active, matrix, constant)
    return found


def _of_unit(demand: Demand, sizes: Array) -> Array:
    """For each component the largest of the sizes (r,) of all components of its unit, (r,)."""
    units = np.array([name[0] for name in demand.names])
    return np.array([sizes[units == unit].max() for unit in units])


def _nearly(goal: Goal, matrix: Array, wanted: Array) -> Array | None:
    """Least-power variables (n,) that meet `wanted` (r,) to _NEARLY, if none meet it exactly; otherwise None."""
    sizes = _of_unit(goal.demand, np.abs(goal.demand.values))
    length = _of_unit(goal.demand, np.linalg.norm(matrix, axis=1))
    length[length == 0.0] = 1.0
    left, strength, _ = np.linalg.svd(matrix / length[:, None], full_matrices=False)
    first, last = (np.count_nonzero(strength > share * strength[0]) for share in (_COMMANDED, _FAINT))
    for count in range(first, last + 1):
        rows = left[:, :count].T / length
        status, found, _ = goal.variables.least_power(np.ascontiguousarray(rows @ matrix), rows @ wanted)
        if status == FOUND and (np.abs(matrix @ found - wanted) <= _NEARLY * sizes).all():
            return found
    return None


def _refusal(
    goal: Goal, status: int, active: NDArray[np.int64], matrix: Array, constant: Array
) -> FieldmapError:
    """The error for a linear demand that was not met: which limits bind, and the values that can be reached."""
    demand, variables = goal.demand, goal.variables
    if status == NO_END:
        must_hold, received = "the active-set method must end", demand.text(demand.values)
        return NotConverged.of("currents_for", must_hold, received, "report this case")
    if status == OUT_OF_RANGE:
        nearest = matrix @ np.linalg.lstsq(matrix, demand.values - constant, rcond=None)[0] + constant
        sizes = _of_unit(demand, np.abs(demand.values))
        if (np.abs(nearest - demand.values) <= _NEARLY * sizes).all():
            must_hold = "the demand must be within the limits of the currents"
            return demand.infeasible(must_hold, "ask for less, or widen the limits")
        must_hold = "some currents must meet the demand, even without limits"
        remedy = (
            f"the nearest values that currents reach: {demand.text(nearest)}; or demand less, such as no direction or "
            f"least field"
        )
        return demand.infeasible(must_hold, remedy, reachable=nearest)
    binding, limits = _binding(variables, np.where(active > 0, variables.high, variables.low), active != 0)
    must_hold = f"the demand must be within the limits of the currents; these limits exclude it: {limits}"
    share = _reachable_share(matrix, constant, demand.values, variables)
    if share is None:
        return demand.infeasible(must_hold, "the limits allow no share of the demand", binding=binding)
    part = share * demand.values
    remedy = f"the limits allow {share:.6g} of the demand: {demand.text(part)}"
    return demand.infeasible(must_hold, remedy, reachable=part, share=share, binding=binding)


def _binding(variables: Variables, values: Array, which: NDArray[np.bool_]) -> tuple[dict[str, float], str]:
    """The values (n,) that a mask (n,) selects, by name and as text."""
    chosen = np.flatnonzero(which)
    binding = {variables.names[k]: float(values[k]) for k in chosen}
    parts = [f"{variables.noun} {name} at {value:g}{variables.unit}" for name, value in binding.items()]
    return binding, ", ".join(parts)


def _reachable_share(matrix: Array, constant: Array, wanted: Array, variables: Variables) -> float | None:
    """Largest share of the demand that variables within the limits give; None if there is none.

    The largest t with matrix @ i + constant = t wanted for i within the limits. All such t form an interval. A problem
    with one more column, whose variable is 1 - t, gives one of them; bisection between it and 1 finds the largest.
    """
    low, high = np.append(variables.low, 0.0), np.append(variables.high, 1.0)
    ends = np.abs(np.concatenate([variables.low, variables.high]))
    # The variable 1 - t = 1 costs as much as a current at the largest limit, so that both terms are of one size.
    cost = np.append(np.ones(len(variables.low)), ends[np.isfinite(ends)].max(initial=0.0) ** 2 or 1.0)
    beside = np.ascontiguousarray(np.hstack([matrix, wanted[:, None]]))
    with_rest = replace(variables, low=low, high=high, cost=cost)
    status, found, _ = with_rest.least_power(beside, wanted - constant)
    if status != FOUND:
        return None
    share, more = 1.0 - float(found[-1]), 1.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (share + more)
        if variables.least_power(matrix, middle * wanted - constant)[0] == FOUND:
            share = middle
        else:
            more = middle
    return share if share > _NO_SHARE else None


class Search:
    """Iterative search for least-power variables that meet a goal.

    Every step goes towards the least-power variables of the demand linearised about the present ones. The result is a
    local optimum. Infeasible states where the search ended, which is no proof that no currents exist.

    Parameters
    ----------
    first
        Variables (n,) at which the search begins.
    scale
        Typical sizes (n,) of the variables.
    met
        Share of the demand that may be missing.
    saving
        Share of the power; the search ends if a step would save less.
    remedy
        Remedy in the error if the search fails.
    """

    def __init__(
        self,
        goal: Goal,
        first: Array,
        scale: Array,
        met: float,
        saving: float,
        remedy: str,
    ) -> None:
        self.goal, self.demand, self.variables = goal, goal.demand, goal.variables
        self.first, self.met, self.saving, self.remedy = first, met, saving, remedy
        self.nearly = False
        given, slope = goal.about(first)
        typical = np.maximum(
            np.maximum(np.abs(first), np.abs(self._shortest_change(given, slope))), 0.1 * scale
        )
        # Scale of a component: its demanded value, or its value for typical variables.
        self.size = np.maximum(np.abs(slope) @ typical, np.maximum(np.abs(self.demand.values), 1e-300))
        self.size = np.maximum(self.size, _FAINT * goal.undirected())
        # The merit of variables is their power plus this price times the missing share of the demand.
        self.price = 10.0 * self.variables.power(typical)

    def run(self) -> Array:
        """Take steps until the demand is met and no power can be saved. Every step lowers the merit.

        Raises
        ------
        Infeasible
            If no step comes nearer to the demand.
        NotConverged
            If the search does not end within a hundred steps or the evaluations of the field of the call.
        """
        try:
            return self._search()
        except Infeasible:
            # The strongest combinations of components alone are often near enough; weak ones can mislead the search.
            if self.nearly or _nearly(self.goal, *self._missing(self.first)) is None:
                raise
            self._settle_for_nearly()
            return self._search()

    def _search(self) -> Array:
        values, power = self.first, self.variables.power
        off = self._off(values)
        before: list[float] = []
        for _ in range(_MOST_STEPS):
            if self.goal.evaluations >= MOST_EVALUATIONS:
                break
            before = [*before, off][-_PATIENCE:]
            if len(before) == _PATIENCE and min(before) > max(_FAR, 0.9 * max(before)):
                raise self._stuck(values)
            aim, left = self._aim(values, off)
            dearer = power(aim) - power(values)
            if off > self.met and self.price * (off - left) < 2.0 * dearer:
                # Otherwise the cost of a step would outweigh its gain in the demand.
                self.price = 2.0 * dearer / (off - left)
            promised = self.price * (off - left) - dearer
            if off <= self.met and promised <= self.saving * power(values):
                return values
            following = self._step(values, aim, off, promised)
            if following is None:
                if off <= self.met:
                    return values
                raise self._stuck(values)
            values, off = following
        met = self._met(values)
        if met is not None:
            return met
        must_hold = f"an end within {_MOST_STEPS} steps and {MOST_EVALUATIONS} evaluations of the field"
        received = f"{self._off(values):.1e} of the demand left"
        raise NotConverged.of("currents_for", must_hold, received, self.remedy)

    def left_by(self, error: Infeasible | NotConverged) -> float:
        """Distance from the demand at the end of a failed search."""
        reached = error.reachable if isinstance(error, Infeasible) else None
        return math.inf if reached is None else float(np.linalg.norm(reached - self.demand.values))

    def _aim(self, values: Array, off: float) -> tuple[Array, float]:
        """Least-power variables of the demand linearised about `values`, and the share of the demand that they miss. If
        limits exclude the demand, only a half, a quarter, ... of the missing part is demanded."""
        slope, wanted = self._missing(values)
        here, given = slope @ values, self.goal.about(values)[0]
        share = 1.0
        while share >= _NO_PROGRESS:
            status, found, active = self.variables.least_power(slope, here + share * (wanted - here))
            if status == FOUND and not self.nearly:
                return found, (1.0 - share) * off
            nearly = _nearly(self.goal, slope, wanted) if status == OUT_OF_RANGE or self.nearly else None
            if nearly is not None:
                self._settle_for_nearly()
                return nearly, 0.0
            if status == FOUND:
                return found, (1.0 - share) * off
            if status != BEYOND_LIMITS:
                raise _refusal(self.goal, status, active, slope, given)
            share *= 0.5
        raise self._stuck(values)

    def _missing(self, values: Array) -> tuple[Array, Array]:
        """Matrix (r, n) of the goal linearised about values, and its right-hand side (r,)."""
        given, slope = self.goal.about(values)
        return slope, slope @ values + self.demand.values - given

    def _settle_for_nearly(self) -> None:
        """From now on the scale of a component is the largest one of its unit, and an error of _NEARLY is accepted."""
        self.nearly, self.met, self.size = True, max(self.met, _NEARLY), _of_unit(self.demand, self.size)

    def _step(self, values: Array, aim: Array, off: float, promised: float) -> tuple[Array, float] | None:
        """Step towards the aim, halved until it lowers the merit by a tenth of the predicted decrease, and the missing
        share of the demand there; None if no step does."""
        power, share = self.variables.power, 1.0
        while share >= _NO_PROGRESS:
            trial = values + share * (aim - values)
            off_trial = self._off(trial)
            gained = power(values) - power(trial) + self.price * (off - off_trial)
            if gained >= 0.1 * share * promised:
                return trial, off_trial
            share *= 0.5
        return None

    def _met(self, values: Array) -> Array | None:
        """Variables that meet the demand, by least changes of `values`, which nearly meet it; None if there are none.
        Sharply saturating iron lets ever smaller steps save power, each of which misses a little of the demand."""
        of = self.variables
        for _ in range(_MOST_CHANGES):
            if self._off(values) <= self.met:
                return values
            given, slope = self.goal.about(values)
            changes = replace(of, low=of.low - values, high=of.high - values)
            status, change, _ = changes.least_power(slope, self.demand.values - given)
            if status != FOUND:
                return None
            values = of.within(values + change)
        return None

    def _shortest_change(self, given: Array, slope: Array) -> Array:
        """The shortest change of the variables that gives the missing part of the demand, to first order."""
        length = np.linalg.norm(slope, axis=1)
        length = np.where(length > 0.0, length, 1.0)
        missing = (self.demand.values - given) / length
        return np.asarray(np.linalg.lstsq(slope / length[:, None], missing, rcond=1e-3)[0], float)

    def _off(self, values: Array) -> float:
        """Largest missing share of a component of the demand, beyond rounding."""
        missed = np.abs(self.goal.about(values)[0] - self.demand.values) / self.size
        return max(float(missed.max()) - _ROUNDING_OF_MODELS, 0.0)

    def _stuck(self, values: Array) -> Infeasible:
        reached, of = self.goal.about(values)[0], self.variables
        # The search takes no steps shorter than this margin.
        between, most = of.high - of.low, np.abs(values).max(initial=1e-12)
        margin = _NO_PROGRESS * np.where(np.isfinite(between), between, most)
        at_limit = (values <= of.low + margin) | (values >= of.high - margin)
        binding, limits = _binding(of, values, at_limit)
        must_hold = (
            f"a demand that the search can reach; where it ended these limits bind: {limits or 'none'}"
        )
        remedy = f"reached: {self.demand.text(reached)}; {self.remedy}"
        return self.demand.infeasible(must_hold, remedy, reachable=reached, binding=binding)
