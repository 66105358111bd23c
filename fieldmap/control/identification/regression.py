"""Linear regression on past outputs and inputs, for one record or many at once, and the report of an identified model.

The model in the delay operator is (1) of docs/theory/identification.md,

    y[n] = -a_1 y[n-1] - ... - a_p y[n-p] + b_0 u[n-d] + ... + b_z u[n-d-z] + error,

solved by a QR factorisation of the columns with y. Normal equations would square a condition number that is already
large for poles near q = 1. Arrays are (runs, samples).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.arguments import check, check_count, check_positive, check_signal
from fieldmap.control.linear_models import TransferFunction, filter_response, steady_gain
from fieldmap.errors import NotConverged, Problem
from fieldmap.parallel.work import same_arithmetic
from fieldmap.records import Record, tuple_line
from fieldmap.typing import Array

# Condition number of the columns, scaled to length one, above which rounding determines the coefficients.
LARGEST_CONDITION = 1e12
# Largest number of entries of columns that are computed at a time: 32 MB, with copies a few times that.
_AT_ONCE = 4_000_000


@dataclass(frozen=True)
class Orders(Record):
    """Numbers of poles and zeros of the sampled model, and of additional samples of dead time.

    (b_0 q^zeros + ...) / (q^poles + ...) q^-dead_time: such as poles=4, zeros=3. The output follows the input by
    `delay` = poles - zeros + dead_time samples; sampled plants have one or more. Raises InputError for numbers that are
    not whole, or more zeros than poles.
    """

    poles: int
    zeros: int
    dead_time: int = 0

    def __post_init__(self) -> None:
        values = (self.poles, self.zeros, self.dead_time)
        whole = all(not isinstance(v, bool) and v == int(v) and v >= 0 for v in values)
        must = "must be whole numbers with poles >= 1 and 0 <= zeros <= poles"
        received = f"poles {self.poles}, zeros {self.zeros}, dead time {self.dead_time}"
        remedy = "a plant behind a zero-order hold has at least one pole more than zeros"
        check(whole and 1 <= self.poles >= self.zeros, "Orders", must, received, remedy)

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


@dataclass(frozen=True, eq=False, repr=False)
class Estimate(Record):
    """An identified sampled model with its report.

    model: numerator and denominator in q. Ts: sampling time, s. method: the estimator. covariance (p, p): of the
    denominator's coefficients after the leading 1, then the numerator's; it holds if `assumptions` hold. noise: C(q)
    of (1), falling powers ([1] unless it was estimated). residual_rms: of the last equation's errors, in units of the
    output. condition: of the scaled regressors. iterations: their number. assumptions: under which the estimate is
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
        """Standard errors of the coefficients, in the order of `covariance`."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def pole_errors(self) -> Array:
        """Standard error of each of `poles`, to first order in the errors of the coefficients: (14); 0 for poles at 0
        due to dead time."""
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
        """Output for given inputs, from rest and without noise.

        Parameters
        ----------
        inputs
            (n,).

        Returns
        -------
        Array
            Output (n,).
        """
        numerator, denominator = self.model
        delay = denominator.size - numerator.size
        u = check_signal("Estimate.simulate(inputs)", inputs)
        return filter_response(np.concatenate([np.zeros(delay), numerator]), denominator, u)

    def fit(self, inputs: ArrayLike, outputs: ArrayLike) -> float:
        """Share of the output's deviation from its mean that the simulation explains.

        Parameters
        ----------
        inputs
            (n,).
        outputs
            (n,).

        Returns
        -------
        float
            The share: 1 is perfect, 0 is no better than the mean.
        """
        measured = check_signal("Estimate.fit(outputs)", outputs)
        missed = np.linalg.norm(measured - self.simulate(inputs))
        return float(1.0 - missed / np.linalg.norm(measured - measured.mean()))


@dataclass(frozen=True, eq=False, repr=False)
class EstimatedRuns(Record):
    """Models identified from many records, whose spread replaces standard errors.

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
    """Roots by falling magnitude; in a pair, the one above the real axis comes first."""
    return roots[np.lexsort((-roots.imag, -np.round(np.abs(roots), 12)))]


