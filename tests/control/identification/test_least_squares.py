"""Estimators against records whose plant, noise and bias are known in closed form."""

import numpy as np
import pytest
from scipy.signal import lfilter

from fieldmap.control.identification import (
    Orders,
    armax,
    generalised_least_squares,
    least_squares,
    modified_least_squares,
    modified_least_squares_runs,
    recursive_least_squares,
)
from fieldmap.errors import InputError, NotConverged

TS = 2e-3
A, B = np.array([1.0, -1.5, 0.7]), np.array([1.0, 0.5])
ORDERS = Orders(poles=2, zeros=1)
ESTIMATORS = [least_squares, modified_least_squares, generalised_least_squares, armax]


def record(samples=4000, noise=0.0, seed=1, colour=(1.0,)):
    rng = np.random.default_rng(seed)
    u = rng.normal(size=samples)
    x = lfilter(np.r_[0.0, B], A, u)
    return x + noise * lfilter([1.0], colour, rng.normal(size=samples)), u


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_without_noise_the_plant_comes_back(estimator):
    found = estimator(*record(400), ORDERS, TS)
    np.testing.assert_allclose(found.model.denominator, A, rtol=1e-9)
    np.testing.assert_allclose(found.model.numerator, B, rtol=1e-9)
    assert found.steady_gain == pytest.approx(B.sum() / A.sum())


@pytest.mark.parametrize(
    ("orders", "numerator", "denominator"),
    [
        (Orders(1, 1), [0.5, 0.2], [1.0, -0.8]),
        (Orders(3, 1), [2.0, -1.0], [1.0, -1.2, 0.5, 0.1]),
        (Orders(2, 0, dead_time=3), [0.4], [1.0, -0.9, 0.2]),
    ],
)
def test_delays_of_other_structures(orders, numerator, denominator):
    u = np.random.default_rng(0).normal(size=300)
    y = lfilter(np.r_[np.zeros(orders.delay), numerator], denominator, u)
    found = modified_least_squares(y, u, orders, TS)
    np.testing.assert_allclose(found.model.numerator, numerator, rtol=1e-9)
    np.testing.assert_allclose(found.model.denominator[: orders.poles + 1], denominator, rtol=1e-9)
    np.testing.assert_allclose(found.simulate(u), y, atol=1e-9)
    assert found.fit(u, y) == pytest.approx(1.0)
    # The error is 1 everywhere: the fit is 1 less its ratio to the standard deviation.
    off = np.where(np.arange(300) % 2, 1.0, -1.0)
    measured = y + off
    assert found.fit(u, measured) == pytest.approx(1.0 - 1.0 / np.std(measured))
    assert found.fit(u, y + 100.0 * off) == pytest.approx(0.0, abs=1e-2)


def first_order_runs(sigma, runs=40, samples=8000):
    rng = np.random.default_rng(3)
    u, e = rng.normal(size=(2, runs, samples))
    return lfilter([0.0, 0.5], [1.0, -0.9], u) + sigma * e, u


def test_bias_of_plain_least_squares_is_that_of_the_formula():
    """White input and sensor noise: the pole is multiplied by R(0) / (R(0) + sigma^2), R(0) = b^2 / (1 - a^2)."""
    sigma = 1.0
    y, u = first_order_runs(sigma)
    poles = np.array([least_squares(a, b, Orders(1, 0), TS).poles[0] for a, b in zip(y, u, strict=True)])
    power = 0.5**2 / (1 - 0.9**2)
    error = poles.std() / np.sqrt(poles.size)
    assert abs(poles.mean() - 0.9 * power / (power + sigma**2)) < 4 * error
    assert abs(poles.mean() - 0.9) > 50 * error


def test_modified_least_squares_has_no_such_bias_and_knows_its_spread():
    y, u = first_order_runs(1.0)
    found = modified_least_squares_runs(y, u, Orders(1, 0))
    poles = found.poles[:, 0].real
    assert found.converged.all()
    assert abs(poles.mean() - 0.9) < 4 * poles.std() / np.sqrt(poles.size)
    stated = modified_least_squares(y[0], u[0], Orders(1, 0), TS).pole_errors[0]
    assert stated == pytest.approx(poles.std(), rel=0.35)  # the spread of 40 runs has an uncertainty of 11 %


