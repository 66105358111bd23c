"""Currents of least power within limits that meet a linear demand: fieldmap/core/least_power.h."""

from typing import Any

from numpy.typing import NDArray

from fieldmap.core.library import LIBRARY
from fieldmap.typing import Array

FOUND: int = LIBRARY.POWER_FOUND
OUT_OF_RANGE: int = LIBRARY.POWER_OUT_OF_RANGE
BEYOND_LIMITS: int = LIBRARY.POWER_BEYOND_LIMITS
NO_END: int = LIBRARY.POWER_NO_END
"""Status of `least_power`: found; no currents meet the demand; none within the limits do; the method did not end."""


def least_power(
    matrix: Array,
    demand: Array,
    lower: Array,
    upper: Array,
    weight: Array,
    currents: Array,
    active: NDArray[Any],
) -> int:
    """Fill currents (n,), and active (n,), int64, the limits that they lie on: -1 lower, 1 upper. Returns the status.

    matrix (m, n), demand (m,), lower, upper, weight (n,), weight > 0; limits may be infinite. If the status is
    BEYOND_LIMITS, active marks the limits that together exclude the demand, and currents are those without limits.
    """
    return int(LIBRARY.least_power(matrix, demand, lower, upper, weight, currents, active))


def non_negative_least_squares(columns: Array, target: Array, u: Array) -> bool:
    """Fill u (n,) >= 0 of min |sum_j u_j columns[j] - target|: NNLS of Lawson and Hanson; columns (n, size) of length
    1. Returns False if the method does not end."""
    return bool(LIBRARY.non_negative_least_squares(columns, target, u))
