"""The inverse of a field: currents of least power that meet a demand at a place. docs/theory/actuation.md (5)..(9).

    min sum_k R_k I_k^2   with   rows(field(I)) = demand,   currents within their limits

All cases are this one problem (`fieldmap.lookup.inverse_problem`). They differ in the field as a function of the
currents, in the rows (`Demand`, of a dipole or a body), in the `Variables` (the currents, or the signals of a
parametrisation), and in the start of a search. A linear problem needs no search.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import checked_vectors
from fieldmap.currents import TOLERANCE, IndependentCurrents
from fieldmap.errors import Infeasible, InputError, NotConverged
from fieldmap.field import AnyField, Field, as_field, coil_currents, require_affine
from fieldmap.lookup.actuation import Limits, checked_limits
from fieldmap.lookup.demand import Demand, demand_of
from fieldmap.lookup.inverse_problem import Goal, SolvedField, SumOfFields, Variables
from fieldmap.lookup.inverse_search import MOST_EVALUATIONS, Search, linear_currents
from fieldmap.lookup.magnetic_body import MagneticBody, checked_turns, loaded, reacting_at
from fieldmap.store import ReducedModel
from fieldmap.typing import Array

_SAVING_ON_SOFT_IRON = 1e-7
_UPRIGHT = np.eye(3)
_ROUNDING = 1e-9  # share of the sum of the coils' contributions below which a value is rounding
# Starts of searches for currents that pull soft iron.
_SMALL = 1e-3  # share of the typical currents at which soft iron is still linear
_NO_SLOPE = 1e-9  # share of the slope at typical currents below which a slope is rounding
_ASIDE = (0.0, 1.0, -1.0)  # multiples of the wanted force that are tried in each other row
# Strongest directions that are tried, and most changes of the length of a start.
_EIGENVECTORS = 2
_RESCALINGS = 12
# Consecutive searches without a better result, or without any, after which a call ends.
_ENOUGH, _HOPELESS = 2, 8
_BETTER = 1e-3  # share of the power that a better result saves at least


def currents_for(
    field: AnyField,
    position: ArrayLike,
    force: ArrayLike | None = None,
    moment: ArrayLike | MagneticBody | None = None,
    limits: Limits = None,
    *,
    torque: ArrayLike | None = None,
    flux_density: ArrayLike | None = None,
    gradient: ArrayLike | None = None,
    resistance: ArrayLike | None = None,
    start: ArrayLike | None = None,
    orientation: ArrayLike | None = None,
    direction: ArrayLike | None = None,
    least_field: float = 0.0,
) -> Array:
    """Currents of least power that meet a demand at a position, in a map or in a device without a map.

    For a device with saturating iron (`fieldmap.iron.NonlinearSolver`) the demand is met to 1e-5, and every step of the
    search takes one or a few solves.

    Parameters
    ----------
    field
        Map, solution, coils, or a field of your own.
    flux_density
        (3,), T; NaN leaves a component free.
    position, force, moment, limits, torque, gradient, resistance, start, orientation, direction, least_field
        As in `FieldMap.currents_for`.

    Returns
    -------
    Array
        Currents (n_coils,), A.

    Raises
    ------
    InputError
        For a field that neither superposes nor has derivatives by its currents, and as `FieldMap.currents_for`.
    Infeasible, OutsideMapError, NotConverged
        As `FieldMap.currents_for`.

    Examples
    --------
    >>> import fieldmap as fm
    >>> unit = fm.solve_linear("loop_and_sphere")
    >>> currents_for(unit, [0, 0, -0.02], flux_density=[np.nan, np.nan, 1e-3]) * unit.field([0, 0, -0.02], 1.0)[2]
    array([0.001])
    """
    source = as_field(field)
    load = moment if direction is not None or moment is None else loaded(source, moment)
    demand = demand_of(force, load, torque, flux_density, gradient, direction, least_field)
    return least_power_currents(fields_of(source), position, demand, limits, resistance, start, orientation)


def fields_of(source: Field) -> SumOfFields | SolvedField:
    """The field in the form that `least_power_currents` takes.

    Raises InputError for a field that neither superposes nor has derivatives by its currents.
    """
    if hasattr(source, "_fields_of_currents"):
        fields: SumOfFields = source._fields_of_currents()
        return fields
    if not source.affine and hasattr(source, "by_currents"):
        return SolvedField(source.by_currents, source.coil_names, source.reaction)
    require_affine(source, "currents_for")
    coils = len(source.coil_names)

    def each_field(points: Array, flux: Array, slope: Array) -> None:
        flux[:, :coils], slope[:, :coils] = source.unit_field(points), source.unit_gradient(points)
        if not source.proportional:
            flux[:, coils], slope[:, coils] = source.field_and_gradient(points, np.zeros(coils))

    constant = not source.proportional
    return SumOfFields(each_field, source.coil_names, constant, reaction=source.reaction)


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

    A magnet that follows the field is stable with its moment along B, and turns over with its moment against B. If the
    currents of least power give less than the least flux density along the direction, exactly this flux density is
    demanded. In a linear problem, which is convex, the result then has the least power with at least this flux density.

    Parameters
    ----------
    limits, resistance, start, orientation
        As in `FieldMap.currents_for`.

    Raises
    ------
    Infeasible, OutsideMapError, InputError, NotConverged
        As `FieldMap.currents_for`.
    """
    found = _meeting(field, position, demand, limits, resistance, start, orientation)
    if demand.along is None:
        return found
    row = Demand(("B along",), np.append(demand.along, np.zeros(9))[None, :], np.zeros(1))
    free = Variables(field.coil_names, *checked_limits(None, len(found)), np.ones(len(found)))
    place = np.asarray(position, dtype=float)[None, :]
    (given,), (slope,) = Goal(row, field.at(place), _UPRIGHT, free).about(found)
    # A flux density below this share of the sum of the coils' contributions is rounding.
    if given > max(demand.least * (1.0 - _ROUNDING), _ROUNDING * float(np.abs(slope) @ np.abs(found))):
        return found
    if demand.least == 0.0:
        must_hold = "the flux density must point along the direction, so that a magnet that may turn stays"
        note = f", which leaves {given:.3g} T along it at least power"
        remedy = "give least_field, the flux density along the direction that holds the magnet, T"
        raise demand.infeasible(must_hold, remedy, note)
    return _meeting(field, position, demand.held(), limits, resistance, start, orientation)


