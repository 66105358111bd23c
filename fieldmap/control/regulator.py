"""Optimal state feedback on estimated states, with an integrator and a term that carries the weight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fieldmap.arguments import (
    check_choice,
    check_matrix,
    check_numbers,
    check_ordered,
    check_positive,
    check_signal,
)
from fieldmap.control.sampled_optimum import Estimator
from fieldmap.errors import InputError, Problem
from fieldmap.records import Record
from fieldmap.typing import Array

ESTIMATES = ("predicted", "filtered", "delayed")
EQUILIBRIUM_AT = ("reference", "measured")


@dataclass(frozen=True, eq=False, repr=False)
class Regulator(Record):
    """u[n] = equilibrium output - k (x1, x2, ..., x_integral) / divisor: docs/theory/control.md (8), (9).

    k (n + 1,): feedback of the n states of the estimator, last of the integral of the deviation from the reference.
    estimator: from `kalmd`, one input and one output; it is fed with the deviations from the equilibrium. Ts: sampling
    time, s. equilibrium: (intercept, slope) of the output that holds the body at a position. equilibrium_at: whether
    that is taken at the "reference" or the "measured" position. estimate: which states are fed back: "predicted"
    x[n|n-1], "filtered" x[n|n], "delayed" x[n-1|n-1]. divisor: of the feedback. lower, upper: limits of the output.
    """

    k: Array
    estimator: Estimator
    Ts: float
    equilibrium: tuple[float, float] = (0.0, 0.0)
    equilibrium_at: str = "reference"
    estimate: str = "filtered"
    divisor: float = 1.0
    lower: float = -np.inf
    upper: float = np.inf

    def __post_init__(self) -> None:
        order = np.atleast_2d(self.estimator.A_est).shape[0]
        for name, matrix, shape in zip(
            Estimator._fields,
            self.estimator,
            ((order, order), (order, 2), (1 + order, order), (1 + order, 2)),
            strict=True,
        ):
            check_matrix(f"Regulator(estimator.{name})", matrix, shape)
        gain = np.ravel(check_signal("Regulator(k)", self.k))
        if gain.size != order + 1:
            raise InputError(
                Problem(
                    "Regulator(k)",
                    f"must have one gain for each of {order} states and one for the integral",
                    f"{gain.size} gains",
                    "design it with lqrd on with_output_integral(A, B, C); give 0 for no integral",
                )
            )
        if np.any(self.estimator.D_est[:, 0]):
            raise InputError(
                Problem(
                    "Regulator(estimator)",
                    "must not need this sample's output to know this sample's states (D = 0)",
                    "a first column of D_est that is not zero",
                    "take a strictly proper plant",
                )
            )
        object.__setattr__(self, "k", gain)
        check_positive("Regulator", Ts=self.Ts)
        check_numbers(
            "Regulator", intercept=self.equilibrium[0], slope=self.equilibrium[1], divisor=self.divisor
        )
        check_ordered("Regulator", self.lower, self.upper)
        check_choice("Regulator(estimate)", self.estimate, ESTIMATES)
        check_choice("Regulator(equilibrium_at)", self.equilibrium_at, EQUILIBRIUM_AT)
        if self.divisor == 0:
            check_positive("Regulator", divisor=self.divisor)

    @property
    def matrices(self) -> tuple[Array, Array, Array, Array]:
        """Of the prediction a (n, n) and b (n, 2), whose inputs are control, then output; of the filtered states cx
        (n, n) and dx (n,)."""
        A, B, C, D = (np.asarray(matrix, dtype=float) for matrix in self.estimator)
        return A, B, C[1:], D[1:, 1]
