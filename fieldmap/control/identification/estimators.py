"""Estimators of models from records of input and output: docs/theory/identification.md (3) to (16).

Least squares, plain, modified, generalised and recursive, and prediction errors (ARMAX). In closed loop, u = C (r - y)
and y = P u + noise, where y is the sensor's reading. The plant P is estimated from u and y (direct), from r and y with
the controller known (indirect), or from r, u and y without it (two-stage).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.polynomial.polynomial import polyadd
from numpy.typing import ArrayLike, NDArray

from fieldmap.arguments import check, check_count, check_positive
from fieldmap.control.identification import regression
from fieldmap.control.identification.regression import Estimate, EstimatedRuns, Orders, Solution
from fieldmap.control.linear_models import TransferFunction, filter_response, transfer_function
from fieldmap.errors import NotConverged
from fieldmap.records import Record
from fieldmap.typing import Array

_WHITE_EQUATION = (
    "errors of the equation A y = B u are white: noise enters through 1/A, as hardly any sensor's does"
)
_WHITE_OUTPUT = (
    "noise adds to the output as white noise (a sensor's), and the input is not fed through the same sample"
)
_NOISE_FREE_REFERENCE = "the reference does not depend on the noise; the noise may be of any colour"


def least_squares(outputs: ArrayLike, inputs: ArrayLike, orders: Orders, Ts: float) -> Estimate:
    """ARX: A(q) y = B(q) u + white noise, by one linear regression; (1), (3) of
    docs/theory/identification.md.

    Noise of the sensor biases the estimate: (4) there.

    Parameters
    ----------
    outputs, inputs
        Deviations from the operating point (n,), evenly sampled, from rest.
    orders
        Numbers of poles and zeros.
    Ts
        Sampling time, s.

    Returns
    -------
    Estimate
        The model.

    Raises
    ------
    InputError
        For records that are not finite, too short or not rich enough.

    Examples
    --------
    >>> u = np.sign(np.sin(np.arange(200.0)))
    >>> y = np.zeros(200)
    >>> for n in range(1, 200):
    ...     y[n] = 0.9 * y[n - 1] + 0.2 * u[n - 1]
    >>> print(least_squares(y, u, Orders(poles=1, zeros=0), Ts=1e-3).poles.round(6))
    [0.9]
    """
    check_positive("least_squares", Ts=Ts)
    y, u = regression.check_records("least_squares", orders, outputs=outputs, inputs=inputs)
    solution = regression.solve(y, u, orders, "least_squares")
    return regression.estimate_of(solution, orders, Ts, "least squares (ARX)", 1, _WHITE_EQUATION)


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

    This is the iteration of Steiglitz and McBride (IEEE Trans. Automatic Control 10 (1965) 461). If an
    estimate of A is unstable, the filter uses its poles reflected at the unit circle. Consistent for white
    noise of the sensor; coloured noise biases it.

    Parameters
    ----------
    outputs, inputs, orders, Ts
        As for `least_squares`.
    tolerance
        The iteration stops when no coefficient changes by more than this share of the largest one.
    iterations
        Largest number of iterations.

    Returns
    -------
    Estimate
        The model.

    Raises
    ------
    InputError
        As for `least_squares`.
    NotConverged
        If the iteration does not converge. Usually the records then do not determine this number of poles and
        zeros; `modified_least_squares_runs` nevertheless returns such estimates.
    """
    where = "modified_least_squares"
    y, u = regression.check_records(where, orders, outputs=outputs, inputs=inputs)
    check_positive(where, Ts=Ts)
    start, advance = _filtering(y, u, orders, where)
    remedy = "ask for fewer poles and zeros, excite more, or record longer"
    solution, count = regression.settled(where, start, advance, tolerance, iterations, remedy)
    method = "modified least squares (Steiglitz-McBride)"
    return regression.estimate_of(solution, orders, Ts, method, count, _WHITE_OUTPUT)


