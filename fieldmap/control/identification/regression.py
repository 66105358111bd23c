"""Linear regression on past outputs and inputs, for one record or many at once.

The model in the delay operator is (1) of docs/theory/identification.md,

    y[n] = -a_1 y[n-1] - ... - a_p y[n-p] + b_0 u[n-d] + ... + b_z u[n-d-z] + error,

solved by the triangle of the columns beside y (QR): no normal equations, whose condition would be the square of one
that is large already for poles near q = 1. Arrays are (runs, samples).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_signal
from fieldmap.control.identification.estimate import Orders
from fieldmap.control.linear_models import TransferFunction, filter_response
from fieldmap.errors import InputError, Problem
from fieldmap.plain import Plain, plain_items
from fieldmap.records import tuple_line
from fieldmap.typing import Array

# Beyond this condition of the columns, each scaled to length one, rounding decides about the coefficients.
LARGEST_CONDITION = 1e12
# How many numbers columns are made of at once: 32 MB, with copies a few times as much.
_AT_ONCE = 4_000_000
# And how many LAPACK decomposes at once: too few for threads of its own, with which small matrices take up to a hundred
# times as long and round otherwise.
_BLOCK = 32_768


class Solution(NamedTuple):
    """coefficients (runs, parameters): a then b; triangle (runs, p, p) with triangle.T triangle = columns' products;
    squares (runs,): sum of squared errors; samples: how many errors; condition (runs,) of the scaled columns."""

    coefficients: Array
    triangle: Array
    squares: Array
    samples: int
    condition: Array

    def __repr__(self) -> str:
        return tuple_line(self)

    def to_dict(self) -> dict[str, Plain]:
        """The arrays by their names, as plain Python."""
        return plain_items(**self._asdict())


def columns_of(y: Array, u: Array, orders: Orders) -> Array:
    """Regressors (runs, samples - orders.first, parameters)."""
    n, first, delay = y.shape[-1], orders.first, orders.delay
    past = [-y[:, first - i : n - i] for i in range(1, orders.poles + 1)]
    driven = [u[:, first - delay - i : n - delay - i] for i in range(orders.zeros + 1)]
    return np.stack([*past, *driven], axis=-1)


def solve(y: Array, u: Array, orders: Orders, where: str) -> Solution:
    """Least squares over y and u (runs, samples). Raises InputError if the columns depend on each other."""
    samples = y.shape[1] - orders.first
    runs = max(1, _AT_ONCE // (samples * (orders.parameters + 1)))
    parts = [slice(at, at + runs) for at in range(0, len(y), runs)]
    r = np.concatenate(
        [_triangles(columns_of(y[part], u[part], orders), y[part, orders.first :]) for part in parts]
    )
    return solve_triangle(r, samples, where)


def solve_columns(columns: Array, target: Array, where: str) -> Solution:
    """Least squares of target (m,) over columns (m, p)."""
    return solve_triangle(_triangles(columns[None], target[None]), target.size, where)


def _triangles(columns: Array, targets: Array) -> Array:
    """Upper triangles r (runs, p + 1, p + 1) with r.T r the products of columns (runs, m, p) and, beside them, targets
    (runs, m); signs of rows are any."""
    both = np.concatenate([columns, targets[..., None]], axis=-1)
    runs, rows, width = both.shape
    blocks = 0
    while blocks != 1:
        # The triangle of triangles of blocks below each other is that of all; rows of zeros add nothing.
        blocks = -(-rows // max(4 * width, _BLOCK // width))
        each = max(-(-rows // blocks), width)
        padded = np.pad(both, ((0, 0), (0, blocks * each - rows), (0, 0)))
        rows = blocks * width
        triangles = np.asarray(np.linalg.qr(padded.reshape(-1, each, width), mode="r"))
        both = triangles.reshape(runs, rows, width)
    return both


def solve_triangle(r: Array, samples: int, where: str) -> Solution:
    """Least squares from the triangles (runs, p + 1, p + 1) of columns and target."""
    p = r.shape[-1] - 1
    length = np.linalg.norm(r[:, :p, :p], axis=1)
    if not (length > 0).all():
        raise _dependent(where, np.inf)
    triangle = r[:, :p, :p] / length[:, None, :]
    singular = np.linalg.svd(triangle, compute_uv=False)
    with np.errstate(divide="ignore"):
        condition = singular[:, 0] / singular[:, -1]
    if not (condition < LARGEST_CONDITION).all():
        raise _dependent(where, float(np.max(condition)))
    coefficients = np.linalg.solve(triangle, r[:, :p, p, None])[..., 0] / length
    return Solution(coefficients, r[:, :p, :p], r[:, p, p] ** 2, samples, condition)


def _dependent(where: str, condition: float) -> InputError:
    return InputError(
        Problem(
            where,
            "must be rich enough to tell the coefficients apart",
            f"regressors that depend on each other (condition {condition:.2g})",
            "excite the input more (a PRBS), ask for fewer poles and zeros, or, in closed loop without a reference "
            "signal, see the conditions in the theory page on identification",
        )
    )


def stable_denominators(a: Array) -> Array:
    """Polynomials (runs, p + 1) with the roots outside the unit circle reflected into it: same magnitude at every
    frequency up to a factor, and a filter that does not grow."""
    mirrored = []
    for polynomial in a:
        roots = np.roots(polynomial)
        outside = np.abs(roots) > 1.0
        roots[outside] = 1.0 / np.conj(roots[outside])
        mirrored.append(np.real(np.poly(roots)) if outside.any() else polynomial)
    return np.array([np.pad(m, (0, a.shape[1] - m.size)) for m in mirrored])


def filtered(b: Array, a: Array, signal: Array) -> Array:
    """Every run of signal (runs, samples) through its own b / a (in the delay operator), from rest."""
    return np.array([filter_response(bb, aa, s) for bb, aa, s in zip(b, a, signal, strict=True)])


def polynomials(coefficients: Array, orders: Orders) -> tuple[Array, Array]:
    """A with its leading 1 and B, of coefficients (runs, parameters)."""
    a = np.concatenate([np.ones((len(coefficients), 1)), coefficients[:, : orders.poles]], axis=1)
    return a, coefficients[:, orders.poles : orders.parameters]


def to_model(a: Array, b: Array, orders: Orders) -> TransferFunction:
    """The model in q: falling powers; dead time adds poles at 0."""
    return TransferFunction(b, np.concatenate([a, np.zeros(orders.dead_time)]))


def check_records(
    where: str, orders: Orders, minimum: int | None = None, **signals: ArrayLike
) -> list[Array]:
    """Finite records of one length as arrays (runs, samples), long enough for the orders; one input may drive all
    runs. Raises InputError."""
    arrays = [
        np.atleast_2d(check_signal(f"{where}({name})", values).astype(float, copy=False))
        for name, values in signals.items()
    ]
    runs, samples = max(x.shape[0] for x in arrays), arrays[0].shape[1]
    if any(x.ndim != 2 or x.shape[1] != samples or x.shape[0] not in (1, runs) for x in arrays):
        received = ", ".join(f"{name} {x.shape}" for name, x in zip(signals, arrays, strict=True))
        raise InputError(
            Problem(
                f"{where}({', '.join(signals)})",
                "must be records of one length, (samples,) or (runs, samples)",
                received,
                "cut them to the same samples",
            )
        )
    needed = orders.first + 2 * orders.parameters if minimum is None else minimum
    if samples < needed:
        raise InputError(
            Problem(
                f"{where}({', '.join(signals)})",
                f"must hold at least {needed} samples for {orders.parameters} coefficients",
                f"{samples} samples",
                "record longer, or ask for fewer poles and zeros",
            )
        )
    return [np.broadcast_to(x, (runs, samples)) for x in arrays]
