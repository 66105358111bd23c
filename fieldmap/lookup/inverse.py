"""What is asked of the currents at a place, as rows on flux density and gradient."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.arguments import checked_vectors, remedy_of_moment
from fieldmap.core.least_power import BEYOND_LIMITS, FOUND, NO_END, OUT_OF_RANGE, least_power
from fieldmap.currents import TOLERANCE, CurrentParametrisation, IndependentCurrents
from fieldmap.errors import FieldmapError, Infeasible, InputError, NotConverged, OutsideMapError, Problem
from fieldmap.field import coil_currents
from fieldmap.lookup.actuation import (
    FIELD_ROWS,
    FORCE_ROWS,
    GRADIENT_ROWS,
    TORQUE_ROWS,
    Limits,
    checked_limits,
)
from fieldmap.lookup.current_model import CurrentModel, CurrentSearch
from fieldmap.records import Record
from fieldmap.typing import Array

_UNITS = {"F": "N", "T": "N m", "B": "T", "d": "T/m"}


@dataclass(frozen=True, eq=False, repr=False)
class Demand(Record):
    """selection (r, 12) @ (B, gradient row by row) must be values (r,); names of the rows."""

    names: tuple[str, ...]
    selection: Array
    values: Array

    def text(self, values: Array) -> str:
        """Values with names and units, zeros left out."""
        size = np.abs(values).max(initial=0.0)
        parts = [
            f"{name} = {value:.6g} {_UNITS[name[0]]}"
            for name, value in zip(self.names, values, strict=True)
            if abs(value) > 1e-9 * size
        ]
        return ", ".join(parts) or "zero"


def demand_of(
    force: ArrayLike | None,
    moment: ArrayLike | None,
    torque: ArrayLike | None,
    field: ArrayLike | None,
    gradient: ArrayLike | None,
) -> Demand:
    """Rows of all that is asked for at once; NaN leaves a component free.

    Raises InputError if nothing is asked for, or a shape does not fit.
    """
    names: tuple[str, ...] = ()
    parts, values = [], []
    if force is not None or torque is not None:
        if moment is None:
            raise _wrong("moment", "of the dipole on which force and torque act", None)
        mx, my, mz = _moment(moment)
        if mx == my == mz == 0.0:
            raise _wrong("moment", "not zero: no field gives force or torque on it", moment)
    if force is not None:
        names, rows = names + FORCE_ROWS, np.zeros((3, 12))
        for j in range(3):
            rows[j, 3 + j], rows[j, 6 + j], rows[j, 9 + j] = mx, my, mz
        parts.append(rows)
        values.append(_vector("force", force, (3,)))
    if torque is not None:
        names, rows = names + TORQUE_ROWS, np.zeros((3, 12))
        rows[0, 1], rows[0, 2], rows[1, 0], rows[1, 2], rows[2, 0], rows[2, 1] = -mz, my, mz, -mx, -my, mx
        parts.append(rows)
        values.append(_vector("torque", torque, (3,)))
    if field is not None:
        names += FIELD_ROWS
        parts.append(np.eye(3, 12))
        values.append(_vector("field", field, (3,)))
    if gradient is not None:
        names += GRADIENT_ROWS
        parts.append(np.eye(12)[[3, 4, 5, 7, 8]])
        values.append(_vector("gradient", gradient, (3, 3))[[0, 0, 0, 1, 1], [0, 1, 2, 1, 2]])
    if not parts:
        raise _wrong("demand", "force, torque, field or gradient", None)
    selection, wanted = (
        (parts[0], values[0]) if len(parts) == 1 else (np.concatenate(parts), np.concatenate(values))
    )
    asked = wanted == wanted
    if asked.all():
        return Demand(names, selection, wanted)
    if not asked.any():
        raise _wrong("demand", "at least one component that is not NaN", None)
    kept = tuple(name for name, is_asked in zip(names, asked, strict=True) if is_asked)
    return Demand(kept, np.ascontiguousarray(selection[asked]), wanted[asked])


def _moment(values: ArrayLike) -> Array:
    moment = _vector("moment", values, (3,))
    if np.isnan(moment).any():
        raise _wrong("moment", "finite numbers of shape (3,)", values)
    return moment


def _vector(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Array:
    try:
        array = np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != shape or np.isinf(array).any():
        raise _wrong(name, f"numbers of shape {shape}, none infinite", values)
    return array


def _wrong(name: str, must_hold: str, received: object) -> InputError:
    remedy = remedy_of_moment(received, "give arrays in SI units")
    return InputError(Problem(f"currents_for, {name}", must_hold, repr(received)[:80], remedy))


def currents_of_sum(
    evaluator: FieldsOfMap,
    coil_names: tuple[str, ...],
    position: ArrayLike,
    demand: Demand,
    limits: Limits,
    weight: Array,
    constant: bool = False,
) -> Array:
    """Currents (n_coils,), A, from the fields of a map's coils; arguments as in `FieldMap.currents_for`.

    constant: the map has one more field, that no current drives; the currents give what it leaves of the demand.
    """
    n = len(coil_names)
    matrix, given = rows_at(evaluator, position, demand, n + constant), None
    wanted = demand.values
    if constant:
        given = np.ascontiguousarray(matrix[:, n])
        matrix, wanted = np.ascontiguousarray(matrix[:, :n]), wanted - given
        # A demand that the constant field meets by itself asks for no currents, not for those of rounding.
        wanted[np.abs(wanted) <= _ROUNDING * np.abs(given)] = 0.0
    low, high = checked_limits(limits, n)
    currents, active = np.empty(n), np.empty(n, np.int64)
    status = least_power(matrix, wanted, low, high, weight, currents, active)
    if status != FOUND:
        raise refusal(status, matrix, demand, low, high, active, coil_names, given)
    return currents


_ROUNDING = 1e-13


def rows_at(evaluator: FieldsOfMap, position: ArrayLike, demand: Demand, n_fields: int) -> Array:
    """What each field of a map at weight 1 gives of the demand at a position, (rows, n_fields)."""
    where, single = checked_vectors("position", position)
    flux, slope = np.empty((1, n_fields, 3)), np.empty((1, n_fields, 3, 3))
    if not single:
        received = f"shape {where.shape}"
        raise InputError(Problem("currents_for, position", "three numbers", received, "ask place by place"))
    evaluator.each_field(where, flux, slope)
    if not math.isfinite(flux[0, 0, 0]):
        raise _no_place(where[0])
    selection = demand.selection
    matrix = selection[:, :3] @ flux[0].T
    matrix += selection[:, 3:] @ slope.reshape(n_fields, 9).T
    return matrix


def checked_weight(resistance: ArrayLike | None, n_coils: int) -> Array:
    """Weights (n_coils,) of the squared currents. Raises InputError."""
    if resistance is None:
        return np.ones(n_coils)
    try:
        weight = np.array(np.broadcast_to(np.asarray(resistance, dtype=np.float64), n_coils))
    except (TypeError, ValueError):
        weight = np.empty(0)
    if not (weight.size and np.isfinite(weight).all() and (weight > 0).all()):
        must_hold, received = f"a positive number, or {n_coils} of them", repr(resistance)[:80]
        raise InputError(Problem("currents_for, resistance", must_hold, received, "give ohms, or nothing"))
    return weight


def refusal(
    status: int,
    matrix: Array,
    demand: Demand,
    low: Array,
    high: Array,
    active: NDArray[np.int64],
    names: tuple[str, ...],
    given: Array | None = None,
) -> FieldmapError:
    """The error for a demand that was not met: which limits bind, and what can be had. given (rows,): what is there
    without currents."""
    constant = np.zeros(len(matrix)) if given is None else given
    if status == NO_END:
        what = "the active-set method must end"
        return NotConverged(Problem("currents_for", what, demand.text(demand.values), "report this case"))
    received = demand.text(demand.values)
    if status == OUT_OF_RANGE:
        nearest = matrix @ np.linalg.lstsq(matrix, demand.values - constant, rcond=1e-11)[0] + constant
        must_hold = "some currents must meet the demand, without any limits"
        remedy = f"the nearest values that currents reach: {demand.text(nearest)}"
        return Infeasible(Problem("currents_for", must_hold, received, remedy), reachable=nearest)
    ends = np.where(active > 0, high, low)
    binding = {names[k]: float(ends[k]) for k in np.flatnonzero(active)}
    limits = ", ".join(f"coil {name} at {value:g} A" for name, value in binding.items())
    must_hold = f"the demand must be within the limits of the currents; these limits exclude it: {limits}"
    part = reachable_share(matrix, demand.values, low, high, constant)
    if part is None:
        problem = Problem("currents_for", must_hold, received, "the limits allow no share of the demand")
        return Infeasible(problem, binding=binding)
    remedy = f"the limits allow {part[0]:.6g} of the demand: {demand.text(part[1])}"
    problem = Problem("currents_for", must_hold, received, remedy)
    return Infeasible(problem, reachable=part[1], share=part[0], binding=binding)


def reachable_share(
    matrix: Array, wanted: Array, low: Array, high: Array, constant: Array
) -> tuple[float, Array] | None:
    """Largest share of the demand that currents within the limits give, and what it is; None if there is none.

    The largest t with A i + c = t b for currents i within the limits; c (rows,): what is there without currents. Such
    t are an interval. One of them comes from currents that may leave the share 1 - t of the demand to one more column,
    b; halving what lies between it and 1 finds the end.
    """
    n = matrix.shape[1]
    currents, active = np.empty(n + 1), np.empty(n + 1, np.int64)
    ends = np.abs(np.concatenate([low, high]))
    widest = max(float(ends[np.isfinite(ends)].max(initial=0.0)), 1e-300)
    beside = np.ascontiguousarray(np.hstack([matrix, wanted[:, None]]))
    about = np.append(low, 0.0), np.append(high, 1.0), np.append(np.ones(n), widest**2)
    if least_power(beside, wanted - constant, *about, currents, active) != FOUND:
        return None
    share, more = 1.0 - float(currents[n]), 1.0
    currents, active, weight = np.empty(n), np.empty(n, np.int64), np.ones(n)
    for _ in range(_HALVINGS):
        middle = 0.5 * (share + more)
        found = least_power(matrix, middle * wanted - constant, low, high, weight, currents, active) == FOUND
        share, more = (middle, more) if found else (share, middle)
    return (share, share * wanted) if share > _NO_SHARE else None


_HALVINGS = 50
_NO_SHARE = 1e-9


def _no_place(position: Array) -> OutsideMapError:
    where = tuple(round(float(x) * 1e3, 6) for x in position)
    return OutsideMapError(
        Problem("currents_for, position", "a place in the map's box", f"{where} mm", "stay in the box")
    )


_MOST_STEPS, _MOST_CHANGES = 100, 10
_TOLERANCE = 1e-9  # of the demand, row by row in units of what a typical current gives
_NO_PROGRESS = 1e-4  # a share of the step below which the search gives up
_NO_SAVING = 1e-12  # of the power


def currents_of_model(
    evaluator: FieldsOfMap,
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
    at = rows_at(evaluator, position, demand, model.model.coil_count + model.fields_beside_coils)
    typical, first = typical_currents(model), first_currents(model, coil_names, start)
    low, high = limits_of(model, limits)
    near = np.clip(0.0, low, high) if is_free(model) else first_currents(model, coil_names, None)
    unsaturated = at @ model.slopes_at(near)
    size = np.maximum(np.abs(unsaturated) @ typical, 1e-300)
    goal = _OnDipole(demand, size, at, model.search())
    remedy = remedy_of_start(start is not None)
    if not is_free(model):
        return currents_of_signals(goal, model, coil_names, limits, weight, first, remedy)
    run = Search(goal, coil_names, low, high, weight, typical, remedy=remedy)
    return run.run(np.clip(first, low, high))


def currents_of_signals(
    goal: Goal,
    model: CurrentModel,
    names: tuple[str, ...],
    limits: Limits,
    weight: Array,
    first: Array,
    remedy: str,
    saving: float = _NO_SAVING,
) -> Array:
    """Currents (n_coils,), A, that meet a goal by the signals of a map's parametrisation, within their ranges.

    What is least is the power of the signals, each at what it costs at `first` (n_coils,), A, where the search begins:
    the power of the currents where each follows one signal. Raises Infeasible, also where the currents that are found
    are beyond the limits or the domain.
    """
    # Copies, as in `checked_limits`: those of a model may not be written to.
    made, lower, upper = model.model.parametrisation, np.array(model.model.lower), np.array(model.model.upper)
    begin = np.clip(made.nearest(first).values, lower, upper)
    typical = np.maximum(np.abs(made.nearest(model.model.known_currents).values).max(axis=0), 1e-12)
    cost = weight @ made.derivative(begin) ** 2
    cost = np.maximum(cost, 1e-6 * cost.max())
    about = (made.signal_names, lower, upper, cost, typical, saving, remedy, "signal", "")
    signals = Search(_BySignals(goal, made), *about).run(begin)
    currents = np.ascontiguousarray(made.currents(signals))
    low, high = limits_of(model, limits)
    over = np.maximum(low - currents, currents - high)
    if made.excess(signals) <= TOLERANCE and over.max() <= TOLERANCE * np.abs(currents).max():
        return currents
    most = int(np.argmax(over if over.max() > 0.0 else np.abs(currents)))
    must_hold = "a demand within the limits of the currents"
    received = (
        f"{goal.demand.text(goal.demand.values)}, which takes {currents[most]:.6g} A in coil {names[most]}"
    )
    raise Infeasible(Problem("currents_for", must_hold, received, remedy))


def remedy_of_start(given: bool) -> str:
    """What to try where a search fails: from another start, if one was given, or from one at all."""
    if given:
        return "ask for less, widen the limits, or move start"
    return "ask for less, or widen the limits (in Python start= begins at currents of your own)"


class FieldsOfMap(Protocol):
    """What an inverse is made of: `Evaluator`, or the coils of a device."""

    def each_field(self, points: Array, flux: Array, slope: Array) -> Any:
        """Fill flux (n, fields, 3), T, and slope (n, fields, 3, 3), T/m, of every field at weight 1."""


class Goal(Protocol):
    """What is asked of the currents, and what they give of it."""

    @property
    def demand(self) -> Demand:
        """Names and values of its rows; the selection is not used."""

    @property
    def size(self) -> Array:
        """Of each row (r,): what is missing is judged by it."""

    def given(self, currents: Array) -> Array:
        """What currents (n_coils,) give (r,)."""

    def slope(self, currents: Array) -> Array:
        """Its derivative (r, n_coils) by the currents."""


@dataclass(frozen=True, eq=False)
class _OnDipole:
    """Rows on flux density and gradient, that saturating iron gives: at (r, fields)."""

    demand: Demand
    size: Array
    at: Array
    model: CurrentSearch

    def given(self, currents: Array) -> Array:
        return np.asarray(self.at @ self.model.weights(currents))

    def slope(self, currents: Array) -> Array:
        return np.ascontiguousarray(self.at @ self.model.slopes(currents))


@dataclass(frozen=True, eq=False)
class _BySignals:
    """A goal of the signals of a parametrisation, in the place of the currents."""

    goal: Goal
    made: CurrentParametrisation

    @property
    def demand(self) -> Demand:
        return self.goal.demand

    @property
    def size(self) -> Array:
        return self.goal.size

    def given(self, signals: Array) -> Array:
        return self.goal.given(np.ascontiguousarray(self.made.currents(signals)))

    def slope(self, signals: Array) -> Array:
        by_currents = self.goal.slope(np.ascontiguousarray(self.made.currents(signals)))
        return np.ascontiguousarray(by_currents @ self.made.derivative(signals))


class Search:
    """Least-power currents that meet a goal, from currents to currents. typical (n_coils,), A: currents whose power is
    worth a tenth of the goal. saving: share of the power below which more of it is not looked for. remedy: what to try
    where it fails. noun, unit: of what is searched for, in messages. met: share of the demand that may be left."""

    def __init__(
        self,
        goal: Goal,
        names: tuple[str, ...],
        low: Array,
        high: Array,
        weight: Array,
        typical: Array,
        saving: float = _NO_SAVING,
        remedy: str = "",
        noun: str = "coil",
        unit: str = " A",
        met: float = _TOLERANCE,
    ) -> None:
        self.goal, self.names, self.demand, self.size = goal, names, goal.demand, goal.size
        self.low, self.high, self.weight, self.saving = low, high, weight, saving
        self.remedy, self.noun, self.unit, self.met = remedy, noun, unit, met
        # The merit of currents: their power, and this price for what they miss of the demand.
        self.price = 10.0 * self._power(typical)

    def run(self, currents: Array) -> Array:
        """Steps until the demand is met and no power can be saved along it; every step lowers the merit."""
        off = self._off(currents)
        for _ in range(_MOST_STEPS):
            aim, left = self._aim(currents, off)
            dearer = self._power(aim) - self._power(currents)
            if off > self.met and self.price * (off - left) < 2.0 * dearer:
                # Otherwise what a step costs would stand against what it brings of the demand.
                self.price = 2.0 * dearer / (off - left)
            promised = self._power(currents) - self._power(aim) + self.price * (off - left)
            if off <= self.met and promised <= self.saving * self._power(currents):
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
                    if off <= self.met:
                        return currents
                    raise self._stuck(currents)
            currents, off = trial, off_trial
        met = self._met(currents)
        if met is not None:
            return met
        off = self._off(currents)
        must_hold = f"an end within {_MOST_STEPS} steps"
        raise NotConverged(Problem("currents_for", must_hold, f"{off:.1e} of the demand left", self.remedy))

    def _aim(self, currents: Array, off: float) -> tuple[Array, float]:
        """Least-power currents of the demand made linear about `currents`, or of the half, quarter, ... of what is
        missing of it where limits bind; and how much is left then."""
        slope = self.goal.slope(currents)
        here = slope @ currents
        missing = self.demand.values - self.goal.given(currents)
        found, active = np.empty(len(currents)), np.empty(len(currents), np.int64)
        share = 1.0
        while True:
            part = here + share * missing
            status = least_power(slope, part, self.low, self.high, self.weight, found, active)
            if status == FOUND:
                return found, (1.0 - share) * off
            if status != BEYOND_LIMITS:
                raise self._refused(status, slope, part, active)
            share *= 0.5
            if share < _NO_PROGRESS:
                raise self._stuck(currents)

    def _met(self, currents: Array) -> Array | None:
        """Currents that meet the demand by the least changes of these, which nearly do: where iron saturates sharply,
        power can be saved in ever smaller steps, and each leaves a little of the demand. None if they do not exist."""
        change, active = np.empty(len(currents)), np.empty(len(currents), np.int64)
        for _ in range(_MOST_CHANGES):
            if self._off(currents) <= self.met:
                return currents
            slope, missing = self.goal.slope(currents), self.demand.values - self.goal.given(currents)
            low, high = self.low - currents, self.high - currents
            if least_power(slope, missing, low, high, self.weight, change, active) != FOUND:
                return None
            currents = np.clip(currents + change, self.low, self.high)
        return None

    def _power(self, currents: Array) -> float:
        return float(self.weight @ currents**2)

    def _off(self, currents: Array) -> float:
        """How far the demand is missed."""
        return float((np.abs(self.goal.given(currents) - self.demand.values) / self.size).max())

    def _refused(self, status: int, slope: Array, rest: Array, active: NDArray[np.int64]) -> Exception:
        linear = Demand(self.demand.names, slope, rest)
        return refusal(status, slope, linear, self.low, self.high, active, self.names)

    def _stuck(self, currents: Array) -> Infeasible:
        reached = self.goal.given(currents)
        # The search ends before steps that are that short.
        between, most = self.high - self.low, np.abs(currents).max(initial=1e-12)
        margin = _NO_PROGRESS * np.where(np.isfinite(between), between, most)
        at_limit = np.flatnonzero((currents <= self.low + margin) | (currents >= self.high - margin))
        binding = {self.names[k]: float(currents[k]) for k in at_limit}
        limits = ", ".join(f"{self.noun} {name} at {value:g}{self.unit}" for name, value in binding.items())
        must_hold = (
            f"a demand that the search can reach; where it ended these limits bind: {limits or 'none'}"
        )
        received, remedy = (
            self.demand.text(self.demand.values),
            f"reached: {self.demand.text(reached)}; {self.remedy}",
        )
        problem = Problem("currents_for", must_hold, received, remedy)
        return Infeasible(problem, reachable=reached, binding=binding)


def typical_currents(model: CurrentModel) -> Array:
    """The largest currents (n_coils,), A, of the states that a model was trained on."""
    return np.maximum(np.abs(model.model.known_currents).max(axis=0), 1e-12)


def is_free(model: CurrentModel) -> bool:
    """Whether each coil of a map has a current of its own."""
    return isinstance(model.model.parametrisation, IndependentCurrents)


def limits_of(model: CurrentModel, limits: Limits) -> tuple[Array, Array]:
    """The limits (n_coils,), A, within the currents that the model was made for if these are free."""
    low, high = checked_limits(limits, model.model.coil_count)
    if not is_free(model):
        return low, high
    return np.maximum(low, model.model.lower), np.minimum(high, model.model.upper)


def first_currents(model: CurrentModel, names: tuple[str, ...], start: ArrayLike | None) -> Array:
    """Where a search begins: at `start`, or in the middle of the states that a model was trained on."""
    if start is None:
        return np.asarray(model.model.known_currents.mean(axis=0))
    return coil_currents(start, names)