def _root_errors(polynomial: Array, roots: NDArray[Any], covariance: Array, first: int) -> Array:
    """Standard errors of roots from the covariance of the coefficients from index `first` on, by dr = -sum r^(n-i) dp_i
    / p'(r); infinite for a double root."""
    degree = polynomial.size - 1
    slope = np.polyval(np.polyder(polynomial), roots) if degree else np.ones(roots.size)
    with np.errstate(divide="ignore", invalid="ignore"):
        lever = roots[:, None] ** (degree - np.arange(first, degree + 1)) / slope[:, None]
    variance = np.einsum("ri,ij,rj->r", lever, covariance, lever.conj()).real
    return np.sqrt(np.where(np.isfinite(variance), np.maximum(variance, 0.0), np.inf))


class Solution(NamedTuple):
    """coefficients (runs, parameters): a then b; triangle (runs, p, p) with triangle.T triangle = columns.T columns;
    squares (runs,): sum of squared errors; condition (runs,) of the scaled columns; samples: number of errors."""

    coefficients: Array
    triangle: Array
    squares: Array
    condition: Array
    samples: int

    def __repr__(self) -> str:
        return tuple_line(self)


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
    parts = (slice(at, at + runs) for at in range(0, len(y), runs))
    r = [_triangles(columns_of(y[part], u[part], orders), y[part, orders.first :]) for part in parts]
    return _solution(np.concatenate(r), samples, where)


def solve_columns(columns: Array, target: Array, where: str) -> Solution:
    """Least squares of target (m,) over columns (m, p)."""
    return _solution(_triangles(columns[None], target[None]), target.size, where)


def _triangles(columns: Array, targets: Array) -> Array:
    """Upper triangles r (runs, p + 1, p + 1) of the QR factorisation of columns (runs, m, p) with targets (runs, m) as
    last column; the signs of rows are arbitrary."""
    both = np.concatenate([columns, targets[..., None]], axis=-1)
    # With LAPACK's own threads small matrices take up to a hundred times as long, and round differently.
    with same_arithmetic():
        r = np.asarray(np.linalg.qr(both, mode="r"))
    # With fewer rows than columns r is not square; rows of zeros change nothing.
    return np.pad(r, ((0, 0), (0, r.shape[2] - r.shape[1]), (0, 0)))


def _solution(r: Array, samples: int, where: str) -> Solution:
    """Least squares from the triangles (runs, p + 1, p + 1) of columns and target."""
    p = r.shape[-1] - 1
    length = np.linalg.norm(r[:, :p, :p], axis=1)
    triangle = r[:, :p, :p] / np.where(length > 0.0, length, 1.0)[:, None, :]
    singular = np.linalg.svd(triangle, compute_uv=False)
    largest, smallest = singular[:, 0], singular[:, -1]
    condition = np.divide(largest, smallest, out=np.full(len(r), np.inf), where=smallest > 0.0)
    must = "must be rich enough to tell the coefficients apart"
    received = f"regressors that depend on each other (condition {condition.max():.2g})"
    remedy = (
        "excite the input more (a PRBS), ask for fewer poles and zeros, or, in closed loop without a reference "
        "signal, see the conditions in the theory page on identification"
    )
    check(bool((condition < LARGEST_CONDITION).all()), where, must, received, remedy)
    coefficients = np.linalg.solve(triangle, r[:, :p, p, None])[..., 0] / length
    return Solution(coefficients, r[:, :p, :p], r[:, p, p] ** 2, condition, samples)


def iterate(
    where: str,
    start: Array,
    advance: Callable[[NDArray[np.intp], Array], Solution],
    tolerance: float,
    iterations: int,
) -> tuple[Solution, list[Array]]:
    """Repeat advance(runs, their coefficients) from coefficients (runs, p), until none changes by more than `tolerance`
    times the largest of its run.

    Converged runs are not changed any more. Returns also the changes (runs,) of each iteration, NaN for these runs.
    """
    check_positive(where, tolerance=tolerance)
    check_count(where, iterations=iterations)
    active, changes = np.arange(len(start)), []
    found = [start]
    for _ in range(iterations):
        step = advance(active, found[0][active])
        moved = np.abs(step.coefficients - found[0][active]).max(axis=1)
        change = np.full(len(start), np.nan)
        change[active] = moved / np.abs(step.coefficients).max(axis=1)
        if not changes:
            found = [np.array(field) for field in step[:4]]
        for array, new in zip(found, step[:4], strict=True):
            array[active] = new
        changes.append(change)
        active = active[change[active] > tolerance]
        if not active.size:
            break
    coefficients, triangle, squares, condition = found
    return Solution(coefficients, triangle, squares, condition, step.samples), changes


