"""Largest usual values of bench machines. A larger value often has a wrong unit and therefore causes a warning.

The same limits, on SI values, hold for parts from files and from Python.
"""

import warnings
from typing import Any

import numpy as np

from fieldmap.errors import UnusualValueWarning

LARGEST = {
    "mm": (3.0, "m", "lengths are in m"),
    "g": (10.0, "kg", "masses are in kg"),
    "A": (200.0, "A", "currents are in A"),
    "T": (10.0, "T", "flux densities and remanences are in T"),
}
"""By unit, the last part of a key: the largest usual value in SI units, the SI unit, the reminder in the warning."""


def warn_if_unusual(where: str, value: Any, unit: str, stacklevel: int = 2) -> None:
    """Warn of numbers that are larger than usual.

    Parameters
    ----------
    where
        The argument.
    value
        A number or numbers, SI; anything else passes.
    unit
        Last part of the quantity's key in files.
    stacklevel
        As of `warnings.warn` in the function that calls this one.

    Examples
    --------
    >>> import warnings
    >>> with warnings.catch_warnings(record=True) as told:
    ...     warnings.simplefilter("always")
    ...     warn_if_unusual("Payload.mass", 12.0, "g")
    >>> str(told[0].message).split(";")[:2]
    ['Payload.mass: 12 kg is unusual, more than 10 kg', ' masses are in kg']
    """
    if unit not in LARGEST or value is None:
        return
    usual, si, missed = LARGEST[unit]
    try:
        numbers = np.asarray(value)
    except ValueError:
        return  # not numbers: the device model reports them
    if unit == "T" and numbers.size > 3:
        return  # a B-H curve, which has rules of its own
    largest = float(np.abs(numbers).max(initial=0.0)) if numbers.dtype.kind in "iuf" else 0.0
    if usual < largest < np.inf:
        warnings.warn(
            f"{where}: {largest:g} {si} is unusual, more than {usual:g} {si}; {missed}; "
            "if it is meant, ignore fieldmap.errors.UnusualValueWarning",
            UnusualValueWarning,
            stacklevel=stacklevel + 1,
        )