def modified_least_squares_runs(
    outputs: ArrayLike, inputs: ArrayLike, orders: Orders, *, tolerance: float = 1e-6, iterations: int = 100
) -> EstimatedRuns:
    """`modified_least_squares` for many records at once, for Monte Carlo studies.

    Parameters
    ----------
    outputs
        (runs, n).
    inputs
        (n,) or (runs, n).
    orders
        Numbers of poles and zeros.
    tolerance, iterations
        As for `modified_least_squares`.

    Returns
    -------
    EstimatedRuns
        The models, and which of them converged.

    Raises
    ------
    InputError
        As for `least_squares`.
    """
    where = "modified_least_squares_runs"
    y, u = regression.check_records(where, orders, outputs=outputs, inputs=inputs)
    solution, changes = regression.iterate(where, *_filtering(y, u, orders, where), tolerance, iterations)
    a, b = regression.polynomials(solution.coefficients, orders)
    history = np.array(changes)
    needed = np.sum(~np.isnan(history), axis=0)
    last = history[needed - 1, np.arange(len(y))]
    a = np.concatenate([a, np.zeros((len(a), orders.dead_time))], axis=1)
    return EstimatedRuns(b, a, last <= tolerance, needed)


def _filtering(
    y: Array, u: Array, orders: Orders, where: str
) -> tuple[Array, Callable[[NDArray[np.intp], Array], Solution]]:
    """Start coefficients (runs, p), and the step of the modified least squares, for `iterate`."""

    def advance(active: NDArray[np.intp], coefficients: Array) -> Solution:
        a = regression.stable_denominators(regression.polynomials(coefficients, orders)[0])
        one = np.ones((len(active), 1))
        return regression.solve(
            regression.filtered(one, a, y[active]), regression.filtered(one, a, u[active]), orders, where
        )

    return regression.solve(y, u, orders, where).coefficients, advance


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
    """A(q) y = B(q) u + v / D(q): least squares, model the errors as autoregressive, filter both records by
    D, repeat.

    Clarke (IFAC Symposium on Identification, Prague 1967): (7) of docs/theory/identification.md. Consistent
    if the equation's errors are autoregressive of this order and there is a single minimum. Noise of a
    sensor does not give such errors: D = 1/A would need infinitely many terms.

    Parameters
    ----------
    outputs, inputs, orders, Ts
        As for `least_squares`.
    noise_order
        Order of D.
    tolerance, iterations
        As for `modified_least_squares`.

    Returns
    -------
    Estimate
        The model.

    Raises
    ------
    InputError
        For unusable records.
    NotConverged
        If the iteration does not converge.
    """
    where = "generalised_least_squares"
    check_positive(where, Ts=Ts)
    check_count(where, noise_order=noise_order)
    y, u = regression.check_records(where, orders, outputs=outputs, inputs=inputs)

    def advance(_: NDArray[np.intp], coefficients: Array) -> Solution:
        errors = _equation_errors(coefficients[0], y[0], u[0], orders)
        whitening, one = _autoregression(errors, noise_order, where)[None, :], np.ones((1, 1))
        return regression.solve(
            regression.filtered(whitening, one, y), regression.filtered(whitening, one, u), orders, where
        )

    start = regression.solve(y, u, orders, where).coefficients
    remedy = "try the modified least squares or ARMAX, or another noise order"
    solution, count = regression.settled(where, start, advance, tolerance, iterations, remedy)
    note = f"errors of the equation are autoregressive of order {noise_order}"
    return regression.estimate_of(solution, orders, Ts, "generalised least squares", count, note)


def _autoregression(errors: Array, order: int, where: str) -> Array:
    past = np.stack([-errors[order - i : errors.size - i] for i in range(1, order + 1)], axis=1)
    if not np.any(past):  # nothing left to whiten
        return np.eye(1, order + 1)[0]
    return np.concatenate([[1.0], regression.solve_columns(past, errors[order:], where).coefficients[0]])


