"""Currents of least power for what is asked for at a place: in maps, and in solved devices of linear iron."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import checked_vectors
from fieldmap.errors import Infeasible, InputError, NotConverged, Problem
from fieldmap.field import AnyField, Field, as_field, coil_currents, require_affine
from fieldmap.lookup.actuation import Limits, checked_limits
from fieldmap.lookup.field_map import FieldMap
from fieldmap.lookup.inverse import (
    Demand,
    FieldsOfMap,
    Search,
    checked_weight,
    currents_of_sum,
    demand_of,
    remedy_of_start,
)
from fieldmap.lookup.inverse_on_body import currents_on_body, wrench_demand
from fieldmap.lookup.magnetic_body import MagneticBody, checked_turns
from fieldmap.typing import Array


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
) -> Array:
    """Currents (n_coils,), A, of least power that give what is asked for at a position (3,), m, in a device without a
    map, or a map, for which it is `FieldMap.currents_for`.

    flux_density (3,), T; the others, the units and the errors as there. Of a device whose saturating iron is solved for
    all currents anew (`fieldmap.iron.NonlinearSolver`) the demand is met to 1e-5, and every step of the search takes a
    solve or a few; it begins at `start`, or where iron linear about currents of zero would have the answer. Raises
    InputError for a field that neither superposes nor has derivatives by its currents.

    >>> import fieldmap as fm
    >>> unit = fm.solve_linear("loop_and_sphere")
    >>> currents_for(unit, [0, 0, -0.02], flux_density=[np.nan, np.nan, 1e-3]) * unit.field([0, 0, -0.02], 1.0)[2]
    array([0.001])
    """
    source = as_field(field)
    if isinstance(source, FieldMap):
        return source.currents_for(
            position,
            force,
            moment,
            limits,
            torque=torque,
            field=flux_density,
            gradient=gradient,
            resistance=resistance,
            start=start,
            orientation=orientation,
        )
    names = source.coil_names
    weight = checked_weight(resistance, len(names))
    if isinstance(moment, MagneticBody):
        body, demand = moment, wrench_demand(force, torque, flux_density, gradient)
    else:
        body, demand = None, demand_of(force, moment, torque, flux_density, gradient)

    def of_sum(fields: FieldsOfMap, constant: bool) -> Array:
        if body is None:
            return currents_of_sum(fields, names, position, demand, limits, weight, constant)
        about = (position, body, orientation, demand, limits, weight, start)
        return currents_on_body(fields, names, None, constant, *about)

    if source.affine or not hasattr(source, "by_currents"):
        require_affine(source, "currents_for")
        return of_sum(_FieldsOfCoils(source), not source.proportional)
    where, single = checked_vectors("position", position)
    if not single:
        received = f"shape {where.shape}"
        raise InputError(Problem("currents_for, position", "three numbers", received, "ask place by place"))
    goal = _OfSolved(demand, np.ones(len(demand.names)), source, where, body, orientation)
    low, high = checked_limits(limits, len(names))
    first = np.clip(coil_currents(0.0 if start is None else start, names), low, high)
    if start is None:
        try:
            first = of_sum(_AboutCurrents(source, first), True)
        except (Infeasible, NotConverged):
            if body is not None and body.soft:
                raise
    typical = np.where(first != 0.0, np.abs(first), np.abs(first).max(initial=0.0) or 1.0)
    goal.size[:] = np.maximum(np.abs(goal.slope(first)) @ typical, np.abs(demand.values))
    remedy = remedy_of_start(start is not None)
    return Search(goal, names, low, high, weight, typical, _SAVING, remedy, met=_MET).run(first)


# States are solved to 1e-6 or so: what a search can ask of them, of the demand and of the power.
_MET, _SAVING = 1e-5, 1e-5


class _OfSolved:
    """What currents give of a demand at a place (1, 3), in a field that is solved for each of them: see `Goal`."""

    def __init__(
        self,
        demand: Demand,
        size: Array,
        source: Any,
        place: Array,
        body: MagneticBody | None,
        orientation: ArrayLike | None,
    ) -> None:
        self.demand, self.size, self.source, self.body = demand, size, source, body
        self.turn = checked_turns(orientation, 1)[0]
        self.points = (
            place if body is None else np.concatenate([place, place + body.all_points @ self.turn.T])
        )
        self.last: tuple[bytes, tuple[Array, Array]] = (b"", (size, size))

    def given(self, currents: Array) -> Array:
        """See `Goal`."""
        return self._both(currents)[0]

    def slope(self, currents: Array) -> Array:
        """See `Goal`."""
        return self._both(currents)[1]

    def _both(self, currents: Array) -> tuple[Array, Array]:
        if self.last[0] != currents.tobytes():
            flux, slope, by_flux, by_slope = self.source.by_currents(self.points, currents)
            value = np.concatenate([flux[0], slope[0].ravel()])
            matrix = np.concatenate([by_flux[0].T, by_slope[0].reshape(len(currents), 9).T])
            if self.body is not None:
                # The field of the state, of weight 1, and what more of each current adds to it.
                every = [
                    np.concatenate([a[1:, None], b[1:]], axis=1)
                    for a, b in ((flux, by_flux), (slope, by_slope))
                ]
                load = self.body.by_fields(every[0], every[1], self.turn)
                wrench, slopes = load(np.append(1.0, np.zeros(len(currents))))
                value, matrix = np.concatenate([wrench, value]), np.concatenate([slopes[:, 1:], matrix])
            rows = self.demand.selection
            self.last = currents.tobytes(), (rows @ value, np.ascontiguousarray(rows @ matrix))
        return self.last[1]


class _AboutCurrents:
    """The field of a solved device linear about currents (n,), A: that of every coil at 1 A, then the rest."""

    def __init__(self, source: Any, currents: Array) -> None:
        self.source, self.currents = source, currents

    def each_field(self, points: Array, flux: Array, slope: Array) -> None:
        """Fill flux (n, fields, 3), T, and slope (n, fields, 3, 3), T/m, of points (n, 3)."""
        here, gradient, by_flux, by_slope = self.source.by_currents(points, self.currents)
        flux[:, :-1], slope[:, :-1] = by_flux, by_slope
        flux[:, -1] = here - np.einsum("pki,k->pi", by_flux, self.currents)
        slope[:, -1] = gradient - np.einsum("pkij,k->pij", by_slope, self.currents)


class _FieldsOfCoils:
    """What the inverse asks of an evaluator: the field of every coil at 1 A, then what no current drives."""

    def __init__(self, source: Field) -> None:
        self.source = source

    def each_field(self, points: Array, flux: Array, slope: Array) -> None:
        """Fill flux (n, fields, 3), T, and slope (n, fields, 3, 3), T/m, of points (n, 3)."""
        coils = len(self.source.coil_names)
        flux[:, :coils], slope[:, :coils] = self.source.unit_field(points), self.source.unit_gradient(points)
        if flux.shape[1] > coils:
            flux[:, coils], slope[:, coils] = self.source.field_and_gradient(points, np.zeros(coils))