def settled(
    where: str,
    start: Array,
    advance: Callable[[NDArray[np.intp], Array], Solution],
    tolerance: float,
    iterations: int,
    remedy: str,
) -> tuple[Solution, int]:
    """`iterate` for one run, and its number of iterations. Raises NotConverged if it does not converge."""
    solution, changes = iterate(where, start, advance, tolerance, iterations)
    past = tuple(float(change[0]) for change in changes)
    if not past[-1] <= tolerance:
        must = f"must settle to {tolerance:g} within {iterations} iterations"
        received = f"a change of {past[-1]:.2g} of the largest coefficient"
        raise NotConverged(Problem(where, must, received, remedy), residuals=past)
    return solution, len(past)


def stable_denominators(a: Array) -> Array:
    """Polynomials (runs, p + 1) with the roots outside the unit circle reflected into it. Up to a factor the magnitude
    stays the same at every frequency, and the filter is stable."""
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
    """A with its leading 1 and B, from coefficients (runs, parameters)."""
    a = np.concatenate([np.ones((len(coefficients), 1)), coefficients[:, : orders.poles]], axis=1)
    return a, coefficients[:, orders.poles : orders.parameters]


def to_model(coefficients: Array, orders: Orders) -> TransferFunction:
    """The model in q for coefficients (parameters,), with falling powers; dead time adds poles at 0."""
    a, b = polynomials(coefficients[None], orders)
    return TransferFunction(b[0], np.concatenate([a[0], np.zeros(orders.dead_time)]))


def estimate_of(
    solution: Solution,
    orders: Orders,
    Ts: float,
    method: str,
    iterations: int,
    assumption: str | tuple[str, ...],
    noise: Array | None = None,
) -> Estimate:
    """The first run of a solution with its report; covariance = variance of the errors * (columns.T columns)^-1."""
    coefficients, p = solution.coefficients[0], orders.parameters
    variance = float(solution.squares[0]) / (solution.samples - coefficients.size)
    inverse = np.linalg.inv(solution.triangle[0])
    return Estimate(
        model=to_model(coefficients, orders),
        Ts=Ts,
        method=method,
        covariance=variance * (inverse @ inverse.T)[:p, :p],
        noise=np.ones(1) if noise is None else noise,
        residual_rms=float(np.sqrt(variance)),
        condition=float(solution.condition[0]),
        iterations=iterations,
        assumptions=(assumption,) if isinstance(assumption, str) else assumption,
    )


def check_records(
    where: str, orders: Orders, minimum: int | None = None, **signals: ArrayLike
) -> list[Array]:
    """Finite records of one length as arrays (runs, samples), long enough for the orders. One input may drive all runs.
    Raises InputError."""
    arrays = [np.atleast_2d(check_signal(f"{where}({name})", values)) for name, values in signals.items()]
    at, (runs, samples) = f"{where}({', '.join(signals)})", (max(map(len, arrays)), arrays[0].shape[1])
    fits = all(x.ndim == 2 and x.shape[1] == samples and len(x) in (1, runs) for x in arrays)
    must = "must be records of one length, (samples,) or (runs, samples)"
    received = ", ".join(f"{name} {x.shape}" for name, x in zip(signals, arrays, strict=True))
    check(fits, at, must, received, "cut them to the same samples")
    needed = orders.first + 2 * orders.parameters if minimum is None else minimum
    must = f"must hold at least {needed} samples for {orders.parameters} coefficients"
    remedy = "record longer, or ask for fewer poles and zeros"
    check(samples >= needed, at, must, f"{samples} samples", remedy)
    return [np.broadcast_to(x, (runs, samples)) for x in arrays]
