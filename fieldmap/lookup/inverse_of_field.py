"""Currents of least power for what is asked for at a place: in maps, and in solved devices of linear iron."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.field import AnyField, Field, as_field, require_affine
from fieldmap.lookup.actuation import Limits
from fieldmap.lookup.field_map import FieldMap
from fieldmap.lookup.inverse import checked_weight, currents_of_sum, demand_of
from fieldmap.lookup.inverse_on_body import currents_on_body, wrench_demand
from fieldmap.lookup.magnetic_body import MagneticBody
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
    """Currents (n_coils,), A, of least power that give what is asked for at a position (3,), m, in any field that is
    the sum of its coils': a solved device without a map, or a map, for which it is `FieldMap.currents_for`.

    flux_density (3,), T; the others, the units and the errors as there. Raises InputError for a field that is no sum.

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
    require_affine(source, "currents_for")
    names = source.coil_names
    fields, weight = _FieldsOfCoils(source), checked_weight(resistance, len(names))
    constant = not source.proportional
    if isinstance(moment, MagneticBody):
        wanted = wrench_demand(force, torque, flux_density, gradient)
        body = (position, moment, orientation, wanted, limits, weight, start)
        return currents_on_body(fields, names, None, constant, *body)
    demand = demand_of(force, moment, torque, flux_density, gradient)
    return currents_of_sum(fields, names, position, demand, limits, weight, constant)


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
