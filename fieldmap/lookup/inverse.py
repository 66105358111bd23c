"""The inverse of a field: currents of least power that meet a demand at a place. docs/theory/actuation.md (5), (8).

    min sum_k R_k I_k^2   with   rows(field(I)) = demand,   currents within their limits

All cases are this one problem. They differ in how the field follows the currents (`fieldmap.lookup.inverse_fields`), in
the rows (`Demand`, of a dipole or a body), in what may change (`Variables`: the currents, or the signals of a
parametrisation), and in where a search begins. A linear problem is solved at once.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import checked_vectors
from fieldmap.currents import TOLERANCE, IndependentCurrents
from fieldmap.errors import Infeasible, InputError, NotConverged
from fieldmap.field import coil_currents
from fieldmap.lookup.actuation import Limits, checked_limits
from fieldmap.lookup.demand import Demand
from fieldmap.lookup.inverse_fields import SolvedField, SumOfFields
from fieldmap.lookup.inverse_goal import Goal, Variables
from fieldmap.lookup.inverse_search import Search, linear_currents
from fieldmap.lookup.inverse_starts import starts_on_soft_iron
from fieldmap.lookup.magnetic_body import checked_turns
from fieldmap.store import ReducedModel
from fieldmap.typing import Array

_SAVING_ON_SOFT_IRON = 1e-7
_UPRIGHT = np.eye(3)


def least_power_currents(
    field: SumOfFields | SolvedField,
    position: ArrayLike,
    demand: Demand,
    limits: Limits,
    resistance: ArrayLike | None,
    start: ArrayLike | None,
    orientation: ArrayLike | None,
) -> Array:
    """Currents (n_coils,), A, of least power that meet a demand on a dipole or a body at a position (3,), m.

    Parameters
    ----------
    limits, resistance, start, orientation
        As in `FieldMap.currents_for`.

    Raises
    ------
    Infeasible, OutsideMapError, InputError, NotConverged
        As `FieldMap.currents_for`.
    """
    names = field.coil_names
    weight = _checked_weight(resistance, len(names))
    points, single = checked_vectors("position", position)
    if not single:
        received = f"shape {points.shape}"
        raise InputError.of("currents_for, position", "three numbers", received, "ask place by place")
    turn = _UPRIGHT
    if demand.body is not None:
        turn = checked_turns(orientation, 1)[0]
        points = np.concatenate([points, points + demand.body.all_points @ turn.T])
    low, high = checked_limits(limits, len(names))
    first = None if start is None else coil_currents(start, names)
    goal = Goal(demand, field.at(points), turn, Variables(names, low, high, weight))
    model = field.iron.model if isinstance(field, SumOfFields) and field.iron is not None else None
    if isinstance(field, SumOfFields) and model is None and not demand.on_soft_iron:
        return linear_currents(goal)
    if first is None and isinstance(field, SolvedField):
        first = np.clip(np.zeros(len(names)), low, high)
        if demand.on_soft_iron:
            # About no currents the force on soft iron has no derivative: the search begins where linear iron has it.
            linear = field.linear_about(first)
            first = least_power_currents(linear, position, demand, limits, resistance, None, orientation)
    goal.variables = _variables(goal.variables, model, first)
    scale = _scale(goal.variables, model, first)
    saving = max(field.saving, _SAVING_ON_SOFT_IRON) if demand.on_soft_iron else field.saving
    remedy = _REMEDY if start is None else _REMEDY_OF_START
    searches = [
        Search(goal, begin, scale, field.met, saving, remedy)
        for begin in _starts(goal, model, first, float(scale.max()))
    ]
    found = best_of(searches)
    currents = goal.variables.currents(found)
    over = np.maximum(low - currents, currents - high)
    made = goal.variables.made
    if made is not None and not (
        made.excess(found) <= TOLERANCE and over.max() <= TOLERANCE * np.abs(currents).max()
    ):
        most = int(np.argmax(over if over.max() > 0.0 else np.abs(currents)))
        note = f", which takes {currents[most]:.6g} A in coil {names[most]}"
        raise demand.infeasible("a demand within the limits of the currents", remedy, note)
    return currents


_REMEDY = "ask for less, or widen the limits (in Python start= begins at currents of your own)"
_REMEDY_OF_START = "ask for less, widen the limits, or move start"


def _checked_weight(resistance: ArrayLike | None, n_coils: int) -> Array:
    """Weights (n_coils,) of the squared currents. Raises InputError."""
    if resistance is None:
        return np.ones(n_coils)
    try:
        weight = np.array(np.broadcast_to(np.asarray(resistance, dtype=np.float64), n_coils))
    except (TypeError, ValueError):
        weight = np.empty(0)
    if not (weight.size and np.isfinite(weight).all() and (weight > 0).all()):
        must_hold, received = f"a positive number, or {n_coils} of them", repr(resistance)[:80]
        raise InputError.of("currents_for, resistance", must_hold, received, "give ohms, or nothing")
    return weight


def _variables(of_coils: Variables, model: ReducedModel | None, first: Array | None) -> Variables:
    """Currents within those that a map of saturating iron was made for, or the signals of its parametrisation.

    Each signal has the power that it costs where the search begins: the power of the currents where each follows one
    signal.
    """
    if model is None:
        return of_coils
    made, lower, upper = model.parametrisation, np.array(model.lower), np.array(model.upper)
    if isinstance(made, IndependentCurrents):
        return replace(of_coils, low=np.maximum(of_coils.low, lower), high=np.minimum(of_coils.high, upper))
    begin = made.nearest(_middle(model) if first is None else first).values
    cost = of_coils.cost @ made.derivative(np.clip(begin, lower, upper)) ** 2
    cost = np.maximum(cost, 1e-6 * cost.max())
    return Variables(made.signal_names, lower, upper, cost, made, "signal", "")


def _middle(model: ReducedModel) -> Array:
    """Currents (n_coils,), A, in the middle of the states that a model was trained on."""
    return np.asarray(model.known_currents.mean(axis=0))


def _scale(variables: Variables, model: ReducedModel | None, first: Array | None) -> Array:
    """Variables (n,) of the usual size: those of a model's training, of the start or of the limits, or 1."""
    if model is not None:
        return np.maximum(np.abs(variables.nearest(model.known_currents)).max(axis=0), 1e-12)
    limits = np.concatenate([variables.low, variables.high])
    sizes = [] if first is None else [np.abs(first).max()]
    sizes.append(np.abs(limits[np.isfinite(limits)]).max(initial=0.0))
    return np.full(len(variables.low), next((size for size in sizes if size > 0.0), 1.0))


def _starts(goal: Goal, model: ReducedModel | None, first: Array | None, scale: float) -> list[Array]:
    """Variables (n,) at which searches begin: those of the currents `first`, or several."""
    of = goal.variables
    starts: list[Array] = []
    if first is None and of.made is None and goal.demand.on_soft_iron:
        starts += starts_on_soft_iron(goal, scale)
    begin = _middle(model) if first is None and model is not None else first
    if begin is not None:
        starts.append(of.within(of.nearest(begin)))
    # Where there is no start, currents of zero say why nothing can be had.
    return starts or [of.within(np.zeros(len(of.cost)))]


def best_of(searches: list[Search]) -> Array:
    """The end (n,) of least power. Raises the error of the search that left least of the demand, where all failed."""
    found, refused = [], []
    for search in searches:
        try:
            found.append(search.run())
        except (Infeasible, NotConverged) as error:
            refused.append(error)
    if not found:
        raise min(refused, key=searches[0].left_by)
    return min(found, key=searches[0].variables.power)