def test_dead_time_adds_poles_at_zero_without_error():
    y, u = record(2000, 0.1)
    late = np.concatenate([np.zeros(3), y[:-3]])
    found = modified_least_squares(late, u, Orders(2, 1, dead_time=3), TS)
    plain = modified_least_squares(y[:-3], u[:-3], ORDERS, TS)
    np.testing.assert_allclose(found.poles[:2], plain.poles, rtol=1e-3)
    np.testing.assert_allclose(found.pole_errors[:2], plain.pole_errors, rtol=0.05)
    assert np.all(found.poles[2:] == 0.0)
    assert np.all(found.pole_errors[2:] == 0.0)


def test_coloured_noise_leads_it_astray_and_armax_follows():
    """Sensor noise 1 / (1 - 0.95 q^-1) violates (5-4) and (5-5), so the modified method finds another plant; the model
    A y = B u + C v with one more pole in A and B includes this noise."""
    runs = [record(3000, 1.0, seed, colour=(1.0, -0.95)) for seed in range(6)]
    modified = np.array([modified_least_squares(*r, ORDERS, TS).model.denominator for r in runs])
    full = np.array([armax(*r, Orders(3, 2), TS, noise_order=2).model.denominator for r in runs])
    error = full.std(0)[1:] / np.sqrt(len(runs))
    assert np.all(np.abs(full.mean(0) - np.convolve(A, [1.0, -0.95]))[1:] < 5 * error)
    assert np.all(np.abs(modified - A)[:, 1:] > 0.1)


def test_generalised_least_squares_whitens_autoregressive_errors():
    """A y = B u + v / D is its own model; plain least squares is far off there."""
    rng = np.random.default_rng(8)
    u, v = rng.normal(size=(2, 20000))
    y = lfilter(np.r_[0.0, B], A, u) + lfilter([1.0], np.convolve(A, [1.0, -0.8]), 2.0 * v)
    found = generalised_least_squares(y, u, ORDERS, TS, noise_order=1)
    error = np.abs(found.model.denominator - A)[1:]
    assert np.all(error < 4 * found.standard_errors[:2])
    assert np.abs(least_squares(y, u, ORDERS, TS).model.denominator - A).max() > 10 * error.max()


def test_armax_recovers_the_noise_polynomial():
    rng = np.random.default_rng(4)
    u, v = rng.normal(size=(2, 8000))
    c = [1.0, -0.6, 0.25]
    y = lfilter(np.r_[0.0, B], A, u) + lfilter(c, A, v)
    found = armax(y, u, ORDERS, TS)
    np.testing.assert_allclose(found.noise, c, atol=0.05)
    assert np.all(np.abs(found.model.denominator - A)[1:] < 4 * found.standard_errors[:2])
    assert found.residual_rms == pytest.approx(1.0, rel=0.05)


def test_recursive_extended_takes_the_bias_away():
    y, u = record(20000, 1.0)
    plain = recursive_least_squares(y, u, ORDERS).model.denominator
    extended = recursive_least_squares(y, u, ORDERS, noise_order=2).model.denominator
    assert np.abs(extended - A).max() < 0.2 * np.abs(plain - A).max()


def test_runs_and_single_records_agree():
    y, u = first_order_runs(0.3, runs=3, samples=500)
    together = modified_least_squares_runs(y, u, Orders(2, 1))
    for run in range(3):
        alone = modified_least_squares_runs(y[run], u[run], Orders(2, 1))
        np.testing.assert_allclose(together.denominators[run], alone.denominators[0], rtol=1e-12)


@pytest.mark.parametrize("estimator", [*ESTIMATORS, lambda y, u, o, t: recursive_least_squares(y, u, o)])
@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda y, u: (np.where(np.arange(y.size) == 7, np.nan, y), u), "finite"),
        (lambda y, u: (y, u[:-1]), "one length"),
        (lambda y, u: (y[:9], u[:9]), "at least"),
    ],
)
def test_unusable_records(estimator, spoil, says):
    with pytest.raises(InputError, match=says):
        estimator(*spoil(*record(200)), ORDERS, TS)


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_an_input_that_does_not_move(estimator):
    with pytest.raises(InputError) as error:
        estimator(np.ones(500), np.ones(500), ORDERS, TS)
    assert error.value.problems[0].where.startswith(estimator.__name__)


def test_bad_sampling_time_and_orders():
    with pytest.raises(InputError, match="Ts"):
        least_squares(*record(100), ORDERS, 0.0)
    with pytest.raises(InputError, match="Orders"):
        Orders(poles=1, zeros=2)


def test_what_does_not_settle_is_said():
    y, u = record(300, 1.0)
    with pytest.raises(NotConverged) as caught:
        modified_least_squares(y, u, Orders(6, 5), TS, iterations=3)
    assert len(caught.value.residuals) == 3