def _meeting(
    field: SumOfFields | SolvedField,
    position: ArrayLike,
    demand: Demand,
    limits: Limits,
    resistance: ArrayLike | None,
    start: ArrayLike | None,
    orientation: ArrayLike | None,
) -> Array:
    """Currents (n_coils,), A, of least power that meet the rows of a demand."""
    names = field.coil_names
    weight = checked_weight(resistance, len(names))
    points, single = checked_vectors("position", position)
    if not single:
        received = f"shape {points.shape}"
        raise InputError.of("currents_for, position", "three numbers", received, "ask place by place")
    turn, reacts = _UPRIGHT, None
    if demand.body is not None:
        turn = checked_turns(orientation, 1)[0]
        on_body = points + demand.body.all_points @ turn.T
        points = np.concatenate([points, on_body])
        reacts = reacting_at(field.reaction, on_body)
    low, high = checked_limits(limits, len(names))
    first = None if start is None else coil_currents(start, names)
    goal = Goal(demand, field.at(points), turn, Variables(names, low, high, weight), reacts)

    def by_linear(linear: SumOfFields) -> Array:
        return _meeting(linear, position, demand, limits, resistance, None, orientation)

    return least_power_of(goal, field, first, by_linear)


def least_power_of(
    goal: Goal,
    field: SumOfFields | SolvedField,
    start: Array | None,
    by_linear: Callable[[SumOfFields], Array],
) -> Array:
    """Currents (n_coils,), A, of least power that meet a goal in a field.

    Parameters
    ----------
    start
        Currents (n_coils,), A, at which a search begins.
    by_linear
        Gives the currents of least power in a linearised field.

    Raises
    ------
    Infeasible, NotConverged
        As `FieldMap.currents_for`.
    """
    demand, names, first = goal.demand, field.coil_names, start
    low, high = goal.variables.low, goal.variables.high
    model = field.iron.model if isinstance(field, SumOfFields) and field.iron is not None else None
    if isinstance(field, SumOfFields) and model is None and not demand.on_soft_iron:
        return linear_currents(goal)
    if first is None and isinstance(field, SolvedField):
        first = np.clip(np.zeros(len(names)), low, high)
        if demand.on_soft_iron:
            # At zero currents the force on soft iron has no slope. The search begins at the solution for linear iron.
            first = by_linear(field.linear_about(first))
    goal.variables = _variables(goal.variables, model, first)
    scale = _scale(goal.variables, model, first)
    saving = max(field.saving, _SAVING_ON_SOFT_IRON) if demand.on_soft_iron else field.saving
    remedy = _REMEDY if start is None else _REMEDY_OF_START
    starts = _starts(goal, model, first, float(scale.max()))
    found = best_of(Search(goal, begin, scale, field.met, saving, remedy) for begin in starts)
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
        raise InputError.of("currents_for, resistance", must_hold, received, "give ohms, or nothing")
    return weight


