"""lqrd and kalmd against quadrature, python-control, their continuous limits, and optimality."""

import control as reference
import numpy as np
import pytest
import scipy.linalg

from fieldmap import control
from fieldmap.errors import InputError

A = np.array([[0.0, 1.0, 0.0], [30.0, -4.0, 0.5], [0.0, 0.3, -2.0]])
B = np.array([[0.0], [1.0], [0.2]])
C = np.array([[1.0, 0.0, 0.1]])
Q, R = np.diag([3.0, 0.5, 0.1]), np.array([[0.02]])
TS = 0.05


def integral(function, upper):
    nodes, weights = np.polynomial.legendre.leggauss(40)
    return sum(0.5 * upper * w * function(0.5 * upper * (x + 1)) for x, w in zip(nodes, weights, strict=True))


def both(t):
    """exp([[A, B], [0, 0]] t), which maps the state and the held input over t."""
    return scipy.linalg.expm(np.block([[A, B], [np.zeros((1, 4))]]) * t)


def test_lqrd_minimises_the_integrated_cost():
    """The cost of a sample by quadrature, the sampled problem by python-control."""
    weight = scipy.linalg.block_diag(Q, R)
    cost = integral(lambda t: both(t).T @ weight @ both(t), TS)
    grown = both(TS)
    k, _, _ = reference.dlqr(grown[:3, :3], grown[:3, 3:], cost[:3, :3], cost[3:, 3:], cost[:3, 3:])
    np.testing.assert_allclose(control.lqrd(A, B, Q, R, TS), k, rtol=1e-9)


def test_lqrd_tends_to_the_continuous_regulator():
    """The error is of first order in Ts."""
    k, _, _ = reference.lqr(A, B, Q, R)
    errors = [np.abs(control.lqrd(A, B, Q, R, Ts) - k).max() for Ts in (4e-3, 2e-3, 1e-3)]
    assert 0.9 < np.log2(errors[0] / errors[1]) < 1.1
    assert 0.9 < np.log2(errors[1] / errors[2]) < 1.1


def test_any_other_gain_costs_more():
    """The cost from x0 of the sampled feedback, summed to rest."""
    weight = scipy.linalg.block_diag(Q, R)
    form = integral(lambda t: both(t).T @ weight @ both(t), TS)
    A_d, B_d = control.zero_order_hold(A, B, TS)

    def cost(k):
        total, x = 0.0, np.array([0.01, -0.02, 0.03])
        for _ in range(4000):
            z = np.concatenate([x, -k @ x])
            total += z @ form @ z
            x = A_d @ x + B_d @ (-k @ x)
        return total

    best = control.lqrd(A, B, Q, R, TS)
    lowest = cost(best)
    rng = np.random.default_rng(3)
    assert all(cost(best * (1 + 0.03 * rng.normal(size=3))) > lowest for _ in range(20))


