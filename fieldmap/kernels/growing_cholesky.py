"""Cholesky factor R, upper, of a symmetric matrix R^T R; rows and columns are added and removed one at a time.

Each change costs the square of the size, where a new factor costs its cube. A row is removed by Givens rotations (G. H.
Golub, C. F. Van Loan, Matrix Computations, 4th ed. 2013, 6.5.3).
"""

import math
from typing import Any

from fieldmap.kernels.compilation import njit

_FAST: dict[str, Any] = {"nogil": True, "fastmath": {"contract", "reassoc", "nsz", "arcp"}}


@njit(**_FAST, forceinline=True)
def solve_lower(factor, count, right):
    """Overwrite right (count,) with R^-T right."""
    for k in range(count):
        right[k] /= factor[k, k]
        value, row = right[k], factor[k]
        for j in range(k + 1, count):
            right[j] -= value * row[j]


@njit(**_FAST)
def solve_upper(factor, count, right):
    """Overwrite right (count,) with R^-1 right."""
    for k in range(count - 1, -1, -1):
        row, total = factor[k], 0.0
        for j in range(k + 1, count):
            total += row[j] * right[j]
        right[k] = (right[k] - total) / row[k]


@njit(**_FAST)
def append(factor, count, across, own):
    """Add a row and column after the first `count`: its entries across (count,), overwritten, and own on the diagonal.
    Returns whether the matrix stays positive definite; otherwise the factor is not changed."""
    solve_lower(factor, count, across)
    rest = own
    for k in range(count):
        rest -= across[k] * across[k]
    if not rest > 1e-13 * own:
        return False
    for k in range(count):
        factor[k, count] = across[k]
    factor[count, count] = math.sqrt(rest)
    return True


@njit(**_FAST)
def remove(factor, count, number):
    """Remove row and column `number` from the first `count`."""
    for k in range(number):
        row = factor[k]
        for j in range(number, count - 1):
            row[j] = row[j + 1]
    for k in range(number, count - 1):
        upper, lower = factor[k], factor[k + 1]
        # Row k moves left; row k + 1 does so only after the rotation has used its entry below the new diagonal.
        for j in range(k, count - 1):
            upper[j] = upper[j + 1]
        size = math.hypot(upper[k], lower[k + 1])
        c, s = upper[k] / size, lower[k + 1] / size
        upper[k] = size
        for j in range(k + 1, count - 1):
            one, other = upper[j], lower[j + 1]
            upper[j] = c * one + s * other
            lower[j + 1] = c * other - s * one
