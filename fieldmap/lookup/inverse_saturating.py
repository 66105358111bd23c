"""Least-power currents where the iron saturates: Newton's method on the demand, a linear demand solved at each step."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.errors import Infeasible, InputError, NotConverged, Problem
from fieldmap.kernels.map import least_power as kernels
from fieldmap.lookup.actuation import Limits, checked_limits
from fieldmap.lookup.checks import checked_currents
from fieldmap.lookup.current_model import CurrentModel
from fieldmap.lookup.demand import Demand
from fieldmap.lookup.inverse_currents import refusal, rows_at
from fieldmap.typing import Array

_MOST_STEPS = 100
_TOLERANCE = 1e-9  # of the demand, row by row in units of what a typical current gives
_DIFFERENCE = 1e-4  # of the range of the currents, for the derivative of the model's weights
_NO_PROGRESS = 1e-4  # a share of the step below which the search gives up
_NO_SAVING = 1e-12  # of the power


def currents_of_model(
    block: Array,
    coil_names: tuple[str, ...],
    model: CurrentModel,
    position: ArrayLike,
    demand: Demand,
    limits: Limits,
    weight: Array,
    start: ArrayLike | None,
) -> Array:
    """Currents (n_coils,), A; arguments as in `FieldMap.currents_for`. Limits lie within the model's domain.

    Every step takes the demand as linear about the present currents and finds the least-power currents of that;
    where the step has converged, they are those of the demand itself (to first order: a local optimum). Raises
    Infeasible where no step brings the demand nearer: no proof that no currents exist, but of where the search ended.
    """
    low, high = _domain(model, limits)
    at = rows_at(block, position, demand, model.model.coil_count + model.model.field_count)
    search = _Search(model, coil_names, at, demand, low, high, weight)
    return search.run(_first(model, coil_names, start, low, high))


class _Search:
    """What stays the same from step to step."""

    def __init__(
        self,
        model: CurrentModel,
        names: tuple[str, ...],
        at: Array,
        demand: Demand,
        low: Array,
        high: Array,
        weight: Array,
    ) -> None:
        self.model, self.names, self.at, self.demand = model, names, at, demand
        self.low, self.high, self.weight = low, high, weight
        self.step = _DIFFERENCE * np.maximum(np.ptp(model.model.known_currents, axis=0), 1e-12)
        typical = np.maximum(np.abs(model.model.known_currents).max(axis=0), 1e-12)
        self.size = np.maximum(np.abs(self._slope(np.clip(0.0, low, high))) @ typical, 1e-300)
        # The merit of currents: their power, and this price for what they miss of the demand.
        self.price = 10.0 * self._power(typical)

    def run(self, currents: Array) -> Array:
        """Steps until the demand is met and no power can be saved along it; every step lowers the merit."""
        off = self._off(currents)
        for _ in range(_MOST_STEPS):
            aim, left = self._aim(currents, off)
            promised = self._power(currents) - self._power(aim) + self.price * (off - left)
            if off <= _TOLERANCE and promised <= _NO_SAVING * self._power(currents):
                return currents
            share = 1.0
            while True:
                trial = currents + share * (aim - currents)
                off_trial = self._off(trial)
                gained = self._power(currents) - self._power(trial) + self.price * (off - off_trial)
                if gained >= 0.1 * share * promised > 0.0:
                    break
                share *= 0.5
                if share < _NO_PROGRESS:
                    if off <= _TOLERANCE:
                        return currents
                    raise self._stuck(currents)
            currents, off = trial, off_trial
        if off <= _TOLERANCE:
            return currents
        must_hold = f"an end within {_MOST_STEPS} steps"
        raise NotConverged(Problem("currents_for", must_hold, f"{off:.1e} of the demand left", "move start"))

    def _aim(self, currents: Array, off: float) -> tuple[Array, float]:
        """Least-power currents of the demand made linear about `currents`, or of the half, quarter, ... of what is
        missing of it where limits bind; and how much is left then."""
        slope = self._slope(currents)
        here = slope @ currents
        missing = self.demand.values - self._given(currents)
        found, active = np.empty(len(currents)), np.empty(len(currents), np.int64)
        share = 1.0
        while True:
            part = here + share * missing
            status = kernels.least_power(slope, part, self.low, self.high, self.weight, found, active)
            if status == kernels.FOUND:
                return found, (1.0 - share) * off
            if status != kernels.BEYOND_LIMITS:
                raise self._refused(status, slope, part, active)
            share *= 0.5
            if share < _NO_PROGRESS:
                raise self._stuck(currents)

    def _power(self, currents: Array) -> float:
        return float(self.weight @ currents**2)

    def _slope(self, currents: Array) -> Array:
        """Derivative (r, n_coils) of what is given by the currents: central differences of the model's weights."""
        columns = []
        for k, step in enumerate(self.step):
            shift = step * np.eye(len(currents))[k]
            columns.append((self._given(currents + shift) - self._given(currents - shift)) / (2 * step))
        return np.ascontiguousarray(np.stack(columns, axis=1))

    def _given(self, currents: Array) -> Array:
        iron = self.model.model.output @ self.model.amplitudes(currents)
        return np.asarray(self.at @ np.concatenate([currents, iron]))

    def _off(self, currents: Array) -> float:
        """How far the demand is missed."""
        return float((np.abs(self._given(currents) - self.demand.values) / self.size).max())

    def _refused(self, status: int, slope: Array, rest: Array, active: NDArray[np.int64]) -> Exception:
        linear = Demand(self.demand.names, slope, rest)
        return refusal(status, slope, linear, self.low, self.high, active, self.names)

    def _stuck(self, currents: Array) -> Infeasible:
        reached = self._given(currents)
        margin = 1e-6 * np.abs(currents).max(initial=1e-12)
        at_limit = np.flatnonzero((currents <= self.low + margin) | (currents >= self.high - margin))
        binding = {self.names[k]: float(currents[k]) for k in at_limit}
        limits = ", ".join(f"coil {name} at {value:g} A" for name, value in binding.items()) or "none"
        must_hold = f"a demand that the search can reach; where it ended these limits bind: {limits}"
        received, remedy = (
            self.demand.text(self.demand.values),
            f"reached: {self.demand.text(reached)}; move start",
        )
        problem = Problem("currents_for", must_hold, received, remedy)
        return Infeasible(problem, reachable=reached, binding=binding)


def _domain(model: CurrentModel, limits: Limits) -> tuple[Array, Array]:
    """The limits, within the currents that the model was made for."""
    if model.model.division_exponent.size:
        must_hold = "a map made for free currents of its coils"
        received = "one made for divided currents (u, x, y)"
        raise InputError(Problem("currents_for", must_hold, received, "make a map with a box of currents"))
    low, high = checked_limits(limits, model.model.coil_count)
    return np.maximum(low, model.model.lower), np.minimum(high, model.model.upper)


def _first(
    model: CurrentModel, names: tuple[str, ...], start: ArrayLike | None, low: Array, high: Array
) -> Array:
    if start is None:
        return np.clip(model.model.known_currents.mean(axis=0), low, high)
    return np.clip(checked_currents(start, names, 0), low, high)
