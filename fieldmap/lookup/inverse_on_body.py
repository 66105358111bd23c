"""Currents of least power for a force on a body of soft iron or of several magnets: docs/theory/wrench.md (11).

The force on soft iron is of second order in the currents. Every step takes it as linear about the present currents
(`fieldmap.lookup.inverse.Search`); where such a search must begin is found from its second derivative.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import checked_vectors
from fieldmap.errors import Infeasible, InputError, NotConverged, OutsideMapError, Problem
from fieldmap.field import coil_currents
from fieldmap.lookup.actuation import (
    FORCE_ROWS,
    TORQUE_ROWS,
    Limits,
    checked_limits,
)
from fieldmap.lookup.current_model import CurrentModel, CurrentSearch
from fieldmap.lookup.inverse import (
    Demand,
    FieldsOfMap,
    Search,
    currents_of_signals,
    demand_of,
    first_currents,
    is_free,
    limits_of,
    remedy_of_start,
    typical_currents,
)
from fieldmap.lookup.magnetic_body import MagneticBody, checked_turns
from fieldmap.typing import Array

_LEAST_SAVING = 1e-7  # of the power, below which a step is the last
_SMALL = 1e-3  # currents, of the typical ones, at which soft iron is still linear
_ASIDE = (0.0, 1.0, -1.0)  # of the wanted force: what is tried beside it along each other row
_EIGENVECTORS = 2
_RESCALINGS = 12

ROWS = FORCE_ROWS + TORQUE_ROWS


def wrench_demand(
    force: ArrayLike | None, torque: ArrayLike | None, field: ArrayLike | None, gradient: ArrayLike | None
) -> Demand:
    """Rows of all that is asked for at once, as `demand_of` for a body: selection (r, 18) on force and torque (6), and
    on flux density and gradient at the body's centre (12). Raises InputError."""
    parts: list[Array] = []
    names: list[str] = []
    values: list[Array] = []
    for asked, rows, what in ((force, FORCE_ROWS, "force"), (torque, TORQUE_ROWS, "torque")):
        if asked is None:
            continue
        given = np.asarray(asked, dtype=np.float64)
        if given.shape != (3,) or np.isinf(given).any():
            must_hold = "numbers of shape (3,), none infinite"
            received = repr(asked)[:80]
            raise InputError(Problem(f"currents_for, {what}", must_hold, received, "give arrays in SI units"))
        parts.append(np.eye(18)[[ROWS.index(name) for name in rows]])
        names += rows
        values.append(given)
    if field is not None or gradient is not None:
        beside = demand_of(None, None, None, field, gradient)
        parts.append(np.hstack([np.zeros((len(beside.names), 6)), beside.selection]))
        names += beside.names
        values.append(beside.values)
    wanted = np.concatenate([*values, np.zeros(0)])
    asked_rows = ~np.isnan(wanted)
    if not asked_rows.any():
        received = "none of them" if not names else "only NaN"
        must_hold = "force, torque, field or gradient"
        raise InputError(Problem("currents_for, demand", must_hold, received, "ask for one of them"))
    chosen = tuple(name for name, asked in zip(names, asked_rows, strict=True) if asked)
    return Demand(chosen, np.concatenate(parts)[asked_rows], wanted[asked_rows])


class _Superposed:
    """Weights of a map's fields where these are the currents, and 1 for a field that no current drives."""

    def __init__(self, coils: int, constant: bool) -> None:
        self.constant = np.ones(int(constant))
        self.unit = np.eye(coils + int(constant), coils)

    def weights(self, currents: Array) -> Array:
        """(fields,)."""
        return np.concatenate([currents, self.constant])

    def slopes(self, currents: Array) -> Array:
        """(fields, coils)."""
        return self.unit


