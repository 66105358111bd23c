"""The demand of an inverse: the force, torque, flux density and gradient that currents shall give at a place."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_not_negative, remedy_of_moment
from fieldmap.errors import Infeasible, InputError, Problem
from fieldmap.lookup.actuation import FIELD_ROWS, FORCE_ROWS, GRADIENT_ROWS, TORQUE_ROWS, dipole_rows
from fieldmap.lookup.magnetic_body import MagneticBody
from fieldmap.records import Record
from fieldmap.typing import Array

_ROWS = FORCE_ROWS + TORQUE_ROWS + FIELD_ROWS + GRADIENT_ROWS
_FREE = np.full(len(_ROWS), np.nan)
_UNITS = {"F": "N", "T": "N m", "B": "T", "d": "T/m"}
# The five independent entries of the gradient, by row and column.
_ENTRIES = [0, 0, 0, 1, 1], [0, 1, 2, 1, 2]
_OF_FIELD = np.eye(12)[[0, 1, 2, 3, 4, 5, 7, 8]]
_OF_BODY = np.eye(18)[[*range(12), 13, 14]]
_PER_MOMENT = np.stack([dipole_rows(axis) for axis in np.eye(3)], axis=-1)


@dataclass(frozen=True, eq=False, repr=False)
class Demand(Record):
    """Components with names and wanted values (r,).

    The components are selection (r, 12) @ (flux density, gradient row by row); on a body they are selection (r, 18) @
    (force, torque, flux density, gradient row by row). along: for a magnet that follows the field, unit vector (3,) of
    its moment; least: least flux density along it, T.
    """

    names: tuple[str, ...]
    selection: Array
    values: Array
    body: MagneticBody | None = None
    along: Array | None = None
    least: float = 0.0

    @property
    def on_soft_iron(self) -> bool:
        """Whether the body has soft iron, so that its force is not linear in the field."""
        return self.body is not None and bool(self.body.soft)

    def held(self) -> Demand:
        """The demand with one more row: the least flux density along the direction."""
        assert self.along is not None
        row = _rows_of_field(self.along[None, :], self.selection.shape[1])
        names, values = (*self.names, "B along"), np.append(self.values, self.least)
        return replace(self, names=names, selection=np.vstack([self.selection, row]), values=values)

    def text(self, values: Array) -> str:
        """Values with names and units, zeros left out."""
        size = np.abs(values).max(initial=0.0)
        parts = [
            f"{name} = {value:.6g} {_UNITS[name[0]]}"
            for name, value in zip(self.names, values, strict=True)
            if abs(value) > 1e-9 * size
        ]
        return ", ".join(parts) or "zero"

    def infeasible(self, must_hold: str, remedy: str, note: str = "", **found: Any) -> Infeasible:
        """The error for this demand. note: added to its text; found: attributes of the error."""
        received = self.text(self.values) + note
        return Infeasible(Problem("currents_for", must_hold, received, remedy), **found)


def demand_of(
    force: ArrayLike | None,
    moment: ArrayLike | MagneticBody | None,
    torque: ArrayLike | None,
    field: ArrayLike | None,
    gradient: ArrayLike | None,
    direction: ArrayLike | None = None,
    least: float = 0.0,
) -> Demand:
    """The demand for all given quantities at once; NaN leaves a component free.

    Parameters
    ----------
    force, torque
        (3,), N and N m, on a dipole or a body about its centre.
    moment
        (3,), A m^2, of the dipole, or the body; with a direction the magnitude of the moment, one number.
    field
        (3,), T.
    gradient
        (3, 3), T/m; its five independent entries count.
    direction
        (3,), direction of the flux density, with any magnitude, and of the dipole.
    least
        Least flux density along the direction, T.

    Raises
    ------
    InputError
        If nothing is demanded, or a shape does not fit.
    """
    if direction is not None:
        return _following(force, moment, torque, field, gradient, direction, least)
    if least != 0.0:
        raise _wrong("least_field", "given with a direction", least)
    values = _FREE.copy()
    on_load = force is not None or torque is not None
    body = moment if isinstance(moment, MagneticBody) else None
    every = _OF_BODY
    if body is None:
        wrench = _PER_MOMENT @ _moment(moment) if on_load else np.zeros((6, 12))
        every = np.concatenate([wrench, _OF_FIELD])
    if force is not None:
        values[:3] = _vector("force", force, (3,))
    if torque is not None:
        values[3:6] = _vector("torque", torque, (3,))
    if field is not None:
        values[6:9] = _vector("field", field, (3,))
    if gradient is not None:
        values[9:] = _vector("gradient", gradient, (3, 3))[_ENTRIES]
    if not on_load and field is None and gradient is None:
        raise _wrong("demand", "force, torque, field or gradient", None)
    asked = np.flatnonzero(values == values)
    if not asked.size:
        raise _wrong("demand", "at least one component that is not NaN", None)
    return Demand(tuple([_ROWS[k] for k in asked]), every[asked], values[asked], body)


def _following(
    force: ArrayLike | None,
    size: Any,
    torque: ArrayLike | None,
    field: ArrayLike | None,
    gradient: ArrayLike | None,
    direction: ArrayLike,
    least: float,
) -> Demand:
    """The demand on a magnet that follows the field: no flux density across its direction, and the force on it."""
    for name, given in (("torque", torque), ("field", field)):
        if given is not None:
            raise _wrong(
                name, "not asked for with a direction, which leaves no torque and frees the size of B", given
            )
    unit = _vector("direction", direction, (3,))
    length = float(np.linalg.norm(unit))
    if not length > 0.0:
        raise _wrong("direction", "finite and not zero", direction)
    unit = unit / length
    check_not_negative("currents_for", least_field=least)
    moment = None
    if force is not None:
        if (
            isinstance(size, MagneticBody)
            or np.ndim(size)
            or size is None
            or not 0.0 < float(size) < math.inf
        ):
            raise _wrong("moment", "with a direction one positive number, its size in A m^2", size)
        # A body, unlike a moment, includes the iron's reaction.
        moment = MagneticBody.dipole(float(size) * unit)
    across = np.linalg.svd(unit[None, :])[2][1:]
    names = ("B across 1", "B across 2")
    if force is None and gradient is None:
        return Demand(names, _rows_of_field(across, 12), np.zeros(2), None, unit, least)
    rest = demand_of(force, moment, None, None, gradient)
    return Demand(
        (*rest.names, *names),
        np.vstack([rest.selection, _rows_of_field(across, rest.selection.shape[1])]),
        np.concatenate([rest.values, np.zeros(2)]),
        rest.body,
        unit,
        least,
    )


def _rows_of_field(along: Array, width: int) -> Array:
    """Rows (r, width) of a selection: flux density along unit vectors (r, 3)."""
    return np.hstack([np.zeros((len(along), width - 12)), along, np.zeros((len(along), 9))])


def _moment(values: Any) -> Array:
    if values is None:
        raise _wrong("moment", "of the dipole on which force and torque act", None)
    moment = _vector("moment", values, (3,))
    x, y, z = moment.tolist()
    if math.isnan(x + y + z):
        raise _wrong("moment", "finite numbers of shape (3,)", values)
    if x == y == z == 0.0:
        raise _wrong("moment", "not zero: no field gives force or torque on it", values)
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
    return InputError.of(f"currents_for, {name}", must_hold, repr(received)[:80], remedy)
