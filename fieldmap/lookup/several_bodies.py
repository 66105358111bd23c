"""Currents of least power that give forces on several bodies at once. docs/theory/actuation.md.

The bodies act on each other, directly and through the iron that they magnetise. Soft iron follows the whole field.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check, check_vector, checked_vectors
from fieldmap.core.body import wrench_slopes
from fieldmap.errors import Infeasible, InputError
from fieldmap.field import AnyField, as_field, coil_currents
from fieldmap.lookup.actuation import FORCE_ROWS, TORQUE_ROWS, Actuation, Limits, checked_limits
from fieldmap.lookup.demand import Demand
from fieldmap.lookup.inverse import checked_weight, fields_of, least_power_of
from fieldmap.lookup.inverse_problem import FieldAtPoints, Goal, SumOfFields, Variables
from fieldmap.lookup.magnetic_body import MagneticBody, checked_turns, reacting_at, unsettled
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class SeveralForces(Record):
    """currents (n_coils,), A; actuation: the wanted components of all bodies, their derivatives (r, n_coils) by the
    currents, and the rest, so that matrix @ currents + constant are the components at these currents. Its `rank` is
    below the number of rows if the currents do not command every component independently. With a large `condition`
    small changes of the demand can take large changes of the currents."""

    currents: Array
    actuation: Actuation


@dataclass(frozen=True, eq=False, repr=False)
class _Demand(Demand):
    """The demanded ones of the components (6 n,), which are force and torque of each body in turn."""

    bodies: tuple[MagneticBody, ...] = ()

    @property
    def on_soft_iron(self) -> bool:
        return any(body.soft for body in self.bodies)


@dataclass(eq=False)
class _Goal(Goal):
    """turn (n, 3, 3): of each body; places (n, 3), m."""

    places: Array | None = None

    def about(self, values: Array) -> tuple[Array, Array]:
        given, self.last_slopes = super().about(values)
        return given, self.last_slopes

    def undirected(self) -> Array:
        return np.zeros(len(self.demand.values))

    def _rows_of(self, fields: Array) -> Callable[[Array], tuple[Array, Array]]:
        assert isinstance(self.demand, _Demand)
        assert self.places is not None
        wanted, cores = self.demand.selection, [body.core for body in self.demand.bodies]
        k, poses = fields.shape[1], (cores, self.places, self.turn)
        flux = np.ascontiguousarray(fields[:, :, :3])
        gradient = np.ascontiguousarray(fields[:, :, 3:]).reshape(-1, k, 3, 3)
        reacts = self.reacts or reacting_at(None, flux)

        def load(weights: Array) -> tuple[Array, Array]:
            wrench, slopes = np.empty((len(cores), 6)), np.empty((len(cores), 6, k))
            each = np.ascontiguousarray(weights)
            if not wrench_slopes(*poses, each, (flux, gradient), reacts, wrench, slopes):
                raise unsettled("currents_for_several")
            return wanted @ wrench.ravel(), wanted @ slopes.reshape(-1, k)

        return load


def currents_for_several(
    field: AnyField,
    positions: ArrayLike,
    moments: Sequence[ArrayLike | MagneticBody],
    forces: ArrayLike | None = None,
    limits: Limits = None,
    *,
    torques: ArrayLike | None = None,
    orientations: ArrayLike | None = None,
    resistance: ArrayLike | None = None,
    start: ArrayLike | None = None,
) -> SeveralForces:
    """Currents of least power that give forces and torques on n bodies at once.

    The force on a body comes from the coils, from magnets and soft iron of all other bodies, and from the reaction of
    the machine's iron to all bodies, if the field has it.

    Parameters
    ----------
    field
        Map, solution, coils, or a field of your own.
    positions
        Centres of the bodies (n, 3) in the frame of the field, m.
    moments
        For each body a moment (3,), A m^2, or a `MagneticBody`.
    forces, torques
        (n, 3), N and N m, about the centres; NaN leaves a component free.
    limits, resistance, start
        As in `FieldMap.currents_for`.
    orientations
        Rotations (n, 3, 3) whose columns are the axes of the bodies; upright unless given.

    Returns
    -------
    SeveralForces
        The currents, with rank and condition of the problem.

    Raises
    ------
    Infeasible
        As `FieldMap.currents_for`; with `actuation`, its rank and condition.
    OutsideMapError, InputError, NotConverged
        As `FieldMap.currents_for`, and NotConverged for bodies that overlap.

    Examples
    --------
    >>> from fieldmap.sources import CoilSet
    >>> import fieldmap as fm
    >>> high, low = (fm.Placement([0, 0, z]) for z in (0.03, -0.03))
    >>> of = [fm.CircularCoil(n, 0.01, 0.02, 0.01, 100, placement=at) for n, at in (("a", high), ("b", low))]
    >>> coils, lift = CoilSet(of), [[np.nan, np.nan, 0.1], [np.nan, np.nan, 0.1]]
    >>> found = currents_for_several(coils, [[0, 0, 0.01], [0, 0, -0.01]], [[0, 0, 1], [0, 0, 1]], lift)
    >>> found.actuation.rank, round(found.actuation.condition, 2)
    (2, 1.33)
    """
    source = as_field(field)
    places, bodies, turns = _bodies_at(positions, moments, orientations)
    demand = _demand(len(places), forces, torques, bodies)
    names = tuple(source.coil_names)
    weight, (low, high) = checked_weight(resistance, len(names)), checked_limits(limits, len(names))
    points = np.concatenate(
        [at + body.all_points @ turn.T for at, body, turn in zip(places, bodies, turns, strict=True)]
    )
    first, reacts = (
        None if start is None else coil_currents(start, names),
        reacting_at(source.reaction, points),
    )

    def goal_in(at_points: FieldAtPoints, lowest: Array, highest: Array) -> _Goal:
        variables = Variables(names, lowest, highest, weight)
        return _Goal(demand, at_points, turns, variables, reacts, places)

    def by_linear(linear: SumOfFields) -> Array:
        return least_power_of(goal_in(linear.at(points), low, high), linear, None, by_linear)

    fields = fields_of(source)
    at_points = fields.at(points)
    goal = goal_in(at_points, low, high)
    try:
        currents = least_power_of(goal, fields, first, by_linear)
    except Infeasible as error:
        raise _with_rank(error, Actuation(demand.names, goal.last_slopes)) from None
    free = np.full(len(names), np.inf)
    given, slope = goal_in(at_points, -free, free).about(currents)
    return SeveralForces(currents, Actuation(demand.names, slope, given - slope @ currents))


def _bodies_at(
    positions: ArrayLike, moments: Sequence[ArrayLike | MagneticBody], orientations: ArrayLike | None
) -> tuple[Array, tuple[MagneticBody, ...], Array]:
    """Places (n, 3), bodies (a dipole for a moment), and rotations (n, 3, 3)."""
    places, _ = checked_vectors("currents_for_several, positions", positions)
    where, remedy = "currents_for_several, moments", "give a moment (3,) or a MagneticBody for each position"
    check(len(moments) == len(places), where, f"must be {len(places)}", len(moments), remedy)
    bodies = tuple(
        one if isinstance(one, MagneticBody) else MagneticBody.dipole(check_vector(where, one, remedy))
        for one in moments
    )
    return places, bodies, np.array(checked_turns(orientations, len(places)))


def _demand(n: int, forces: Any, torques: Any, bodies: tuple[MagneticBody, ...]) -> _Demand:
    """The components of forces and torques (n, 3) that are not NaN."""
    values, names = np.full((n, 6), np.nan), FORCE_ROWS + TORQUE_ROWS
    for name, given, columns in (("forces", forces, slice(3)), ("torques", torques, slice(3, 6))):
        if given is None:
            continue
        numbers = np.asarray(given, dtype=np.float64)
        fits, must_hold = numbers.shape == (n, 3) and not np.isinf(numbers).any(), f"numbers ({n}, 3)"
        check(fits, f"currents_for_several, {name}", must_hold, repr(given)[:80], "give a row for each body")
        values[:, columns] = numbers
    asked = np.flatnonzero(~np.isnan(values.ravel()))
    if not asked.size:
        must_hold, remedy = "at least one component that is not NaN", "give forces or torques"
        raise InputError.of("currents_for_several, demand", must_hold, "none", remedy)
    each = tuple(f"{names[k % 6]} of body {k // 6 + 1}" for k in asked)
    return _Demand(each, np.eye(6 * n)[asked], values.ravel()[asked], bodies=bodies)


def _with_rank(error: Infeasible, about: Actuation) -> Infeasible:
    """The error with rank and condition of the problem."""
    known = f"; rank {about.rank} of {len(about.rows)} rows, condition {about.condition:.3g}"
    problems = [replace(problem, received=problem.received + known) for problem in error.problems]
    reached = {"reachable": error.reachable, "share": error.share, "binding": error.binding}
    return Infeasible(*problems, **reached, actuation=about)
