"""What is asked of the currents at a place, as rows on flux density and gradient."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.errors import InputError, Problem
from fieldmap.lookup.actuation import FIELD_ROWS, FORCE_ROWS, GRADIENT_ROWS, TORQUE_ROWS
from fieldmap.typing import Array

_UNITS = {"F": "N", "T": "N m", "B": "T", "d": "T/m"}


@dataclass(frozen=True, eq=False)
class Demand:
    """selection (r, 12) @ (B, gradient row by row) must be values (r,); names of the rows."""

    names: tuple[str, ...]
    selection: Array
    values: Array

    def text(self, values: Array) -> str:
        """Values with names and units, zeros left out."""
        size = np.abs(values).max(initial=0.0)
        parts = [
            f"{name} = {value:.6g} {_UNITS[name[0]]}"
            for name, value in zip(self.names, values, strict=True)
            if abs(value) > 1e-9 * size
        ]
        return ", ".join(parts) or "zero"


def demand_of(
    force: ArrayLike | None,
    moment: ArrayLike | None,
    torque: ArrayLike | None,
    field: ArrayLike | None,
    gradient: ArrayLike | None,
) -> Demand:
    """Rows of all that is asked for at once; NaN leaves a component free.

    Raises InputError if nothing is asked for, or a shape does not fit.
    """
    names: tuple[str, ...] = ()
    parts, values = [], []
    if force is not None or torque is not None:
        if moment is None:
            raise _wrong("moment", "of the dipole on which force and torque act", None)
        mx, my, mz = _moment(moment)
    if force is not None:
        names, rows = names + FORCE_ROWS, np.zeros((3, 12))
        for j in range(3):
            rows[j, 3 + j], rows[j, 6 + j], rows[j, 9 + j] = mx, my, mz
        parts.append(rows)
        values.append(_vector("force", force, (3,)))
    if torque is not None:
        names, rows = names + TORQUE_ROWS, np.zeros((3, 12))
        rows[0, 1], rows[0, 2], rows[1, 0], rows[1, 2], rows[2, 0], rows[2, 1] = -mz, my, mz, -mx, -my, mx
        parts.append(rows)
        values.append(_vector("torque", torque, (3,)))
    if field is not None:
        names += FIELD_ROWS
        parts.append(np.eye(3, 12))
        values.append(_vector("field", field, (3,)))
    if gradient is not None:
        names += GRADIENT_ROWS
        parts.append(np.eye(12)[[3, 4, 5, 7, 8]])
        values.append(_vector("gradient", gradient, (3, 3))[[0, 0, 0, 1, 1], [0, 1, 2, 1, 2]])
    if not parts:
        raise _wrong("demand", "force, torque, field or gradient", None)
    selection, wanted = (
        (parts[0], values[0]) if len(parts) == 1 else (np.concatenate(parts), np.concatenate(values))
    )
    asked = wanted == wanted
    if asked.all():
        return Demand(names, selection, wanted)
    if not asked.any():
        raise _wrong("demand", "at least one component that is not NaN", None)
    kept = tuple(name for name, is_asked in zip(names, asked, strict=True) if is_asked)
    return Demand(kept, np.ascontiguousarray(selection[asked]), wanted[asked])


def _moment(values: ArrayLike) -> Array:
    moment = _vector("moment", values, (3,))
    if np.isnan(moment).any():
        raise _wrong("moment", "finite numbers of shape (3,)", values)
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
    return InputError(
        Problem(f"currents_for, {name}", must_hold, repr(received)[:80], "give arrays in SI units")
    )
