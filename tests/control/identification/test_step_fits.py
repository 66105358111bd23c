import numpy as np
import pytest
from scipy.signal import lti, step

from fieldmap.control import step_metrics
from fieldmap.control.identification import fit_first_order, fit_second_order, noisy_step_metrics
from fieldmap.errors import InputError

T = np.linspace(0, 3, 1501)


def second_order(gain, w, damping):
    """Step response, integrated by scipy."""
    return step(lti([gain * w * w], [1.0, 2 * damping * w, w * w]), T=T)[1]


@pytest.mark.parametrize("damping", [0.05, 0.3, 0.7, 1.0, 1.6, 4.0])
def test_second_order_of_every_damping(damping):
    fit = fit_second_order(T, 2.0 * second_order(-1.5, 6.0, damping), step=2.0)
    found = [fit.parameters[name] for name in ("gain", "natural_frequency", "damping")]
    np.testing.assert_allclose(found, [-1.5, 6.0, damping], rtol=2e-5)
    assert fit.model.numerator[0] / fit.model.denominator[2] == pytest.approx(-1.5, rel=1e-5)


def test_errors_are_those_of_a_monte_carlo():
    rng = np.random.default_rng(2)
    clean = second_order(1.0, 6.0, 0.4)
    fits = [fit_second_order(T, clean + 0.02 * rng.normal(size=T.size)) for _ in range(60)]
    for name in ("gain", "natural_frequency", "damping"):
        values = np.array([f.parameters[name] for f in fits])
        truth = {"gain": 1.0, "natural_frequency": 6.0, "damping": 0.4}[name]
        assert abs(values.mean() - truth) < 4 * values.std() / np.sqrt(60)
        assert fits[0].errors[name] == pytest.approx(values.std(), rel=0.35)
    assert fits[0].residual_rms == pytest.approx(0.02, rel=0.1)


def test_first_order_through_noise():
    rng = np.random.default_rng(2)
    fit = fit_first_order(T, 3.0 * -np.expm1(-T / 0.45) + 0.05 * rng.normal(size=T.size))
    assert abs(fit.parameters["time_constant"] - 0.45) < 4 * fit.errors["time_constant"]
    assert abs(fit.gain - 3.0) < 4 * fit.errors["gain"]


def test_noisy_metrics_are_those_of_the_clean_step():
    rng = np.random.default_rng(2)
    clean = second_order(1.0, 12.0, 0.25)
    truth = step_metrics(T, clean)
    time = np.concatenate([-0.002 * np.arange(200, 0, -1), T])
    response = 8.0 + np.concatenate([np.zeros(200), clean]) + 0.0104 * rng.normal(size=time.size)
    found = noisy_step_metrics(time, response, before=200, window=31, band=0.05)
    truth_5 = step_metrics(T, clean, band=0.05)
    assert found.rise_time == pytest.approx(truth.rise_time, rel=0.03)
    assert found.peak_time == pytest.approx(truth.peak_time, rel=0.05)
    assert found.overshoot == pytest.approx(truth.overshoot, rel=0.05)
    assert found.settling_time == pytest.approx(truth_5.settling_time, rel=0.15)
    assert found.steady_rms == pytest.approx(0.0104, rel=0.15)


def test_a_band_within_the_noise_is_refused():
    rng = np.random.default_rng(2)
    time = 0.002 * np.arange(1200)
    response = (time > 0.4) * 1.0 + 0.2 * rng.normal(size=1200)
    with pytest.raises(InputError, match="four deviations"):
        noisy_step_metrics(time, response, before=200, window=11)


@pytest.mark.parametrize("fit", [fit_first_order, fit_second_order])
@pytest.mark.parametrize(
    ("time", "response", "height"),
    [(T[:5], T[:5], 1.0), (T, T[:-1], 1.0), (-T, T, 1.0), (T, T, 0.0), (T, np.where(T > 1, np.inf, T), 1.0)],
)
def test_unusable_steps(fit, time, response, height):
    with pytest.raises(InputError):
        fit(time, response, height)
