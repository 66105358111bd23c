"""The structure of a model that is to be identified."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.arguments import check_signal
from fieldmap.control.linear_models import TransferFunction, filter_response, steady_gain
from fieldmap.errors import InputError, NotConverged, Problem
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True)
class Orders(Record):
    """How many poles and zeros the sampled model has, and how many samples of dead time on top.

    (b_0 q^zeros + ...) / (q^poles + ...) q^-dead_time: such as poles=4, zeros=3. The output follows the input by
    `delay` = poles - zeros + dead_time samples; sampled plants have one or more. Raises InputError for numbers that are
    not whole, or more zeros than poles.
    """

    poles: int
    zeros: int
    dead_time: int = 0

    def __post_init__(self) -> None:
        values = (self.poles, self.zeros, self.dead_time)
        if (
            any(isinstance(v, bool) or v != int(v) or v < 0 for v in values)
            or self.zeros > self.poles
            or not self.poles
        ):
            raise InputError(
                Problem(
                    "Orders",
                    "must be whole numbers with poles >= 1 and 0 <= zeros <= poles",
                    f"poles {self.poles}, zeros {self.zeros}, dead time {self.dead_time}",
                    "a plant behind a zero-order hold has at least one pole more than zeros",
                )
            )

    @property
    def delay(self) -> int:
        """Samples from the input to its first effect on the output."""
        return self.poles - self.zeros + self.dead_time

    @property
    def parameters(self) -> int:
        """Number of coefficients that are estimated."""
        return self.poles + self.zeros + 1

    @property
    def first(self) -> int:
        """Index of the first sample whose whole past is in the record."""
        return max(self.poles, self.delay + self.zeros)


def not_settled(
    where: str, tolerance: float, iterations: int, changes: Sequence[float], remedy: str
) -> NotConverged:
    """What an iteration ends with whose coefficients go on changing; changes: as shares of the largest."""
    must = f"must settle to {tolerance:g} within {iterations} iterations"
    received = f"a change of {changes[-1]:.2g} of the largest coefficient"
    return NotConverged(Problem(where, must, received, remedy), residuals=tuple(changes))


@dataclass(frozen=True, eq=False, repr=False)
class Estimate(Record):
    """An identified sampled model with its report.

    model: numerator and denominator in q. Ts: sampling time, s. method: which estimator. covariance (p, p): of the
    denominator's coefficients after the leading 1, then the numerator's; it holds if `assumptions` hold. noise: C(q)
    of (1), falling powers ([1] unless it was estimated). residual_rms: of the last equation's errors, in units of the
    output. condition: of the scaled regressors. iterations: how many. assumptions: under which the estimate is
    consistent.
    """

    model: TransferFunction
    Ts: float
    method: str
    covariance: Array
    noise: Array
    residual_rms: float
    condition: float
    iterations: int
    assumptions: tuple[str, ...]

    @property
    def poles(self) -> NDArray[Any]:
        """Poles in q, by falling magnitude."""
        return by_magnitude(self.model.poles)

    @property
    def zeros(self) -> NDArray[Any]:
        """Zeros in q, by falling magnitude."""
        return by_magnitude(self.model.zeros)

    @property
    def gain(self) -> float:
        """Factor in front of prod(q - zeros) / prod(q - poles)."""
        return float(self.model.numerator[0])

    @property
    def steady_gain(self) -> float:
        """Output per input at rest, the value at q = 1."""
        return steady_gain(self.model, self.Ts)

    @property
    def standard_errors(self) -> Array:
        """Of the coefficients, in the order of `covariance`."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def pole_errors(self) -> Array:
        """Standard error of each of `poles`, first order in the errors of the coefficients: (14); 0 for those at 0
        that stand for dead time."""
        order = len(self.covariance) - self.model.numerator.size
        moving = self.model.denominator[: order + 1]
        errors = _root_errors(moving, by_magnitude(np.roots(moving)), self.covariance[:order, :order], 1)
        return np.concatenate([errors, np.zeros(self.poles.size - errors.size)])

    @property
    def zero_errors(self) -> Array:
        """Standard error of each of `zeros`, as `pole_errors`."""
        order = len(self.covariance) - self.model.numerator.size
        return _root_errors(self.model.numerator, self.zeros, self.covariance[order:, order:], 0)

    def simulate(self, inputs: ArrayLike) -> Array:
        """Output (n,) for inputs (n,), from rest and without noise."""
        numerator, denominator = self.model
        delay = denominator.size - numerator.size
        u = check_signal("Estimate.simulate(inputs)", inputs)
        return filter_response(np.concatenate([np.zeros(delay), numerator]), denominator, u)

    def fit(self, inputs: ArrayLike, outputs: ArrayLike) -> float:
        """Share of the output's deviation from its mean that the simulation explains: 1 is perfect, 0 is no better
        than the mean."""
        measured = check_signal("Estimate.fit(outputs)", outputs)
        missed = np.linalg.norm(measured - self.simulate(inputs))
        return float(1.0 - missed / np.linalg.norm(measured - measured.mean()))


@dataclass(frozen=True, eq=False, repr=False)
class EstimatedRuns(Record):
    """The same identification of many records: spread instead of standard errors.

    numerators (runs, zeros + 1) and denominators (runs, poles + 1) in q; converged (runs,); iterations (runs,).
    """

    numerators: Array
    denominators: Array
    converged: NDArray[np.bool_]
    iterations: NDArray[np.int64]

    @property
    def poles(self) -> NDArray[Any]:
        """(runs, poles), by falling magnitude in each run."""
        return np.array([by_magnitude(np.roots(a)) for a in self.denominators])

    @property
    def zeros(self) -> NDArray[Any]:
        """(runs, zeros), by falling magnitude in each run."""
        return np.array([by_magnitude(np.roots(b)) for b in self.numerators])

    @property
    def gains(self) -> Array:
        """(runs,): factors in front."""
        return self.numerators[:, 0]


def by_magnitude(roots: NDArray[Any]) -> NDArray[Any]:
    """Roots by falling magnitude; of a pair, the one above the real axis first."""
    return roots[np.lexsort((-roots.imag, -np.round(np.abs(roots), 12)))]


def _root_errors(polynomial: Array, roots: NDArray[Any], covariance: Array, first: int) -> Array:
    """dr = -sum r^(n-i) dp_i / p'(r): the covariance of the coefficients from index `first` on, moved to the roots.
    A double root has no first order error: infinite."""
    degree = polynomial.size - 1
    slope = np.polyval(np.polyder(polynomial), roots) if degree else np.ones(roots.size)
    with np.errstate(divide="ignore", invalid="ignore"):
        lever = roots[:, None] ** (degree - np.arange(first, degree + 1)) / slope[:, None]
    variance = np.einsum("ri,ij,rj->r", lever, covariance, lever.conj()).real
    return np.sqrt(np.where(np.isfinite(variance), np.maximum(variance, 0.0), np.inf))
