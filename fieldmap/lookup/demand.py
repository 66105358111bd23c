"""The demand of an inverse: the force, torque, flux density and gradient that currents shall give at a place."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import remedy_of_moment
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
    (force, torque, flux density, gradient row by row).
    """

    names: tuple[str, ...]
    selection: Array
    values: Array
    body: MagneticBody | None = None

    @property
    def on_soft_iron(self) -> bool:
        """Whether soft iron is in the body, so that its force is no linear function of the field."""
        return self.body is not None and bool(self.body.soft)

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
        """The error for this demand; note: more on it; found: attributes of the error."""
        received = self.text(self.values) + note
        return Infeasible(Problem("currents_for", must_hold, received, remedy), **found)


def demand_of(
    force: ArrayLike | None,
    moment: ArrayLike | MagneticBody | None,
    torque: ArrayLike | None,
    field: ArrayLike | None,
    gradient: ArrayLike | None,
) -> Demand:
    """All that is asked for at once; NaN leaves a component free.

    Parameters
    ----------
    force, torque
        (3,), N and N m, on a dipole or a body about its centre.
    moment
        (3,), A m^2, of the dipole, or the body.
    field
        (3,), T.
    gradient
        (3, 3), T/m; its five independent entries count.

    Raises
    ------
    InputError
        Where nothing is asked for, or a shape does not fit.
    """
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