@dataclass(eq=False)
class _OnBody:
    """What currents give of a demand on a body. at (12, fields): flux density and gradient at its centre."""

    demand: Demand
    size: Array
    load: Callable[[Array], tuple[Array, Array]]
    at: Array
    model: CurrentSearch | _Superposed

    def __post_init__(self) -> None:
        self._last: tuple[bytes, tuple[Array, Array]] | None = None

    def _both(self, currents: Array) -> tuple[Array, Array]:
        """What is given (r,), and its derivatives (r, fields) by the weights; the last is cached."""
        key = currents.tobytes()
        if self._last is None or self._last[0] != key:
            weights = np.ascontiguousarray(self.model.weights(currents))
            wrench, slopes = self.load(weights)
            every = np.concatenate([wrench, self.at @ weights]), np.concatenate([slopes, self.at])
            self._last = key, (self.demand.selection @ every[0], self.demand.selection @ every[1])
        return self._last[1]

    def given(self, currents: Array) -> Array:
        """See `Goal`."""
        return self._both(currents)[0]

    def slope(self, currents: Array) -> Array:
        """See `Goal`."""
        return np.ascontiguousarray(self._both(currents)[1] @ self.model.slopes(currents))


def currents_on_body(
    evaluator: FieldsOfMap,
    coil_names: tuple[str, ...],
    model: CurrentModel | None,
    constant: bool,
    position: ArrayLike,
    body: MagneticBody,
    orientation: ArrayLike | None,
    demand: Demand,
    limits: Limits,
    weight: Array,
    start: ArrayLike | None,
) -> Array:
    """Currents (n_coils,), A; arguments as in `FieldMap.currents_for`. model: of saturating iron; constant: the map has
    one more field, that no current drives.

    From `start`, or from several places; the answer of least power. Each is a local optimum, to 1e-7 of the power.
    Raises Infeasible where no search ends at the demand: no proof that no currents exist.
    """
    coils = len(coil_names)
    if model is None:
        low, high = checked_limits(limits, coils)
        search: CurrentSearch | _Superposed = _Superposed(coils, constant)
        fields = coils + int(constant)
    else:
        low, high = limits_of(model, limits)
        search, fields = model.search(), coils + model.fields_beside_coils
    load, at = _fields_at(evaluator, fields, position, body, orientation)
    goal = _OnBody(demand, np.ones(len(demand.names)), load, at, search)
    given = None if start is None else np.clip(coil_currents(start, coil_names), low, high)
    remedy = remedy_of_start(given is not None)
    scale = _scale(goal, low, high, given, model)
    if model is not None and not is_free(model):
        first = first_currents(model, coil_names, start)
        goal.size = _size(goal, first, scale)
        about = (coil_names, limits, weight, first, remedy, _LEAST_SAVING)
        return currents_of_signals(goal, model, *about)
    starts = [given] if given is not None else list(_starts(goal, scale, low, high, body, constant))
    if given is None and model is not None:
        starts.append(np.clip(first_currents(model, coil_names, None), low, high))
    found, refused = [], []
    for first in starts:
        # What a row is worth: what is asked of it, or what currents of this size give of it.
        goal.size = _size(goal, first, scale)
        typical = np.maximum(np.abs(first), np.abs(_step(goal, first)))
        typical = np.maximum(typical, 0.1 * scale)
        run = Search(goal, coil_names, low, high, weight, typical, _LEAST_SAVING, remedy)
        try:
            found.append(run.run(first))
        except (Infeasible, NotConverged) as error:
            refused.append(error)
    if not found:
        raise min(refused, key=lambda error: _left_by(error, demand))
    return min(found, key=lambda currents: float(weight @ currents**2))


def _left_by(error: Infeasible | NotConverged, demand: Demand) -> float:
    """How much of the demand a search that failed has left."""
    reached = error.reachable if isinstance(error, Infeasible) else None
    return math.inf if reached is None else float(np.linalg.norm(reached - demand.values))


def _fields_at(
    evaluator: FieldsOfMap,
    fields: int,
    position: ArrayLike,
    body: MagneticBody,
    orientation: ArrayLike | None,
) -> tuple[Callable[[Array], tuple[Array, Array]], Array]:
    """Wrench of a body by the weights of a map's fields, and these fields at its centre (12, fields)."""
    where, single = checked_vectors("position", position)
    if not single:
        received = f"shape {where.shape}"
        raise InputError(Problem("currents_for, position", "three numbers", received, "ask place by place"))
    turn = checked_turns(orientation, 1)[0]
    points = np.concatenate([where, where + body.all_points @ turn.T])
    flux, slope = np.empty((len(points), fields, 3)), np.empty((len(points), fields, 3, 3))
    evaluator.each_field(points, flux, slope)
    outside = [point for point, b in zip(points, flux, strict=True) if not math.isfinite(b[0, 0])]
    if outside:
        place = tuple(round(float(x) * 1e3, 6) for x in outside[0])
        must_hold, remedy = "the whole body in the map's box", "stay in the box"
        raise OutsideMapError(Problem("currents_for, position", must_hold, f"{place} mm", remedy))
    at = np.concatenate([flux[0].T, slope[0].reshape(fields, 9).T])
    return body.by_fields(flux[1:], slope[1:], turn), at


