"""What the functions of this room ask of their arguments."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.errors import InputError, Problem

Array = NDArray[np.float64]


def check_numbers(where: str, **numbers: float) -> None:
    """Every number finite; raises InputError with all that are not."""
    _raise(
        Problem(f"{where}({name})", "must be a finite number", f"{value!r}", "give its value in SI units")
        for name, value in numbers.items()
        if not np.isfinite(value)
    )


def check_positive(where: str, **numbers: float) -> None:
    """Every number finite and above zero; raises InputError with all that are not."""
    _raise(
        Problem(
            f"{where}({name})", "must be a finite number above 0", f"{value!r}", f"give a positive {name}"
        )
        for name, value in numbers.items()
        if not (np.isfinite(value) and value > 0)
    )


def check_not_negative(where: str, **numbers: float) -> None:
    """Every number finite and at least zero; raises InputError with all that are not."""
    _raise(
        Problem(f"{where}({name})", "must be a finite number, 0 or more", f"{value!r}", f"give {name} >= 0")
        for name, value in numbers.items()
        if not (np.isfinite(value) and value >= 0)
    )


def check_signal(where: str, values: ArrayLike, columns: int | None = None) -> Array:
    """A finite signal as an array of floats; with `columns`, of shape (..., columns)."""
    signal = np.asarray(values, dtype=float)
    if columns is not None and (signal.ndim == 0 or signal.shape[-1] != columns):
        raise InputError(
            Problem(
                where, f"must have {columns} numbers in its last axis", f"shape {signal.shape}", "reshape it"
            )
        )
    bad = np.flatnonzero(~np.isfinite(signal.ravel()))
    if bad.size:
        raise InputError(
            Problem(
                where,
                "must be finite everywhere",
                f"{signal.ravel()[bad[0]]} at entry {bad[0]} ({bad.size} such)",
                "drop or mend these samples first",
            )
        )
    return signal


def _raise(problems: Iterable[Problem]) -> None:
    found = tuple(problems)
    if found:
        raise InputError(*found)
