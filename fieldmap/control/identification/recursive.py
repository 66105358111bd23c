"""Recursive least squares, an estimate after every sample: Ljung, System Identification, 2nd ed., 11.2 and 11.5."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_positive
from fieldmap.control.identification.estimate import Orders
from fieldmap.control.identification.regression import check_records, columns_of, polynomials, to_model
from fieldmap.control.linear_models import TransferFunction
from fieldmap.errors import InputError, Problem
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
    y, u = check_records(where, orders, outputs=outputs, inputs=inputs)
    p = orders.parameters + noise_order
    theta, covariance, past = np.zeros(p), start_variance * np.eye(p), np.zeros(noise_order)
    history = np.zeros((y.shape[1], p))
    for n, known in enumerate(columns_of(y, u, orders)[0], orders.first):
        row = np.concatenate([known, past])
        gain = covariance @ row
        scale = forgetting + row @ gain
        theta = theta + gain * (y[0, n] - row @ theta) / scale
        covariance = (covariance - np.outer(gain, gain) / scale) / forgetting
        # Errors after the update: extended least squares.
        past = np.concatenate([[y[0, n] - row @ theta], past])[:noise_order]
        history[n] = theta
    a, b = polynomials(history[-1:], orders)
    return RecursiveRun(history, to_model(a[0], b[0], orders))