def _scale(goal: _OnBody, low: Array, high: Array, given: Array | None, model: CurrentModel | None) -> float:
    """A current, A, by which others are called small or large."""
    if model is not None:
        return float(typical_currents(model).max())
    if given is not None and np.abs(given).max() > 0.0:
        return float(np.abs(given).max())
    ends = np.concatenate([low, high])
    ends = np.abs(ends[np.isfinite(ends)])
    return float(ends.max()) if ends.size and ends.max() > 0.0 else 1.0


def _step(goal: _OnBody, currents: Array) -> Array:
    """The shortest change of the currents that gives what is missing of the demand, to first order."""
    missing = goal.demand.values - goal.given(currents)
    slope = goal.slope(currents) / goal.size[:, None]
    return np.asarray(np.linalg.lstsq(slope, missing / goal.size, rcond=1e-3)[0], float)


def _size(goal: _OnBody, currents: Array, scale: float) -> Array:
    here = np.abs(goal.slope(currents)) @ np.maximum(np.abs(currents), 1e-3 * scale)
    return np.asarray(np.maximum(np.maximum(here, np.abs(goal.demand.values)), 1e-300))


def _starts(
    goal: _OnBody, scale: float, low: Array, high: Array, body: MagneticBody, constant: bool
) -> Iterator[Array]:
    """Where searches begin: along the strongest directions of the second derivative of what is wanted, and of that with
    more or less beside it, as long as it takes. Both ways unless only the square of the currents counts."""
    coils = len(low)
    none, size = np.clip(np.zeros(coils), low, high), _SMALL * scale
    idle = goal.slope(none)
    if np.abs(idle).max() > 0.0 or not body.soft:
        yield none
    if not body.soft:
        return
    # (coils, r, coils): of each row, by two currents.
    bends = np.array([(goal.slope(none + size * unit) - idle) / size for unit in np.eye(coils)])
    lengths = np.abs(bends).max(axis=(0, 2))
    rows = np.flatnonzero(lengths > 0.0)
    wanted = np.where(lengths > 0.0, goal.demand.values / np.maximum(lengths, 1e-300), 0.0)
    if not wanted.any():
        yield none
        return
    wanted /= np.abs(wanted).max()
    main = int(np.argmax(np.abs(wanted)))
    ways = (1.0,) if len(body.points) == 0 and not constant and np.allclose(low, -high) else (1.0, -1.0)
    others = [row for row in rows if row != main][:2]
    for aside in product(_ASIDE, repeat=len(others)):
        share = wanted.copy()
        share[others] += aside
        matrix = np.einsum("r,krn->kn", share / np.maximum(lengths, 1e-300), bends)
        _, vectors = np.linalg.eigh(matrix + matrix.T)
        for vector in vectors.T[: -_EIGENVECTORS - 1 : -1]:
            for way in ways:
                first = _as_long_as_needed(goal, main, way * vector, scale, low, high)
                if first is not None:
                    yield first


def _as_long_as_needed(
    goal: _OnBody, main: int, along: Array, scale: float, low: Array, high: Array
) -> Array | None:
    """Currents in this direction that give about the main row of the demand; as many as there are where it takes more,
    None where they give none of it."""
    wanted = float(goal.demand.values[main])
    direction = along / np.abs(along).max()
    currents = np.clip(scale * direction, low, high)
    for _ in range(_RESCALINGS):
        given = float(goal.given(currents)[main])
        if given * wanted <= 0.0:
            return None
        ratio = math.sqrt(wanted / given)
        following = np.clip(min(ratio, 10.0) * currents, low, high)
        if abs(ratio - 1.0) < 0.01 or np.array_equal(following, currents):
            break
        currents = following
    return currents