def armax(
    outputs: ArrayLike, inputs: ArrayLike, orders: Orders, Ts: float, *, noise_order: int | None = None
) -> Estimate:
    """A(q) y = B(q) u + C(q) v, (2), by minimising the prediction errors: (8), (9).

    scipy's least squares, with exact derivatives, starts from a long autoregression (Hannan and Rissanen) or the
    modified least squares, whichever predicts better. Consistent for every noise that C can describe, in
    closed loop too.

    Parameters
    ----------
    outputs, inputs, orders, Ts
        As for `least_squares`.
    noise_order
        Order of C. Default: the number of poles, which covers white noise of a sensor on top of any plant,
        in open and closed loop.

    Returns
    -------
    Estimate
        The model.

    Raises
    ------
    InputError
        For unusable records.
    NotConverged
        If the search does not converge.
    """
    where = "armax"
    noise = orders.poles if noise_order is None else noise_order
    check_positive(where, Ts=Ts)
    check_count(where, noise_order=noise)
    needed = 3 * (orders.parameters + noise) + 40
    y, u = (x[0] for x in regression.check_records(where, orders, needed, outputs=outputs, inputs=inputs))
    starts = [_two_stage_start(y, u, orders, noise, where), _modified_start(y, u, orders, noise)]
    # C may have roots near the unit circle: without zeros before the records, their start would ring through 1/C.
    y, u = (np.concatenate([np.zeros(orders.first), x]) for x in (y, u))
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
        raise NotConverged.of(where, "must converge", fit.message, "ask for fewer coefficients")
    # This linear solution gives only covariance and condition.
    solution = regression.solve_columns(fit.jac, -fit.fun, where)
    solution = solution._replace(coefficients=fit.x[None], squares=np.array([2.0 * fit.cost]))
    note = f"noise of the equation is a moving average of order {noise}"
    c = _noise_polynomial(fit.x, orders)
    return regression.estimate_of(solution, orders, Ts, "ARMAX (prediction errors)", int(fit.nfev), note, c)


def _equation_errors(coefficients: Array, y: Array, u: Array, orders: Orders) -> Array:
    a, b = (polynomial[0] for polynomial in regression.polynomials(coefficients[None], orders))
    driven = filter_response(np.concatenate([np.zeros(orders.delay), b]), [1.0], u)
    return (filter_response(a, [1.0], y) - driven)[orders.first :]


def _two_stage_start(y: Array, u: Array, orders: Orders, noise: int, where: str) -> Array:
    """One regression on past y, u and v, with the errors of a long ARX model as v."""
    long = Orders(orders.poles + 15, orders.zeros + 15, orders.dead_time)
    try:
        theta = regression.solve(y[None], u[None], long, where).coefficients[0]
    except ValueError:  # without noise the long model is not unique; the short one is
        theta = regression.solve(y[None], u[None], orders, where).coefficients[0]
        long = orders
    v = np.concatenate([np.zeros(long.first), _equation_errors(theta, y, u, long)])
    first = orders.first + noise
    past = np.stack([v[first - i : v.size - i] for i in range(1, noise + 1)], axis=1)
    known = regression.columns_of(y[None], u[None], orders)[0][noise:]
    if np.sqrt(np.mean(v**2)) < 1e-9 * np.sqrt(np.mean(y**2)):
        return np.concatenate(
            [regression.solve_columns(known, y[first:], where).coefficients[0], np.zeros(noise)]
        )
    return regression.solve_columns(np.concatenate([known, past], axis=1), y[first:], where).coefficients[0]


def _modified_start(y: Array, u: Array, orders: Orders, noise: int) -> Array:
    """Coefficients for sensor noise, by modified least squares: C = A with its roots inside the unit circle."""
    found = modified_least_squares_runs(y, u, orders, iterations=30)
    a = found.denominators[:, : orders.poles + 1]
    c = np.resize(np.concatenate([regression.stable_denominators(a)[0, 1:], np.zeros(noise)]), noise)
    return np.concatenate([a[0, 1:], found.numerators[0], c])


def _prediction_errors(theta: Array, y: Array, u: Array, orders: Orders) -> Array:
    """(9): the equation's errors filtered by 1/C, C with its roots inside the unit circle."""
    return filter_response([1.0], _noise_polynomial(theta, orders), _equation_errors(theta, y, u, orders))


def _prediction_slopes(theta: Array, y: Array, u: Array, orders: Orders) -> Array:
    """Derivatives (m, p) of the prediction errors: y, u and the errors themselves, delayed and filtered by 1/C."""
    c = _noise_polynomial(theta, orders)
    known = -filter_response([1.0], c, regression.columns_of(y[None], u[None], orders)[0], axis=0)
    errors = filter_response([1.0], c, _prediction_errors(theta, y, u, orders))
    past = [np.concatenate([np.zeros(i), -errors[: errors.size - i]]) for i in range(1, c.size)]
    return np.concatenate([known, np.stack(past, axis=1)], axis=1)


def _noise_polynomial(theta: Array, orders: Orders) -> Array:
    return regression.stable_denominators(np.concatenate([[1.0], theta[orders.parameters :]])[None, :])[0]


