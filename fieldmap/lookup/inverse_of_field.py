"""Currents of least power for what is asked for at a place: in maps, and in solved devices of linear iron."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.field import AnyField, Field, as_field, require_affine
from fieldmap.lookup.actuation import Limits
from fieldmap.lookup.demand import demand_of
from fieldmap.lookup.field_map import FieldMap
from fieldmap.lookup.inverse import least_power_currents
from fieldmap.lookup.inverse_fields import SolvedField, SumOfFields
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
    """Currents of least power that give what is asked for at a position, in a map or in a device without a map.

    Of a device whose saturating iron is solved for all currents anew (`fieldmap.iron.NonlinearSolver`) the demand is
    met to 1e-5, and every step of the search takes a solve or a few.

    Parameters
    ----------
    field
        Map, solution, coils, or a field of your own.
    flux_density
        (3,), T; NaN leaves a component free.
    position, force, moment, limits, torque, gradient, resistance, start, orientation
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
    demand = demand_of(force, moment, torque, flux_density, gradient)
    fields = _fields_of(as_field(field))
    return least_power_currents(fields, position, demand, limits, resistance, start, orientation)


def _fields_of(source: Field) -> SumOfFields | SolvedField:
    """Raises InputError for a field that neither superposes nor has derivatives by its currents."""
    if isinstance(source, FieldMap):
        return source._fields_of_currents()
    if not source.affine and hasattr(source, "by_currents"):
        return SolvedField(source.by_currents, source.coil_names)
    require_affine(source, "currents_for")
    coils = len(source.coil_names)

    def each_field(points: Array, flux: Array, slope: Array) -> None:
        flux[:, :coils], slope[:, :coils] = source.unit_field(points), source.unit_gradient(points)
        if not source.proportional:
            flux[:, coils], slope[:, coils] = source.field_and_gradient(points, np.zeros(coils))

    return SumOfFields(each_field, source.coil_names, constant=not source.proportional)
