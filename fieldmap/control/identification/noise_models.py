"""Estimators that model the noise as well: generalised least squares and ARMAX."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from fieldmap.arguments import check_count, check_positive
from fieldmap.control.identification.estimate import Estimate, Orders, not_settled
from fieldmap.control.identification.least_squares import estimate_of, modified_least_squares_runs
from fieldmap.control.identification.regression import (
    check_records,
    columns_of,
    filtered,
    polynomials,
    solve,
    solve_columns,
    stable_denominators,
    to_model,
)
from fieldmap.control.linear_models import filter_response
from fieldmap.errors import NotConverged, Problem
from fieldmap.typing import Array


def generalised_least_squares(
    outputs: ArrayLike,
    inputs: ArrayLike,
    orders: Orders,
    Ts: float,
    *,
    noise_order: int = 2,
    tolerance: float = 1e-6,
    iterations: int = 100,
) -> Estimate:
    """A(q) y = B(q) u + v / D(q): least squares, model the errors as autoregressive, filter both records by D, repeat.

    Clarke (IFAC Symposium on Identification, Prague 1967): (7) of docs/theory/identification.md. Consistent if the
    equation's errors are autoregressive of this order and there is a single minimum; the noise of a sensor is not
    (D = 1/A would need infinitely many terms). Raises NotConverged; InputError for unusable records.
    """
    where = "generalised_least_squares"
    check_positive(where, Ts=Ts, tolerance=tolerance)
    check_count(where, noise_order=noise_order, iterations=iterations)
    y, u = check_records(where, orders, outputs=outputs, inputs=inputs)
    solution, changes = solve(y, u, orders, where), []
    for _ in range(iterations):
        a, b = polynomials(solution.coefficients, orders)
        errors = _equation_errors(a[0], b[0], y[0], u[0], orders)
        whitening = _autoregression(errors, noise_order, where)[None, :]
        one = np.ones((1, 1))
        step = solve(filtered(whitening, one, y), filtered(whitening, one, u), orders, where)
        moved = np.abs(step.coefficients - solution.coefficients).max()
        changes.append(float(moved / np.abs(step.coefficients).max()))
        solution = step
        if changes[-1] <= tolerance:
            note = f"errors of the equation are autoregressive of order {noise_order}"
            return estimate_of(solution, orders, Ts, "generalised least squares", len(changes), (note,))
    remedy = "try the modified least squares or ARMAX, or another noise order"
    raise not_settled(where, tolerance, iterations, changes, remedy)


def armax(
    outputs: ArrayLike, inputs: ArrayLike, orders: Orders, Ts: float, *, noise_order: int | None = None
) -> Estimate:
    """A(q) y = B(q) u + C(q) v, (2), by minimising the prediction errors: (8), (9).

    noise_order: of C; as many as poles unless given, which covers white noise of a sensor on top of any plant, in
    open and closed loop. Started from a long autoregression (Hannan and Rissanen) or the modified least squares,
    whichever predicts better, then scipy's least squares with exact derivatives. Consistent for every noise
    that C can describe, in closed loop too. Raises NotConverged; InputError for unusable records.
    """
    where = "armax"
    noise = orders.poles if noise_order is None else noise_order
    check_positive(where, Ts=Ts)
    check_count(where, noise_order=noise)
    needed = 3 * (orders.parameters + noise) + 40
    y, u = (x[0] for x in check_records(where, orders, needed, outputs=outputs, inputs=inputs))
    starts = [_two_stage_start(y, u, orders, noise, where), _modified_start(y, u, orders, noise)]
    # C may have roots near the unit circle: a start in the middle of the noise would ring through 1/C.
    y, u = (np.concatenate([np.zeros(orders.first), x]) for x in (y, u))
    fit = _least_prediction_errors(starts, y, u, orders, where)
    solution = solve_columns(fit.jac, -fit.fun, where)  # only for covariance and condition
    inverse = np.linalg.inv(solution.triangle[0])
    variance = float(2 * fit.cost) / (fit.fun.size - fit.x.size)
    a, b = polynomials(fit.x[None, :], orders)
    p = orders.parameters
    return Estimate(
        model=to_model(a[0], b[0], orders),
        Ts=Ts,
        method="ARMAX (prediction errors)",
        covariance=variance * (inverse @ inverse.T)[:p, :p],
        noise=stable_denominators(np.r_[1.0, fit.x[p:]][None, :])[0],
        residual_rms=float(np.sqrt(variance)),
        condition=float(solution.condition[0]),
        iterations=int(fit.nfev),
        assumptions=(f"noise of the equation is a moving average of order {noise}",),
    )


def _least_prediction_errors(starts: list[Array], y: Array, u: Array, orders: Orders, where: str) -> Any:
    """scipy's answer, from the start that predicts best."""
    start = min(starts, key=lambda theta: float(np.sum(_prediction_errors(theta, y, u, orders) ** 2)))
    fit = scipy.optimize.least_squares(
        _prediction_errors,
        start,
        jac=_prediction_slopes,
        args=(y, u, orders),
        x_scale="jac",
        xtol=1e-10,
        ftol=1e-13,
        gtol=1e-13,
    )
    if not fit.success:
        raise NotConverged(Problem(where, "must converge", fit.message, "ask for fewer coefficients"))
    return fit


