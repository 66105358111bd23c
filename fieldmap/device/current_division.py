"""How one lift signal and two direction signals become the currents of six coils: thesis (6-2), (6-3)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_positive, check_signal
from fieldmap.errors import InputError, Problem
from fieldmap.typing import Array

# Coils 1..6: the side of the axis on which a coil lies; 2 and 5 lie on the x axis and take what the others leave.
_X_SIDE = np.array([-1.0, -1.0, -1.0, 1.0, 1.0, 1.0])
_Y_SIDE = np.array([-1.0, 0.0, 1.0, -1.0, 0.0, 1.0])
_MIDDLE = _Y_SIDE == 0.0


@dataclass(frozen=True)
class DivisionSignals:
    """What `undivide_currents` finds: u, x and y signals, and by how much the given currents differ from their
    division, relative to u."""

    u: Array
    x: Array
    y: Array
    mismatch: Array


def divide_currents(u: ArrayLike, x: ArrayLike, y: ArrayLike, n: float = 1.0) -> Array:
    """Signals (..., 6) of coils 1..6 from the lift signal u per coil and the direction signals x and y.

    (6-2), (6-3): u_sum = 6 u; coils 1, 3, 4, 6 get u (1 -+ x)(1 -+ y); coils 2 and 5 share what is left as (1 -+ n x).
    The sum is 6 u whatever x and y are, the sum of coils 2 and 5 is 2 u. u, x, y broadcast against each other; the
    unit of u is that of the result. Raises InputError for numbers that are not finite.

    >>> divide_currents(1.0, 0.2, 0.1, n=1.25).round(3).tolist()
    [0.72, 0.75, 0.88, 1.08, 1.25, 1.32]
    """
    check_positive("divide_currents", n=n)
    signals = (check_signal(f"divide_currents({name})", v) for name, v in (("u", u), ("x", x), ("y", y)))
    u, x, y = (values[..., None] for values in np.broadcast_arrays(*signals))
    corners = u * (1.0 + _X_SIDE * x) * (1.0 + _Y_SIDE * y)
    left = 6.0 * u - np.where(_MIDDLE, 0.0, corners).sum(axis=-1, keepdims=True)
    return np.where(_MIDDLE, 0.5 * left * (1.0 + n * _X_SIDE * x), corners)


def undivide_currents(currents: ArrayLike, n: float = 1.0) -> DivisionSignals:
    """Inverse of `divide_currents`: u, x, y of currents (..., 6), exact if they are such a division.

    u is the mean, x the projection on what x does at y = 0, y what the corners say; of currents that are no division,
    `mismatch` says by how much. Raises InputError for currents that are not finite, or whose mean is zero.

    >>> s = undivide_currents([0.72, 0.75, 0.88, 1.08, 1.25, 1.32], n=1.25)
    >>> print(round(float(s.x), 9), round(float(s.y), 9), bool(s.mismatch < 1e-12))
    0.2 0.1 True
    """
    check_positive("undivide_currents", n=n)
    given = check_signal("undivide_currents(currents)", currents, columns=6)
    u = given.mean(axis=-1)
    if np.any(u == 0.0):
        raise InputError(
            Problem(
                "undivide_currents(currents)", "must have a mean other than 0", "mean 0", "u is that mean"
            )
        )
    share = given / u[..., None]
    # At y = 0 a corner has the share 1 + s x and a middle coil 1 + n s x; sums over y cancel what y adds.
    slope = np.where(_MIDDLE, n, 1.0) * _X_SIDE
    x = ((share - 1.0) * slope).sum(axis=-1) / (slope**2).sum()
    y = (share * _Y_SIDE).sum(axis=-1) / 4.0
    divided = divide_currents(u, x, y, n)
    return DivisionSignals(u, x, y, np.abs(divided - given).max(axis=-1) / np.abs(u))


def division_slopes(u: float, x: float, y: float, n: float = 1.0) -> Array:
    """Derivative (6, 3) of the coils' signals by (u, x, y): with the force per ampere of each coil, the forces that
    lift and direction signals make.

    >>> division_slopes(1.5, 0.0, 0.0, n=1.25)[:, 1].tolist()
    [-1.5, -1.875, -1.5, 1.5, 1.875, 1.5]
    """
    by_u = divide_currents(1.0, x, y, n)
    corner_x, corner_y = 1.0 + _X_SIDE * x, 1.0 + _Y_SIDE * y
    by_x = u * np.where(_MIDDLE, n * _X_SIDE, _X_SIDE * corner_y)
    by_y = u * np.where(_MIDDLE, 0.0, _Y_SIDE * corner_x)
    return np.column_stack([by_u, by_x, by_y])