def test_kalmd_is_the_filter_of_the_integrated_noise():
    Qn, Rn, G = np.array([[2.0]]), np.array([[0.01]]), np.array([[0.0], [1.0], [0.5]])
    added = integral(lambda t: scipy.linalg.expm(A * t) @ G @ Qn @ G.T @ scipy.linalg.expm(A.T * t), TS)
    A_d, B_d = control.zero_order_hold(A, B, TS)
    _, P, _ = reference.dlqe(A_d, np.eye(3), C, added, Rn / TS)
    estimator = control.kalmd(A, B, C, Qn, Rn, TS, G=G)
    M = P @ C.T / (C @ P @ C.T + Rn / TS)
    np.testing.assert_allclose(estimator.B_est, np.hstack([B_d, A_d @ M]), rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(estimator.D_est[1:, 1:], M, rtol=1e-7)
    np.testing.assert_allclose(estimator.A_est, A_d - A_d @ M @ C, rtol=1e-7, atol=1e-12)


def test_kalmd_tends_to_the_continuous_filter():
    L, _, _ = reference.lqe(A, B, C, np.array([[2.0]]), np.array([[0.01]]))
    errors = [
        np.abs(control.kalmd(A, B, C, 2.0, 0.01, Ts).B_est[:, 1:] / Ts - L).max() for Ts in (4e-4, 2e-4, 1e-4)
    ]
    assert 0.9 < np.log2(errors[0] / errors[1]) < 1.1
    assert errors[2] < 2e-2 * np.abs(L).max()


def test_innovations_are_white():
    """Innovations over 20 000 samples of the design noise are not correlated in time."""
    rng = np.random.default_rng(11)
    stable = A - B @ np.array([[60.0, 5.0, 0.0]])
    A_d, _ = control.zero_order_hold(stable, B, TS)
    Qn, Rn = 2.0, 0.01
    added = integral(
        lambda t: scipy.linalg.expm(stable * t) @ B * Qn @ B.T @ scipy.linalg.expm(stable.T * t), TS
    )
    shaped = rng.multivariate_normal(np.zeros(3), added, size=20_000, method="eigh")
    seen_noise = rng.normal(scale=np.sqrt(Rn / TS), size=20_000)
    estimator = control.kalmd(stable, B, C, Qn, Rn, TS)
    x, predicted, innovations = np.zeros(3), np.zeros(3), []
    for w, v in zip(shaped, seen_noise, strict=True):
        y = (C @ x)[0] + v
        innovations.append(y - (C @ predicted)[0])
        predicted = estimator.A_est @ predicted + estimator.B_est[:, 1] * y
        x = A_d @ x + w
    series = np.array(innovations[200:])
    lags = [np.corrcoef(series[n:], series[:-n])[0, 1] for n in (1, 2, 5)]
    assert np.abs(lags).max() < 4 / np.sqrt(series.size)


def test_direct_gain_is_taken_off():
    """y = C x + D u: the same filter, with y - D u as its input."""
    plain, direct = control.kalmd(A, B, C, 1.0, 0.1, TS), control.kalmd(A, B, C, 1.0, 0.1, TS, D=0.7)
    np.testing.assert_allclose(direct.A_est, plain.A_est)
    np.testing.assert_allclose(direct.B_est[:, 0], plain.B_est[:, 0] - 0.7 * plain.B_est[:, 1])
    np.testing.assert_allclose(direct.D_est[0, 0], 0.7 * (1 - plain.D_est[0, 1]))
    np.testing.assert_allclose(direct.D_est[1:, 0], -0.7 * plain.D_est[1:, 1])


@pytest.mark.parametrize(
    ("broken", "says"),
    [
        (lambda: control.lqrd(A, B, Q, R, 0.0), "Ts"),
        (lambda: control.lqrd(A, B, Q, R, -1e-3), "Ts"),
        (lambda: control.lqrd(A, B, Q, 0.0, TS), "definite"),
        (lambda: control.lqrd(A, B, -Q, R, TS), "semidefinite"),
        (lambda: control.lqrd(A, B, Q + np.eye(3, k=1), R, TS), "symmetric"),
        (lambda: control.lqrd(A, B, np.eye(2), R, TS), "3 x 3"),
        (lambda: control.lqrd(A * np.nan, B, Q, R, TS), "finite"),
        (lambda: control.lqrd([[1.0]], [[0.0]], 1.0, 1.0, TS), "stabilising"),
        (lambda: control.kalmd(A, B, C, 1.0, 0.0, TS), "definite"),
        (lambda: control.kalmd([[1.0]], [[1.0]], [[0.0]], 1.0, 1.0, TS), "stabilising"),
        (lambda: control.kalmd(A, B, np.eye(2), 1.0, 1.0, TS), "any x 3"),
        (lambda: control.lqrd([[0, 1.0], [3, 0]], [[0.0], [0]], np.eye(2), 1.0, TS), "leaves a pole at 1.0"),
        (lambda: control.kalmd([[0, 1.0], [3, 0]], [[0.0], [1]], [[0.0, 0]], 1.0, 1.0, TS), "stabilising"),
    ],
)
def test_bad_input(broken, says):
    with pytest.raises(InputError, match=says):
        broken()