def _equation_errors(a: Array, b: Array, y: Array, u: Array, orders: Orders) -> Array:
    driven = filter_response(np.concatenate([np.zeros(orders.delay), b]), [1.0], u)
    return (filter_response(a, [1.0], y) - driven)[orders.first :]


def _autoregression(errors: Array, order: int, where: str) -> Array:
    past = np.stack([-errors[order - i : errors.size - i] for i in range(1, order + 1)], axis=1)
    if not np.any(past):  # nothing left to whiten
        return np.concatenate([[1.0], np.zeros(order)])
    return np.concatenate([[1.0], solve_columns(past, errors[order:], where).coefficients[0]])


def _two_stage_start(y: Array, u: Array, orders: Orders, noise: int, where: str) -> Array:
    """Errors of a long ARX model stand for v; then one regression on past y, u and v."""
    long = Orders(orders.poles + 15, orders.zeros + 15, orders.dead_time)
    try:
        a, b = polynomials(solve(y[None], u[None], long, where).coefficients, long)
    except ValueError:  # without noise the long model is not unique; the short one is
        a, b = polynomials(solve(y[None], u[None], orders, where).coefficients, orders)
        long = orders
    v = np.concatenate([np.zeros(long.first), _equation_errors(a[0], b[0], y, u, long)])
    first = orders.first + noise
    past = np.stack([v[first - i : v.size - i] for i in range(1, noise + 1)], axis=1)
    known = columns_of(y[None], u[None], orders)[0][noise:]
    if np.sqrt(np.mean(v**2)) < 1e-9 * np.sqrt(np.mean(y**2)):
        return np.concatenate([solve_columns(known, y[first:], where).coefficients[0], np.zeros(noise)])
    return solve_columns(np.concatenate([known, past], axis=1), y[first:], where).coefficients[0]


def _modified_start(y: Array, u: Array, orders: Orders, noise: int) -> Array:
    """Sensor noise: C = A with its roots inside the unit circle."""
    found = modified_least_squares_runs(y, u, orders, iterations=30)
    a = found.denominators[:, : orders.poles + 1]
    c = np.resize(np.concatenate([stable_denominators(a)[0, 1:], np.zeros(noise)]), noise)
    return np.concatenate([a[0, 1:], found.numerators[0], c])


def _prediction_errors(theta: Array, y: Array, u: Array, orders: Orders) -> Array:
    """(9): the equation's errors through 1/C, C with its roots inside the unit circle."""
    a, b = polynomials(theta[None, :], orders)
    return filter_response(
        [1.0], _noise_polynomial(theta, orders), _equation_errors(a[0], b[0], y, u, orders)
    )


def _prediction_slopes(theta: Array, y: Array, u: Array, orders: Orders) -> Array:
    """Derivatives (m, p) of the prediction errors: y, u and the errors themselves, delayed, through 1/C."""
    c = _noise_polynomial(theta, orders)
    known = -filter_response([1.0], c, columns_of(y[None], u[None], orders)[0], axis=0)
    errors = filter_response([1.0], c, _prediction_errors(theta, y, u, orders))
    past = [np.concatenate([np.zeros(i), -errors[: errors.size - i]]) for i in range(1, c.size)]
    return np.concatenate([known, np.stack(past, axis=1)], axis=1)


def _noise_polynomial(theta: Array, orders: Orders) -> Array:
    return stable_denominators(np.concatenate([[1.0], theta[orders.parameters :]])[None, :])[0]
