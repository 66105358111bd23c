"""Recursive least squares: an estimate after every sample, in compiled code."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_positive
from fieldmap.control.identification.estimate import Orders
from fieldmap.control.identification.regression import check_records, polynomials, to_model
from fieldmap.control.linear_models import TransferFunction
from fieldmap.errors import InputError, Problem
from fieldmap.kernels.control.regression import Structure, recursive
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class RecursiveRun(Record):
    """history (n, p): coefficients after each sample: the denominator's after its 1, the numerator's, C's after its 1.
    model: after the last sample."""

    history: Array
    model: TransferFunction


def recursive_least_squares(
    outputs: ArrayLike,
    inputs: ArrayLike,
    orders: Orders,
    *,
    noise_order: int = 0,
    forgetting: float = 1.0,
    start_variance: float = 1e6,
) -> RecursiveRun:
    """Recursive least squares; with noise_order > 0 recursive extended least squares (ARMAX): (10), (11).

    forgetting: weight of a sample that is one sample old relative to the newest, in (0, 1]; it looks back on 1 / (1 -
    forgetting) samples, which should last several times as long as the plant's slowest pole. start_variance: of the
    coefficients, which start at 0. Without forgetting and noise terms the last estimate is that of `least_squares`, up
    to the start. Raises InputError.
    """
    where = "recursive_least_squares"
    check_positive(where, start_variance=start_variance, forgetting=forgetting)
    if forgetting > 1.0 or noise_order < 0:
        raise InputError(
            Problem(
                f"{where}(forgetting, noise_order)",
                "must lie in (0, 1] and be 0 or more",
                f"{forgetting!r}, {noise_order!r}",
                "0.99 or more is usual; 1 forgets nothing",
            )
        )
    y, u = (x[0] for x in check_records(where, orders, outputs=outputs, inputs=inputs))
    p = orders.parameters + noise_order
    structure = Structure(orders.poles, orders.zeros + 1, orders.delay, noise_order, orders.first)
    history = np.empty((y.size, p))
    recursive(
        np.ascontiguousarray(y),
        np.ascontiguousarray(u),
        structure,
        forgetting,
        np.zeros(p),
        start_variance * np.eye(p),
        history,
    )
    a, b = polynomials(history[-1:], orders)
    return RecursiveRun(history, to_model(a[0], b[0], orders))
