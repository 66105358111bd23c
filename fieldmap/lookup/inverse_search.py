"""Currents of least power that meet a demand: of a linear one at once, of another from step to step.

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
_FAINT = 1e-6  # a row is judged by no less than this share of what it would be of the whole field
_ROUNDING_OF_MODELS = 1e-12
_HALVINGS = 50
_NO_SHARE = 1e-9
# Of components of one unit, the share of the largest that no currents need meet, and the share of the strongest
# combination of components below which currents command one only where the others do not do. In a place of symmetry
# more may be asked for than there are coils, and the mesh of the iron is less symmetric than its machine.
_NEARLY, _COMMANDED = 1e-4, 1e-3
_MOST_STEPS, _MOST_CHANGES = 100, 10
MOST_EVALUATIONS = 500
"""Of the field at new values, in all searches of one call: the last one begun ends there."""
_NO_PROGRESS = 1e-4  # a share of the step below which the search gives up
# A search that has left more than this share of the demand gives up where so many steps have changed it by no more than
# a tenth: at limits it creeps towards the nearest that can be had.
_FAR, _PATIENCE = 1e-2, 10


def linear_currents(goal: Goal) -> Array:
    """Least-power currents (n,), A, that meet a linear goal. Raises Infeasible."""
    constant, matrix = goal.about(np.zeros(len(goal.variables.cost)))
    wanted = goal.demand.values - constant
    # A demand that the constant meets by itself asks for no currents, not for those of rounding.
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
    """For each component (r,) the largest of the sizes (r,) of those of its unit."""
    units = np.array([name[0] for name in demand.names])
    return np.array([sizes[units == unit].max() for unit in units])


def _nearly(goal: Goal, matrix: Array, wanted: Array) -> Array | None:
    """Least-power variables (n,) that give nearly what is wanted (r,), which none give exactly; None where none do."""
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
    """Those of the values (n,) which (n,) lie at limits, by name and as text."""
    chosen = np.flatnonzero(which)
    binding = {variables.names[k]: float(values[k]) for k in chosen}
    parts = [f"{variables.noun} {name} at {value:g}{variables.unit}" for name, value in binding.items()]
    return binding, ", ".join(parts)


def _reachable_share(matrix: Array, constant: Array, wanted: Array, variables: Variables) -> float | None:
    """Largest share of the demand that variables within the limits give; None if there is none.

    The largest t with matrix @ i + constant = t wanted for i within the limits. Such t are an interval. One of them
    comes from currents that may leave the share 1 - t of the demand to one more column; halving what lies between it
    and 1 finds the end.
    """
    low, high = np.append(variables.low, 0.0), np.append(variables.high, 1.0)
    ends = np.abs(np.concatenate([variables.low, variables.high]))
    # What is left of the demand costs as much as the largest limit, so that both are of one size.
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
    """Least-power variables that meet a goal, from step to step.

    Every step takes the demand as linear about the present variables and finds the least-power variables of that. The
    end is a local optimum. Infeasible says where the search ended: no proof that no currents exist.

    Parameters
    ----------
    first
        (n,), where the search begins.
    scale
        (n,), variables of the usual size.
    met
        Share of the demand that may be left.
    saving
        Share of the power below which more of it is not looked for.
    remedy
        What to try where the search fails.
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
        # What is missing of a row is judged by what is asked of it, or what typical variables give of it.
        self.size = np.maximum(np.abs(slope) @ typical, np.maximum(np.abs(self.demand.values), 1e-300))
        self.size = np.maximum(self.size, _FAINT * goal.undirected())
        # The merit of variables: their power, and this price for what they miss of the demand.
        self.price = 10.0 * self.variables.power(typical)

    def run(self) -> Array:
        """Steps until the demand is met and no power can be saved along it; every step lowers the merit.

        Raises
        ------
        Infeasible
            Where no step brings the demand nearer.
        NotConverged
            Where there is no end within a hundred steps, or within the evaluations of the field that the call may take.
        """
        try:
            return self._search()
        except Infeasible:
            # What the strongest combinations alone give is often near enough, where weak ones lead astray.
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
                # Otherwise what a step costs would stand against what it brings of the demand.
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
        """How much of the demand a search that failed has left."""
        reached = error.reachable if isinstance(error, Infeasible) else None
        return math.inf if reached is None else float(np.linalg.norm(reached - self.demand.values))

    def _aim(self, values: Array, off: float) -> tuple[Array, float]:
        """Least-power variables of the demand made linear about `values`, or of the half, quarter, ... of what is
        missing of it where limits bind; and how much is left then."""
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
        """Matrix (r, n) of the goal about values, and what it must give of variables (r,)."""
        given, slope = self.goal.about(values)
        return slope, slope @ values + self.demand.values - given

    def _settle_for_nearly(self) -> None:
        """What is left of a component is judged by the largest of its unit from here on."""
        self.nearly, self.met, self.size = True, max(self.met, _NEARLY), _of_unit(self.demand, self.size)

    def _step(self, values: Array, aim: Array, off: float, promised: float) -> tuple[Array, float] | None:
        """Towards the aim as far as that lowers the merit by a tenth of what it promises, and how far the demand is
        missed there; None if it does not."""
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
        """Variables that meet the demand by the least changes of these, which nearly do: where iron saturates sharply,
        power can be saved in ever smaller steps, and each leaves a little of the demand. None if they do not exist."""
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
        """The shortest change of the variables that gives what is missing of the demand, to first order."""
        length = np.linalg.norm(slope, axis=1)
        length = np.where(length > 0.0, length, 1.0)
        missing = (self.demand.values - given) / length
        return np.asarray(np.linalg.lstsq(slope / length[:, None], missing, rcond=1e-3)[0], float)

    def _off(self, values: Array) -> float:
        """How far the demand is missed, beyond rounding."""
        missed = np.abs(self.goal.about(values)[0] - self.demand.values) / self.size
        return max(float(missed.max()) - _ROUNDING_OF_MODELS, 0.0)

    def _stuck(self, values: Array) -> Infeasible:
        reached, of = self.goal.about(values)[0], self.variables
        # The search ends before steps that are that short.
        between, most = of.high - of.low, np.abs(values).max(initial=1e-12)
        margin = _NO_PROGRESS * np.where(np.isfinite(between), between, most)
        at_limit = (values <= of.low + margin) | (values >= of.high - margin)
        binding, limits = _binding(of, values, at_limit)
        must_hold = (
            f"a demand that the search can reach; where it ended these limits bind: {limits or 'none'}"
        )
        remedy = f"reached: {self.demand.text(reached)}; {self.remedy}"
        return self.demand.infeasible(must_hold, remedy, reachable=reached, binding=binding)
