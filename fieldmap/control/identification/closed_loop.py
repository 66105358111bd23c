"""Identification of a plant from records of its closed loop: docs/theory/identification.md (12), (15), (16).

The loop is u = C (r - y), y = P u + noise; y is what the sensor says. Three ways: from u and y (direct), from r and y
with the controller known (indirect), from r, u and y without it (two-stage).
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial.polynomial import polyadd
from numpy.typing import ArrayLike, NDArray

from fieldmap.arguments import check, check_positive
from fieldmap.control.identification.estimators import modified_least_squares, modified_least_squares_runs
from fieldmap.control.identification.regression import (
    Estimate,
    Orders,
    Solution,
    check_records,
    columns_of,
    estimate_of,
    polynomials,
    settled,
    solve,
    stable_denominators,
)
from fieldmap.control.linear_models import filter_response, transfer_function
from fieldmap.typing import Array

_NOISE_FREE_REFERENCE = "the reference does not depend on the noise; the noise may be of any colour"


def identify_direct(outputs: ArrayLike, controls: ArrayLike, orders: Orders, Ts: float) -> Estimate:
    """The plant from the controller's output and the measured position, as if the loop were open.

    Modified least squares. White noise of the sensor does no harm in spite of the feedback, if the plant has a delay
    of a sample or more: with the unstable poles reflected, (6) is the innovations form of the plant with that noise.
    Forces on the body that the control signal does not show, and coloured noise, bias it: then use `armax`, which
    models them, or an indirect way. Without a reference signal the conditions (12) must hold. Raises InputError for
    unusable records and NotConverged.
    """
    must, received = (
        "must have more poles than zeros, or dead time",
        f"{orders.poles} poles, {orders.zeros} zeros",
    )
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

    controller: numerator and denominator in q of u / (r - y), with its sign (negative for a plant of negative gain).
    Only the plant's coefficients are estimated, so nothing has to cancel afterwards. Instruments are the noise-free
    records that the current model predicts (Gilson and Van den Hof, Automatica 41 (2005) 241): consistent for any
    noise that does not depend on the reference, if the controller is right. Raises InputError and NotConverged.
    """
    where = "identify_indirect"
    check_positive(where, Ts=Ts)
    top, bottom = transfer_function(*controller)
    above = np.concatenate([np.zeros(bottom.size - top.size), top])
    y, r = check_records(where, orders, outputs=outputs, references=references)
    outward, driven = filter_response(bottom, [1.0], y), filter_response(above, [1.0], r - y)
    # Plain least squares is too far off to start from: what the controller must have sent, and the direct way.
    found = modified_least_squares_runs(y, filter_response(above, bottom, r - y), orders, iterations=30)
    start = np.hstack([found.denominators[:, 1 : orders.poles + 1], found.numerators])

    def advance(_: NDArray[np.intp], coefficients: Array) -> Solution:
        """Z' Phi theta = Z' w with instruments Z; triangle and condition are those of the instruments, for (14)."""
        a, b = (polynomial[0] for polynomial in polynomials(coefficients, orders))
        forward = np.convolve(above, np.concatenate([np.zeros(orders.delay), b]))
        # Of the closed loop, its unstable roots reflected; and the position without noise.
        stable = stable_denominators(polyadd(np.convolve(bottom, a), forward)[None, :])[0]
        predicted = filter_response(forward, stable, r)
        free = filter_response(bottom, [1.0], predicted), filter_response(above, [1.0], r - predicted)
        w, v, w_free, v_free = (filter_response([1.0], stable, x) for x in (outward, driven, *free))
        matched = solve(w_free, v_free, orders, where)
        columns, instruments = columns_of(w, v, orders)[0], columns_of(w_free, v_free, orders)[0]
        target = w[0, orders.first :]
        theta = np.linalg.solve(instruments.T @ columns, instruments.T @ target)
        errors = target - columns @ theta
        return matched._replace(coefficients=theta[None, :], squares=np.array([errors @ errors]))

    remedy = "check the controller's sign and sampling time; ask for fewer poles and zeros"
    solution, count = settled(where, start, advance, tolerance, iterations, remedy)
    notes = (_NOISE_FREE_REFERENCE, "the controller is as given, never at its limits")
    method = "closed loop, known controller, refined instruments"
    return estimate_of(solution, orders, Ts, method, count, notes)


def identify_two_stage(
    outputs: ArrayLike,
    controls: ArrayLike,
    references: ArrayLike,
    orders: Orders,
    Ts: float,
    *,
    loop: Orders,
) -> Estimate:
    """The plant in two stages, without knowing the controller: Van den Hof and Schrama (Automatica 29
    (1993) 1523).

    First u from r with the structure `loop` (Orders(4, 4) for two poles and a PID); what that model predicts
    is free of noise, and is the input of a modified least squares for y. Poles and zeros of the first stage are not
    looked at, so near cancellations there do no harm; too few do. The plant comes out with the bias of the first
    stage, so this is the least exact of the three. Raises InputError and NotConverged.
    """
    where = "identify_two_stage"
    check_positive(where, Ts=Ts)
    y, u, r = check_records(where, orders, outputs=outputs, controls=controls, references=references)
    first = modified_least_squares_runs(u[0], r[0], loop, iterations=30)
    leading = np.zeros(loop.delay)
    stable = stable_denominators(first.denominators)[0]
    predicted = filter_response(np.concatenate([leading, first.numerators[0]]), stable, r[0])
    return modified_least_squares(y[0], predicted, orders, Ts)
