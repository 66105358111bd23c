"""Least squares on past outputs and inputs, in one solution and recursively, against their closed forms."""

import numpy as np
import pytest

from fieldmap.control.identification import Orders, recursive_least_squares, regression
from fieldmap.errors import InputError

RNG = np.random.default_rng(5)
Y, U = RNG.normal(size=(3, 40)), RNG.normal(size=(3, 40))


def regressors(y, u, orders):
    """The regressor matrix, sample by sample."""
    return np.array(
        [
            [-y[n - i] for i in range(1, orders.poles + 1)]
            + [u[n - orders.delay - i] for i in range(orders.zeros + 1)]
            for n in range(orders.first, y.size)
        ]
    )


@pytest.mark.parametrize("orders", [Orders(2, 1), Orders(1, 1), Orders(3, 0, 1), Orders(4, 3, 2)], ids=repr)
def test_the_triangle_has_the_products_of_the_columns(orders):
    found = regression.solve(Y, U, orders, "here")
    for run in range(3):
        columns, target = regressors(Y[run], U[run], orders), Y[run, orders.first :]
        r = found.triangle[run]
        np.testing.assert_allclose(r.T @ r, columns.T @ columns, rtol=1e-12, atol=1e-12)
        assert np.all(np.tril(r, -1) == 0.0)
        coefficients, squares, *_ = np.linalg.lstsq(columns, target)
        np.testing.assert_allclose(found.coefficients[run], coefficients, rtol=1e-10)
        np.testing.assert_allclose(found.squares[run], squares[0], rtol=1e-10)
        scaled = columns / np.linalg.norm(columns, axis=0)
        np.testing.assert_allclose(found.condition[run], np.linalg.cond(scaled), rtol=1e-10)
    assert found.samples == 40 - orders.first


def test_few_runs_at_once_change_nothing(monkeypatch):
    orders = Orders(2, 1)
    y, u = RNG.normal(size=(5, 700)), RNG.normal(size=(5, 700))
    whole = regression.solve(y, u, orders, "here")
    monkeypatch.setattr(regression, "_AT_ONCE", 5 * 698 * 2)
    parts = regression.solve(y, u, orders, "here")
    np.testing.assert_allclose(parts.coefficients, whole.coefficients, rtol=1e-10)
    np.testing.assert_allclose(parts.squares, whole.squares, rtol=1e-10)
    for one, other in zip(parts.triangle, whole.triangle, strict=True):
        np.testing.assert_allclose(one.T @ one, other.T @ other, rtol=1e-12, atol=1e-11)


def test_as_many_samples_as_coefficients_leave_no_errors():
    orders = Orders(1, 1)
    found = regression.solve(Y[:1, :4], U[:1, :4], orders, "here")
    columns = regressors(Y[0, :4], U[0, :4], orders)
    assert columns.shape == (3, 3)
    np.testing.assert_allclose(found.coefficients[0], np.linalg.solve(columns, Y[0, 1:4]), rtol=1e-9)
    assert found.squares == pytest.approx(0.0, abs=1e-25)
    with pytest.raises(InputError, match="depend"):
        regression.solve(Y[:1, :3], U[:1, :3], orders, "here")


def test_recursion_ends_at_the_least_squares_with_its_prior():
    """(X'X + P0^-1)^-1 X'y in closed form; the estimate at each sample uses the samples before it."""
    orders = Orders(2, 1)
    run = recursive_least_squares(Y[0], U[0], orders, start_variance=1e3)
    x = regressors(Y[0], U[0], orders)
    for n in (2, 3, 17, 39):
        some = x[: n - 1]
        expected = np.linalg.solve(some.T @ some + 1e-3 * np.eye(4), some.T @ Y[0, 2 : n + 1])
        np.testing.assert_allclose(run.history[n], expected, rtol=1e-8)
    assert np.all(run.history[:2] == 0.0)


def test_forgetting_weighs_old_samples_less():
    orders = Orders(1, 0)
    run = recursive_least_squares(Y[0], U[0], orders, forgetting=0.9)
    x = regressors(Y[0], U[0], orders)
    weights = 0.9 ** np.arange(x.shape[0])[::-1]
    expected = np.linalg.solve(x.T @ (weights[:, None] * x), x.T @ (weights * Y[0, 1:]))
    np.testing.assert_allclose(run.history[-1], expected, rtol=1e-5)


def test_extended_recursion_written_out():
    """Ljung's (11.45); errors after the update, newest first, follow the regressors."""
    orders, noise = Orders(2, 1), 2
    run = recursive_least_squares(Y[0], U[0], orders, noise_order=noise, forgetting=0.98, start_variance=50.0)
    theta, information, errors = np.zeros(6), np.eye(6) / 50.0, [0.0, 0.0]
    for known, y, found in zip(regressors(Y[0], U[0], orders), Y[0, 2:], run.history[2:], strict=True):
        row = np.array([*known, *errors])
        information = 0.98 * information + np.outer(row, row)
        theta = theta + np.linalg.solve(information, row) * (y - row @ theta)
        errors = [y - row @ theta, errors[0]]
        np.testing.assert_allclose(found, theta, rtol=1e-7, atol=1e-9)