@dataclass(frozen=True, eq=False, repr=False)
class RecursiveRun(Record):
    """history (n, p): coefficients after each sample, of the denominator without its leading 1, of the numerator, and
    of C without its leading 1. model: the model after the last sample."""

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
    """Recursive least squares: an estimate after every sample.

    With noise_order > 0 recursive extended least squares (ARMAX): (10), (11), and Ljung, System
    Identification, 2nd ed., 11.2 and 11.5. Without forgetting and noise terms the last estimate is that of
    `least_squares`, but for the influence of the start values.

    Parameters
    ----------
    outputs, inputs, orders
        As for `least_squares`.
    noise_order
        Order of C, the polynomial of the noise.
    forgetting
        Weight of each sample relative to the next one, in (0, 1]. The estimate rests on about the last
        1 / (1 - forgetting) samples, which should last several times as long as the plant's slowest pole.
    start_variance
        Variance of the coefficients at the start, where they are 0.

    Returns
    -------
    RecursiveRun
        The estimates after every sample.

    Raises
    ------
    InputError
        For unusable records.
    """
    where = "recursive_least_squares"
    check_positive(where, start_variance=start_variance, forgetting=forgetting)
    must, received = "must lie in (0, 1] and be 0 or more", f"{forgetting!r}, {noise_order!r}"
    remedy = "0.99 or more is usual; 1 forgets nothing"
    check(forgetting <= 1.0 and noise_order >= 0, f"{where}(forgetting, noise_order)", must, received, remedy)
    y, u = regression.check_records(where, orders, outputs=outputs, inputs=inputs)
    p = orders.parameters + noise_order
    theta, covariance, past = np.zeros(p), start_variance * np.eye(p), np.zeros(noise_order)
    history = np.zeros((y.shape[1], p))
    for n, known in enumerate(regression.columns_of(y, u, orders)[0], orders.first):
        row = np.concatenate([known, past])
        gain = covariance @ row
        scale = forgetting + row @ gain
        theta = theta + gain * (y[0, n] - row @ theta) / scale
        covariance = (covariance - np.outer(gain, gain) / scale) / forgetting
        # Errors after the update: extended least squares.
        past = np.concatenate([[y[0, n] - row @ theta], past])[:noise_order]
        history[n] = theta
    return RecursiveRun(history, regression.to_model(history[-1], orders))


def identify_direct(outputs: ArrayLike, controls: ArrayLike, orders: Orders, Ts: float) -> Estimate:
    """The plant from the controller's output and the measured position, as if the loop were open.

    Modified least squares. In spite of the feedback, white noise of the sensor does not bias the estimate, if
    the plant has a delay of a sample or more: with the unstable poles reflected, (6) is the innovations form of
    the plant with that noise. Disturbing forces on the body and coloured noise bias the estimate: then use
    `armax`, which models them, or an indirect method. Without a reference signal the conditions (12) must hold.

    Parameters
    ----------
    outputs
        Measured position (n,), deviations from the operating point.
    controls
        Output of the controller (n,), deviations too.
    orders
        Numbers of poles and zeros.
    Ts
        Sampling time, s.

    Returns
    -------
    Estimate
        The plant.

    Raises
    ------
    InputError
        For unusable records, and for orders without a delay.
    NotConverged
        As for `modified_least_squares`.
    """
    must = "must have more poles than zeros, or dead time"
    received = f"{orders.poles} poles, {orders.zeros} zeros"
    remedy = "a loop without delay cannot be told from its controller"
    check(orders.delay >= 1, "identify_direct(orders)", must, received, remedy)
    return modified_least_squares(outputs, controls, orders, Ts)


