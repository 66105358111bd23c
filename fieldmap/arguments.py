"""Checks of arguments: finite, positive, of a given shape. A failed check raises InputError."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.errors import InputError, Problem
from fieldmap.records import Record
from fieldmap.typing import Array

LARGEST_NUMBER = 1e30
"""Largest size of a number in a file, in the unit of its key or column. Products of larger numbers may overflow."""


def finite_number(value: object) -> bool:
    """Whether a value is one finite real number and not a boolean.

    >>> finite_number(2), finite_number("initial"), finite_number([1.0]), finite_number(float("nan"))
    (True, False, False, False)
    >>> finite_number(True), finite_number(1j)
    (False, False)
    """
    try:
        one = np.asarray(value)
        return one.ndim == 0 and one.dtype.kind in "iuf" and bool(np.isfinite(one))
    except (TypeError, ValueError):
        return False


def check(holds: bool, where: str, must_hold: str, received: object, remedy: str) -> None:
    """Raises InputError with these four parts unless it holds.

    >>> check(2 > 3, "f(x)", "must be above 3", 2, "give more")
    Traceback (most recent call last):
    ...
    fieldmap.errors.InputError: f(x): must be above 3; received 2; give more
    """
    if not holds:
        raise InputError.of(where, must_hold, str(received), remedy)


def _check_each(
    where: str, numbers: Mapping[str, Any], fits: Callable[[Any], bool], must_hold: str, remedy: str
) -> None:
    raise_all(
        Problem(f"{where}({name})", must_hold, f"{value!r}", remedy.format(name))
        for name, value in numbers.items()
        if not fits(value)
    )


def check_numbers(where: str, **numbers: float) -> None:
    """Raise InputError that lists every number that is not finite."""
    _check_each(where, numbers, finite_number, "must be a finite number", "give its value in SI units")


def check_positive(where: str, **numbers: float) -> None:
    """Raise InputError that lists every number that is not finite and above zero."""
    must_hold = "must be a finite number above 0"
    _check_each(where, numbers, lambda v: finite_number(v) and v > 0, must_hold, "give a positive {}")


def check_not_negative(where: str, **numbers: float) -> None:
    """Raise InputError that lists every number that is not finite or is below zero."""
    must_hold = "must be a finite number, 0 or more"
    _check_each(where, numbers, lambda v: finite_number(v) and v >= 0, must_hold, "give {} >= 0")


def check_count(where: str, **numbers: int) -> None:
    """Raise InputError that lists every number that is not whole or is below one."""
    must_hold = "must be a whole number, 1 or more"
    _check_each(
        where, numbers, lambda v: isinstance(v, (int, np.integer)) and v >= 1, must_hold, "give {} >= 1"
    )


def check_choice(where: str, value: str, choices: Iterable[str]) -> str:
    """Return `value` if it is one of the choices; otherwise raise InputError."""
    allowed = list(choices)
    check(value in allowed, where, f"must be one of {', '.join(allowed)}", repr(value), "choose one of them")
    return value


def check_names(where: str, names: Iterable[str], must_hold: str, known: Container[str], remedy: str) -> None:
    """Raise InputError that lists every name that is not in `known`."""
    raise_all(Problem(where, must_hold, repr(name), remedy) for name in names if name not in known)


def check_ordered(where: str, lower: float, upper: float) -> None:
    """Raise InputError unless lower < upper. Either may be infinite; NaN fails."""
    received, remedy = f"{lower!r}, {upper!r}", "give the lower limit first"
    check(lower < upper, f"{where}(lower, upper)", "must rise", received, remedy)


def check_signal(where: str, values: ArrayLike, columns: int | None = None) -> Array:
    """Return a finite signal as an array of floats, of shape (..., columns) if `columns` is given."""
    signal = np.asarray(values, dtype=float)
    if columns is not None:
        fits, must = signal.shape[-1:] == (columns,), f"must have {columns} numbers in its last axis"
        check(fits, where, must, f"shape {signal.shape}", "reshape it")
    bad = np.flatnonzero(~np.isfinite(signal.ravel()))
    if bad.size:
        first = f"{signal.ravel()[bad[0]]} at entry {bad[0]} ({bad.size} such)"
        check(False, where, "must be finite everywhere", first, "drop or mend these samples first")
    return signal


def check_record(where: str, least: int, **signals: ArrayLike) -> tuple[Array, Array]:
    """Return rising times (n,) and values (n,), n >= least. The names of the two keywords appear in the message."""
    time, values = (np.atleast_1d(check_signal(f"{where}({name})", given)) for name, given in signals.items())
    rises = time.ndim == 1 and time.shape == values.shape and bool((np.diff(time) > 0).all())
    must, received = (
        f"must be {least} or more rising times and as many values",
        f"{time.shape}, {values.shape}",
    )
    remedy = "give one signal on a grid of times"
    check(rises and time.size >= least, f"{where}({', '.join(signals)})", must, f"shapes {received}", remedy)
    return time, values


def check_matrix(where: str, values: ArrayLike, shape: tuple[int | None, int | None]) -> Array:
    """Return a finite matrix. None in `shape` allows any size; a single number becomes a matrix (1, 1)."""
    matrix = np.asarray(values, dtype=float)
    matrix = matrix.reshape(1, 1) if matrix.ndim == 0 else matrix
    fits = matrix.ndim == 2 and all(s is None or s == n for s, n in zip(shape, matrix.shape, strict=True))
    must = f"must be a matrix, {' x '.join('any' if s is None else str(s) for s in shape)}"
    check(fits and matrix.size > 0, where, must, f"shape {matrix.shape}", "reshape or transpose it")
    return check_signal(where, matrix)


def raise_all(problems: Iterable[Problem], error: type[InputError] = InputError) -> None:
    """Raises the error with all problems, if there are any."""
    found = tuple(problems)
    if found:
        raise error(*found)


_OF_VECTORS, _VECTORS = "must be numbers of shape (3,) or (n, 3)", "give x, y, z in SI units"


def checked_vectors(name: str, values: ArrayLike) -> tuple[Array, bool]:
    """`values` as (n, 3), and whether a single vector (3,) was given. Raises InputError for other shapes."""
    try:
        # Writeable, because numba would compile its kernels again for a read-only array.
        array = np.require(values, np.float64, ["C", "W"])
    except (TypeError, ValueError):
        remedy = remedy_of_moment(values, _VECTORS)
        raise InputError.of(name, _OF_VECTORS, repr(values)[:80], remedy) from None
    if array.ndim == 1 and array.size == 3:
        return array.reshape(1, 3), True
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError.of(name, _OF_VECTORS, f"shape {array.shape}", _VECTORS)
    return array, False


def check_vector(where: str, value: ArrayLike, remedy: str) -> Array:
    """Return three finite numbers as a new array (3,). Raises InputError for anything else."""
    must_hold = "must be three finite numbers"
    try:
        given = np.asarray(value)
        fits = given.shape == (3,) and given.dtype.kind in "iuf" and bool(np.isfinite(given).all())
        received = repr(given.tolist()) if given.size <= 6 else f"shape {given.shape}"
    except (TypeError, ValueError):
        fits, received = False, repr(value)[:80]
    check(fits, where, must_hold, received, remedy_of_moment(value, remedy))
    return np.array(given, dtype=np.float64)


def remedy_of_moment(value: object, remedy: str) -> str:
    """The remedy for a wrong moment: `remedy`, or another one if `value` is a data object, such as a payload."""
    if not isinstance(value, Record):
        return remedy
    return "of a payload give fieldmap.lookup.magnetic_body(payload), or payload.moment_vector"
