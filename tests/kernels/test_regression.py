import numpy as np
import pytest

from fieldmap.kernels.control.regression import Structure, recursive, triangles

RNG = np.random.default_rng(5)
Y, U = RNG.normal(size=(2, 40)), RNG.normal(size=(2, 40))


def regressors(y, u, poles, terms, delay, first):
    """Written out, sample by sample."""
    return np.array(
        [
            [-y[n - i] for i in range(1, poles + 1)] + [u[n - delay - i] for i in range(terms)]
            for n in range(first, y.size)
        ]
    )


@pytest.mark.parametrize(("poles", "terms", "delay"), [(2, 2, 1), (1, 3, 0), (3, 1, 4)])
def test_triangle_has_the_products_of_the_columns(poles, terms, delay):
    first = max(poles, delay + terms - 1)
    out = np.empty((2, poles + terms + 1, poles + terms + 1))
    triangles(Y, U, poles, terms, delay, first, out)
    for run in range(2):
        columns = regressors(Y[run], U[run], poles, terms, delay, first)
        both = np.column_stack([columns, Y[run, first:]])
        np.testing.assert_allclose(out[run].T @ out[run], both.T @ both, rtol=1e-12, atol=1e-12)
        assert np.all(np.tril(out[run], -1) == 0.0)


def test_recursion_ends_at_the_least_squares_with_its_prior():
    """(X'X + P0^-1)^-1 X'y, in closed form."""
    theta, covariance, history = np.zeros(4), 1e3 * np.eye(4), np.empty((40, 4))
    recursive(
        Y[0], U[0], Structure(poles=2, terms=2, delay=1, noise=0, first=2), 1.0, theta, covariance, history
    )
    x = regressors(Y[0], U[0], 2, 2, 1, 2)
    np.testing.assert_allclose(theta, np.linalg.solve(x.T @ x + 1e-3 * np.eye(4), x.T @ Y[0, 2:]), rtol=1e-9)
    np.testing.assert_allclose(covariance, np.linalg.inv(x.T @ x + 1e-3 * np.eye(4)), rtol=1e-9)
    assert np.all(history[-1] == theta)


def test_forgetting_weighs_old_samples_less():
    theta, covariance, history = np.zeros(2), 1e6 * np.eye(2), np.empty((40, 2))
    recursive(
        Y[0], U[0], Structure(poles=1, terms=1, delay=1, noise=0, first=1), 0.9, theta, covariance, history
    )
    x = regressors(Y[0], U[0], 1, 1, 1, 1)
    weights = 0.9 ** np.arange(x.shape[0])[::-1]
    expected = np.linalg.solve(x.T @ (weights[:, None] * x), x.T @ (weights * Y[0, 1:]))
    np.testing.assert_allclose(theta, expected, rtol=1e-5)
