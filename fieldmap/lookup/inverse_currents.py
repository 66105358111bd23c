"""Least-power currents that give a wrench or a field, where the field is the sum of the coils' fields."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import linprog

from fieldmap.arguments import checked_vectors
from fieldmap.errors import FieldmapError, Infeasible, InputError, NotConverged, OutsideMapError, Problem
from fieldmap.kernels.map import least_power as kernels
from fieldmap.kernels.map.lookup import evaluate_units
from fieldmap.lookup.actuation import Limits, checked_limits
from fieldmap.lookup.demand import Demand
from fieldmap.typing import Array


def currents_of_sum(
    block: Array,
    coil_names: tuple[str, ...],
    position: ArrayLike,
    demand: Demand,
    limits: Limits,
    weight: Array,
) -> Array:
    """Currents (n_coils,), A, from the block of a map's coils; arguments as in `FieldMap.currents_for`."""
    n = len(coil_names)
    matrix = rows_at(block, position, demand, n)
    low, high = checked_limits(limits, n)
    currents, active = np.empty(n), np.empty(n, np.int64)
    status = kernels.least_power(matrix, demand.values, low, high, weight, currents, active)
    if status != kernels.FOUND:
        raise refusal(status, matrix, demand, low, high, active, coil_names)
    return currents


def rows_at(block: Array, position: ArrayLike, demand: Demand, n_fields: int) -> Array:
    """What each field of a map at weight 1 gives of the demand at a position, (rows, n_fields)."""
    where, single = checked_vectors("position", position)
    flux, slope = np.empty((1, n_fields, 3)), np.empty((1, n_fields, 3, 3))
    if not single:
        received = f"shape {where.shape}"
        raise InputError(Problem("currents_for, position", "three numbers", received, "ask place by place"))
    evaluate_units(block, where, flux, slope)
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
) -> FieldmapError:
    """The error for a demand that was not met: which limits bind, and what can be had."""
    if status == kernels.NO_END:
        what = "the active-set method must end"
        return NotConverged(Problem("currents_for", what, demand.text(demand.values), "report this case"))
    received = demand.text(demand.values)
    if status == kernels.OUT_OF_RANGE:
        nearest = matrix @ np.linalg.lstsq(matrix, demand.values, rcond=1e-11)[0]
        must_hold = "a demand that some currents give, whatever their limits"
        remedy = f"nearest that they give: {demand.text(nearest)}"
        return Infeasible(Problem("currents_for", must_hold, received, remedy), reachable=nearest)
    ends = np.where(active > 0, high, low)
    binding = {names[k]: float(ends[k]) for k in np.flatnonzero(active)}
    limits = ", ".join(f"coil {name} at {value:g} A" for name, value in binding.items())
    must_hold = f"a demand within the limits of the currents; together these rule it out: {limits}"
    part = reachable_share(matrix, demand.values, low, high)
    if part is None:
        problem = Problem("currents_for", must_hold, received, "no share of it can be had")
        return Infeasible(problem, binding=binding)
    problem = Problem("currents_for", must_hold, received, f"{part[0]:.6g} of it can: {demand.text(part[1])}")
    return Infeasible(problem, reachable=part[1], share=part[0], binding=binding)


def reachable_share(matrix: Array, wanted: Array, low: Array, high: Array) -> tuple[float, Array] | None:
    """Largest share of the demand that currents within the limits give, and what it is; None if there is none.

    A linear program: t, i with A i = t b, t largest.
    """
    size = np.linalg.norm(matrix, axis=1)
    rows = size > 0
    scale = size[rows]
    constraint = np.hstack([matrix[rows] / scale[:, None], -(wanted[rows] / scale)[:, None]])
    goal = np.append(np.zeros(matrix.shape[1]), -1.0)
    bounds = [*zip(low, high, strict=True), (0.0, 1.0)]
    found = linprog(goal, A_eq=constraint, b_eq=np.zeros(rows.sum()), bounds=bounds, method="highs")
    if found.status != 0 or found.x[-1] <= 0.0:
        return None
    return float(found.x[-1]), np.asarray(found.x[-1] * wanted)


def _no_place(position: Array) -> OutsideMapError:
    where = tuple(round(float(x) * 1e3, 6) for x in position)
    return OutsideMapError(
        Problem("currents_for, position", "a place in the map's box", f"{where} mm", "stay in the box")
    )
