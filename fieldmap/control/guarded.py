"""Arrays for functions whose indices nobody checks: what is written beside them is found, and does no harm there."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.typing import Array

ROOM = 256
"""Numbers before and behind an array that are watched."""
# A NaN with bits that no arithmetic makes: what is read beside an array is no number, and what is written shows.
_MARK = np.uint64(0x7FF8_5A5A_C3C3_1E1E)


def guarded(values: ArrayLike) -> Array:
    """A copy (n,) of values with watched room before and behind it, contiguous."""
    given = np.asarray(values, float).ravel()
    whole = np.empty(len(given) + 2 * ROOM)
    whole.view(np.uint64)[:] = _MARK
    inside = whole[ROOM : ROOM + len(given)]
    inside[:] = given
    return inside


def overrun(inside: Array) -> int | None:
    """The index, nearest to it, beside an array of `guarded` at which something was written; None where nothing was."""
    whole: NDArray[np.float64] = inside.base  # type: ignore[assignment]
    changed = np.flatnonzero(whole.view(np.uint64) != _MARK) - ROOM
    beside = changed[(changed < 0) | (changed >= len(inside))]
    return int(beside[np.argmin(np.abs(beside - 0.5 * len(inside)))]) if len(beside) else None
