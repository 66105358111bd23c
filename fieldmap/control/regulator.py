"""Optimal state feedback on estimated states, with an integrator and a term that carries the weight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

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
from fieldmap.kernels.control.regulator import EstimatorRows, RegulatorSettings, regulator_run, regulator_step
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
    def matrices(self) -> EstimatorRows:
        """A_est, B_est, and the rows of C_est and of D_est's last column that give the filtered states."""
        A, B, C, D = (np.ascontiguousarray(matrix, dtype=float) for matrix in self.estimator)
        return EstimatorRows(A, B, np.ascontiguousarray(C[1:]), np.ascontiguousarray(D[1:, 1]))

    @property
    def settings(self) -> RegulatorSettings:
        """The other numbers."""
        which = float(ESTIMATES.index(self.estimate))
        measured = float(EQUILIBRIUM_AT.index(self.equilibrium_at))
        numbers = (self.Ts, self.divisor, self.lower, self.upper, which, *self.equilibrium, measured)
        return RegulatorSettings(*(float(number) for number in numbers))


class RunningRegulator:
    """A regulator with its memory, for a loop of your own: one call a sample."""

    def __init__(self, regulator: Regulator) -> None:
        self.regulator = regulator
        self._matrices, self._settings = regulator.matrices, regulator.settings
        self.reset()

    def reset(self) -> None:
        """Forget the past: all states at the equilibrium."""
        order = self._matrices.a.shape[0]
        self._state, self._filtered = np.zeros(2 * order + 1), np.zeros(order)

    @property
    def states(self) -> Array:
        """The filtered states x[n|n] of the last sample."""
        return self._filtered.copy()

    def step(self, reference: float, measured: float) -> float:
        """The output at this sample. Raises InputError for numbers that are not finite, before they do harm."""
        check_numbers("RunningRegulator.step", reference=reference, measured=measured)
        return float(
            regulator_step(
                reference,
                measured,
                self._matrices,
                self.regulator.k,
                self._settings,
                self._state,
                self._filtered,
            )
        )


def run_regulator(regulator: Regulator, reference: ArrayLike, measured: ArrayLike) -> tuple[Array, Array]:
    """Outputs (n,) and filtered states (n, order) of a regulator that starts at the equilibrium; open loop.

    measured: (n,); reference: (n,) or one number. Raises InputError for signals that are not finite or do not fit.
    """
    seen = np.atleast_1d(check_signal("run_regulator(measured)", measured))
    target = np.array(np.broadcast_to(check_signal("run_regulator(reference)", reference), seen.shape))
    matrices = regulator.matrices
    order = matrices.a.shape[0]
    outputs, states = np.empty(seen.size), np.empty((seen.size, order))
    state = np.zeros(2 * order + 1)
    regulator_run(target, seen, matrices, regulator.k, regulator.settings, state, outputs, states)
    return outputs, states