def _variables(of_coils: Variables, model: ReducedModel | None, first: Array | None) -> Variables:
    """Currents within the domain of a map of saturating iron, or the signals of its parametrisation.

    The cost of a signal is its power at the start of the search. This is the power of the currents if each current
    follows one signal.
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
    """Typical sizes (n,) of the variables: in the training of a model, at the start or at the limits, or 1."""
    if model is not None:
        return np.maximum(np.abs(variables.nearest(model.known_currents)).max(axis=0), 1e-12)
    limits = np.concatenate([variables.low, variables.high])
    sizes = [] if first is None else [np.abs(first).max()]
    sizes.append(np.abs(limits[np.isfinite(limits)]).max(initial=0.0))
    return np.full(len(variables.low), next((size for size in sizes if size > 0.0), 1.0))


def _starts(goal: Goal, model: ReducedModel | None, first: Array | None, scale: float) -> Iterator[Array]:
    """Variables (n,) at which searches begin: from the currents `first`, or several."""
    of, none = goal.variables, True
    if first is None and of.made is None and goal.demand.on_soft_iron:
        for start in starts_on_soft_iron(goal, scale):
            none = False
            yield start
    begin = _middle(model) if first is None and model is not None else first
    if begin is not None:
        yield of.within(of.nearest(begin))
    elif none:
        # Without another start, the search from zero currents gives the reason of the failure.
        yield of.within(np.zeros(len(of.cost)))


def best_of(searches: Iterable[Search]) -> Array:
    """The result (n,) of least power. Searches run until several in a row find nothing better, or the evaluations of a
    call are used up. If all fail, the error of the search that came nearest to the demand is raised."""
    best, least, in_vain = None, math.inf, 0
    refused: list[tuple[float, Infeasible | NotConverged]] = []
    for search in searches:
        in_vain += 1
        try:
            end = search.run()
        except (Infeasible, NotConverged) as error:
            refused.append((search.left_by(error), error))
        else:
            power = search.variables.power(end)
            in_vain = 0 if power < (1.0 - _BETTER) * least else in_vain
            best, least = (end, power) if power < least else (best, least)
        most = _HOPELESS if best is None else _ENOUGH
        if in_vain >= most or search.goal.evaluations >= MOST_EVALUATIONS:
            break
    if best is None:
        raise min(refused, key=lambda each: each[0])[1]
    return best


def starts_on_soft_iron(goal: Goal, scale: float) -> Iterator[Array]:
    """Starts of searches for a force on soft iron, of second order in the currents: docs/theory/wrench.md (11).

    Currents (n,), A, along the strongest eigenvectors of the second derivative of the demand, and of the demand with
    other values in its other rows. Their length is scaled to the demand. Both signs are tried, unless the force is even
    in the currents and the limits are symmetric. scale: a typical current, A.
    """
    of, units, size = goal.variables, np.eye(len(goal.variables.cost)), _SMALL * scale
    none = of.within(np.zeros(len(units)))
    idle = goal.about(none)[1]
    # (n, r, n): second derivatives of each row by two currents.
    bends = np.array([(goal.about(none + size * unit)[1] - idle) / size for unit in units])
    lengths = np.abs(bends).max(axis=(0, 2))
    even = bool((np.abs(idle).max(axis=1) <= _NO_SLOPE * scale * lengths).all())
    if not even:
        yield none
    per_length = np.divide(1.0, lengths, out=np.zeros_like(lengths), where=lengths > 0.0)
    wanted = goal.demand.values * per_length
    if not wanted.any():
        yield none
        return
    wanted /= np.abs(wanted).max()
    main = int(np.argmax(np.abs(wanted)))
    ways = (1.0,) if even and np.allclose(of.low, -of.high) else (1.0, -1.0)
    others = [row for row in np.flatnonzero(lengths) if row != main][:2]
    for aside in product(_ASIDE, repeat=len(others)):
        share = wanted.copy()
        share[others] += aside
        matrix = np.einsum("r,krn->kn", share * per_length, bends)
        _, vectors = np.linalg.eigh(matrix + matrix.T)
        for vector, way in product(vectors.T[: -_EIGENVECTORS - 1 : -1], ways):
            first = _as_long_as_needed(goal, main, way * vector, scale)
            if first is not None:
                yield first


def _as_long_as_needed(goal: Goal, main: int, along: Array, scale: float) -> Array | None:
    """Currents in this direction that give about the main row of the demand, or the largest within the limits; None if
    they give none of it."""
    wanted = float(goal.demand.values[main])
    direction = along / np.abs(along).max()
    currents = goal.variables.within(scale * direction)
    for _ in range(_RESCALINGS):
        given = float(goal.about(currents)[0][main])
        if given * wanted <= 0.0:
            return None
        ratio = math.sqrt(wanted / given)
        following = goal.variables.within(min(ratio, 10.0) * currents)
        if abs(ratio - 1.0) < 0.01 or np.array_equal(following, currents):
            break
        currents = following
    return currents