def identify_indirect(
    outputs: ArrayLike,
    references: ArrayLike,
    controller: tuple[ArrayLike, ArrayLike],
    orders: Orders,
    Ts: float,
    *,
    tolerance: float = 1e-6,
    iterations: int = 100,
) -> Estimate:
    """The plant from reference and position, with the known controller taken out: (15), (16).

    Only the plant's coefficients are estimated, so that no poles and zeros have to cancel afterwards. Instruments
    are the noise-free records that the current model predicts (Gilson and Van den Hof, Automatica 41 (2005) 241).
    Consistent for any noise that does not depend on the reference, if the controller is correct.

    Parameters
    ----------
    outputs
        Measured position (n,), deviations from the operating point.
    references
        Reference (n,), deviations too.
    controller
        Numerator and denominator in q of u / (r - y), with its sign (negative for a plant of negative gain).
    orders
        Numbers of poles and zeros.
    Ts
        Sampling time, s.
    tolerance, iterations
        As for `modified_least_squares`.

    Returns
    -------
    Estimate
        The plant.

    Raises
    ------
    InputError
        For unusable records.
    NotConverged
        If the iteration does not converge.
    """
    where = "identify_indirect"
    check_positive(where, Ts=Ts)
    top, bottom = transfer_function(*controller)
    above = np.concatenate([np.zeros(bottom.size - top.size), top])
    y, r = regression.check_records(where, orders, outputs=outputs, references=references)
    outward, driven = filter_response(bottom, [1.0], y), filter_response(above, [1.0], r - y)
    # Plain least squares is too inaccurate a start. The direct method with the known controller's outputs is better.
    found = modified_least_squares_runs(y, filter_response(above, bottom, r - y), orders, iterations=30)
    start = np.hstack([found.denominators[:, 1 : orders.poles + 1], found.numerators])

    def advance(_: NDArray[np.intp], coefficients: Array) -> Solution:
        """Solve Z' Phi theta = Z' w with instruments Z. Triangle and condition are those of Z, for (14)."""
        a, b = (polynomial[0] for polynomial in regression.polynomials(coefficients, orders))
        forward = np.convolve(above, np.concatenate([np.zeros(orders.delay), b]))
        # Denominator of the closed loop, its unstable roots reflected; then the position without noise.
        stable = regression.stable_denominators(polyadd(np.convolve(bottom, a), forward)[None, :])[0]
        predicted = filter_response(forward, stable, r)
        free = filter_response(bottom, [1.0], predicted), filter_response(above, [1.0], r - predicted)
        w, v, w_free, v_free = (filter_response([1.0], stable, x) for x in (outward, driven, *free))
        matched = regression.solve(w_free, v_free, orders, where)
        columns, instruments = (
            regression.columns_of(w, v, orders)[0],
            regression.columns_of(w_free, v_free, orders)[0],
        )
        target = w[0, orders.first :]
        theta = np.linalg.solve(instruments.T @ columns, instruments.T @ target)
        errors = target - columns @ theta
        return matched._replace(coefficients=theta[None, :], squares=np.array([errors @ errors]))

    remedy = "check the controller's sign and sampling time; ask for fewer poles and zeros"
    solution, count = regression.settled(where, start, advance, tolerance, iterations, remedy)
    notes = (_NOISE_FREE_REFERENCE, "the controller is as given, never at its limits")
    method = "closed loop, known controller, refined instruments"
    return regression.estimate_of(solution, orders, Ts, method, count, notes)


def identify_two_stage(
    outputs: ArrayLike, controls: ArrayLike, references: ArrayLike, orders: Orders, Ts: float, *, loop: Orders
) -> Estimate:
    """The plant in two stages, without knowing the controller: Van den Hof and Schrama (Automatica 29 (1993)
    1523).

    The first stage models u from r. The u that it predicts is free of noise. From this u and y the second stage
    estimates the plant by modified least squares. Nearly cancelling poles and zeros in the first stage are
    harmless, but too few bias the plant. This is the least exact of the three methods.

    Parameters
    ----------
    outputs
        Measured position (n,), deviations from the operating point.
    controls
        Output of the controller (n,), deviations too.
    references
        Reference (n,), deviations too.
    orders
        Numbers of poles and zeros of the plant.
    Ts
        Sampling time, s.
    loop
        Numbers of poles and zeros of the first stage; Orders(4, 4) for a plant of two poles and a PID.

    Returns
    -------
    Estimate
        The plant.

    Raises
    ------
    InputError
        For unusable records.
    NotConverged
        As for `modified_least_squares`.
    """
    where = "identify_two_stage"
    check_positive(where, Ts=Ts)
    y, u, r = regression.check_records(
        where, orders, outputs=outputs, controls=controls, references=references
    )
    first = modified_least_squares_runs(u[0], r[0], loop, iterations=30)
    leading = np.zeros(loop.delay)
    stable = regression.stable_denominators(first.denominators)[0]
    predicted = filter_response(np.concatenate([leading, first.numerators[0]]), stable, r[0])
    return modified_least_squares(y[0], predicted, orders, Ts)
