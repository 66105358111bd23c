"""Least squares on records of input and output, plain and modified: docs/theory/identification.md (3), (5), (6)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_count, check_positive
from fieldmap.control.identification.estimate import Estimate, EstimatedRuns, Orders, not_settled
from fieldmap.control.identification.regression import (
    Solution,
    check_records,
    filtered,
    polynomials,
    solve,
    stable_denominators,
    to_model,
)
from fieldmap.typing import Array

_WHITE_EQUATION = (
    "errors of the equation A y = B u are white: noise enters through 1/A, as hardly any sensor's does"
)
_WHITE_OUTPUT = (
    "noise adds to the output as white noise (a sensor's), and the input is not fed through the same sample"
)


def least_squares(outputs: ArrayLike, inputs: ArrayLike, orders: Orders, Ts: float) -> Estimate:
    """ARX: A(q) y = B(q) u + white noise, by one linear regression; (1), (3) of docs/theory/identification.md.

    outputs, inputs (n,): deviations from the operating point, evenly sampled, from rest. Ts in s. Biased for noise
    of the sensor: (4) there. Raises InputError for records that are not finite, too short or not rich enough.

    >>> u = np.sign(np.sin(np.arange(200.0)))
    >>> y = np.zeros(200)
    >>> for n in range(1, 200):
    ...     y[n] = 0.9 * y[n - 1] + 0.2 * u[n - 1]
    >>> print(least_squares(y, u, Orders(poles=1, zeros=0), Ts=1e-3).poles.round(6))
    [0.9]
    """
    check_positive("least_squares", Ts=Ts)
    y, u = check_records("least_squares", orders, outputs=outputs, inputs=inputs)
    solution = solve(y, u, orders, "least_squares")
    return estimate_of(solution, orders, Ts, "least squares (ARX)", 1, (_WHITE_EQUATION,))


def modified_least_squares(
    outputs: ArrayLike,
    inputs: ArrayLike,
    orders: Orders,
    Ts: float,
    *,
    tolerance: float = 1e-6,
    iterations: int = 100,
) -> Estimate:
    """Modified least squares: fit, filter both records by 1/A, repeat; (5), (6).

    This is the iteration of Steiglitz and McBride (IEEE Trans. Automatic Control 10 (1965) 461). Where an estimate of
    A is unstable the filter takes its poles reflected at the unit circle. Stops when no coefficient changes by more
    than `tolerance` of their largest. Consistent for white noise of the sensor; coloured noise biases it. Raises
    NotConverged, the usual sign of more poles and zeros than the records can tell apart; see `modified_least_squares_
    runs` to look at such estimates all the same.
    """
    y, u = check_records("modified_least_squares", orders, outputs=outputs, inputs=inputs)
    check_positive("modified_least_squares", Ts=Ts)
    solution, changes = _iterate(y, u, orders, tolerance, iterations)
    if not changes[-1][0] <= tolerance:
        remedy = "ask for fewer poles and zeros, excite more, or record longer"
        past = [float(change[0]) for change in changes]
        raise not_settled("modified_least_squares", tolerance, iterations, past, remedy)
    method = "modified least squares (Steiglitz-McBride)"
    return estimate_of(solution, orders, Ts, method, len(changes), (_WHITE_OUTPUT,))


def modified_least_squares_runs(
    outputs: ArrayLike,
    inputs: ArrayLike,
    orders: Orders,
    *,
    tolerance: float = 1e-6,
    iterations: int = 100,
) -> EstimatedRuns:
    """`modified_least_squares` of many records at once, for Monte Carlo studies; says which did not settle.

    outputs (runs, n); inputs (n,) or (runs, n).
    """
    y, u = check_records("modified_least_squares_runs", orders, outputs=outputs, inputs=inputs)
    solution, changes = _iterate(y, u, orders, tolerance, iterations)
    a, b = polynomials(solution.coefficients, orders)
    history = np.array(changes)
    needed = np.sum(~np.isnan(history), axis=0)
    last = history[needed - 1, np.arange(len(y))]
    a = np.concatenate([a, np.zeros((len(a), orders.dead_time))], axis=1)
    return EstimatedRuns(b, a, last <= tolerance, needed)


def _iterate(
    y: Array, u: Array, orders: Orders, tolerance: float, iterations: int
) -> tuple[Solution, list[Array]]:
    """Runs that have settled are left alone; changes per iteration (runs,), NaN for these."""
    where = "modified_least_squares"
    check_positive(where, tolerance=tolerance)
    check_count(where, iterations=iterations)
    solution = solve(y, u, orders, where)
    found = [np.array(field) for field in solution[:3]] + [np.array(solution.condition)]
    active, changes = np.arange(len(y)), []
    for _ in range(iterations):
        a = stable_denominators(polynomials(found[0][active], orders)[0])
        one = np.ones((len(active), 1))
        step = solve(filtered(one, a, y[active]), filtered(one, a, u[active]), orders, where)
        moved = np.abs(step.coefficients - found[0][active]).max(axis=1)
        change = np.full(len(y), np.nan)
        change[active] = moved / np.abs(step.coefficients).max(axis=1)
        changes.append(change)
        for array, new in zip(found, (*step[:3], step.condition), strict=True):
            array[active] = new
        active = active[change[active] > tolerance]
        if not active.size:
            break
    return Solution(found[0], found[1], found[2], solution.samples, found[3]), changes


def estimate_of(
    solution: Solution, orders: Orders, Ts: float, method: str, iterations: int, assumptions: tuple[str, ...]
) -> Estimate:
    """The first run of a solution with its report; covariance = variance of the errors * (columns' products)^-1."""
    a, b = polynomials(solution.coefficients[:1], orders)
    freedom = solution.samples - orders.parameters
    variance = float(solution.squares[0]) / freedom
    inverse = np.linalg.inv(solution.triangle[0])
    return Estimate(
        model=to_model(a[0], b[0], orders),
        Ts=Ts,
        method=method,
        covariance=variance * inverse @ inverse.T,
        noise=np.ones(1),
        residual_rms=float(np.sqrt(variance)),
        condition=float(solution.condition[0]),
        iterations=iterations,
        assumptions=assumptions,
    )
