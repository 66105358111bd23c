"""Absolute accuracy of converter cards against published data sheets, and the error budget of Appendix C."""

import numpy as np
import pytest

from fieldmap.errors import InputError
from fieldmap.instruments import Converter, Micrometer, absolute_accuracy, error_budget

PPM = 1e-6
THESIS_CARD = Converter(
    10.0, 16, 280e-6, 60 * PPM, 20 * PPM, gain_drift=13 * PPM, offset_drift=21 * PPM, reference_drift=1 * PPM,
    nonlinearity=60 * PPM,
)  # fmt: skip
# NI 6225 specifications: range V, gain error, gain drift, reference drift, offset error, offset drift,
# nonlinearity (ppm), noise (uV rms), printed accuracy at full scale for the mean of 100 readings (uV).
NI_6225 = [
    (10.0, 75, 25, 5, 20, 57, 76, 244, 3100),
    (5.0, 85, 25, 5, 20, 60, 76, 122, 1620),
    (1.0, 95, 25, 5, 25, 79, 76, 30, 360),
    (0.2, 135, 25, 5, 80, 175, 76, 13, 112),
]


@pytest.mark.parametrize("row", NI_6225)
def test_accuracy_of_another_card(row):
    """Data sheets print two or three digits."""
    span, gain, gain_drift, reference, offset, offset_drift, nonlinearity, noise, printed = row
    card = Converter(
        span, 16, noise * 1e-6, gain * PPM, offset * PPM, gain_drift * PPM, offset_drift * PPM, reference * PPM,
        nonlinearity * PPM,
    )  # fmt: skip
    total = float(absolute_accuracy(card, span, averages=100).total)
    assert 1e6 * total == pytest.approx(printed, rel=5e-3)


def test_net_errors_of_a_third_card():
    """NI sbRIO-961x, 5 K and 45 K after calibration: gain 434 ppm, offset 341 ppm."""
    card = Converter(10.0, 16, 0.0, 94 * PPM, 20 * PPM, 23 * PPM, 49 * PPM, 5 * PPM, 76 * PPM)
    accuracy = absolute_accuracy(card, 10.0, internal_change=5.0, external_change=45.0)
    assert accuracy.net_gain_error == pytest.approx(434 * PPM)
    assert accuracy.net_offset_error == pytest.approx(341 * PPM)


def test_accuracy_of_the_thesis():
    """1850 uV at 0, 2680 uV at full scale (3.9.1, Appendix B), the same for both signs."""
    accuracy = absolute_accuracy(THESIS_CARD, [0.0, 10.0, -10.0])
    np.testing.assert_allclose(accuracy.total, [1850e-6, 2680e-6, 2680e-6], rtol=1e-12)
    assert accuracy.net_gain_error == pytest.approx(83 * PPM)
    assert accuracy.net_offset_error == pytest.approx(101 * PPM)
    assert accuracy.noise_uncertainty == pytest.approx(840e-6)


def test_the_printed_gain_error_is_the_net_one():
    """If 83 ppm were the residual gain error, as Table B-1 says, the result at full scale would be 2910 uV."""
    card = Converter(10.0, 16, 280e-6, 83 * PPM, 20 * PPM, 13 * PPM, 21 * PPM, 1 * PPM, nonlinearity=60 * PPM)
    assert float(absolute_accuracy(card, 10.0).total) == pytest.approx(2910e-6)


def test_table_c_1():
    sensor = Micrometer(zero=0.020, scale=2e-3, voltage_step=5e-3)
    budget = error_budget(0.030001, 4e-6, sensor, THESIS_CARD, converter_step=305e-6)
    np.testing.assert_allclose(1e3 * budget.measured, [30.01463, 30.00557, 29.99581, 30.00487], atol=5e-6)
    np.testing.assert_allclose(1e3 * budget.errors, [-0.01363, -0.00457, 0.00519, -0.00387], atol=5e-6)
    np.testing.assert_array_equal(budget.steps, [16410, 16394])
    nearest = error_budget(0.030001, 4e-6, sensor, THESIS_CARD, converter_step=305e-6, rounding="nearest")
    np.testing.assert_array_equal(nearest.steps, [16410, 16393])


def test_nothing_is_lost_where_nothing_rounds():
    """With a stepless sensor and an errorless converter of 50 bits the measurement equals the position."""
    budget = error_budget(0.0123, 0.0, Micrometer(zero=0.020, scale=2e-3), Converter(10.0, 50))
    np.testing.assert_allclose(budget.measured, 0.0123, rtol=1e-12)


@pytest.mark.parametrize(
    ("broken", "says"),
    [
        (lambda: Converter(0.0, 16), "range"),
        (lambda: Converter(10.0, 0), "bits"),
        (lambda: Converter(10.0, 16, random_noise=-1e-6), "random_noise"),
        (lambda: absolute_accuracy(THESIS_CARD, np.nan), "finite"),
        (lambda: absolute_accuracy(THESIS_CARD, 1.0, averages=0), "averages"),
        (lambda: absolute_accuracy(THESIS_CARD, 1.0, internal_change=-1.0), "internal_change"),
        (lambda: error_budget(np.inf, 0.0, Micrometer(0.0, 1.0), THESIS_CARD), "position"),
        (lambda: error_budget(0.0, 0.0, Micrometer(0.0, 1.0), THESIS_CARD, rounding="down"), "up, nearest"),
        (
            lambda: error_budget(0.0, 0.0, Micrometer(0.0, 1.0), THESIS_CARD, converter_step=0.0),
            "converter_step",
        ),
    ],
)
def test_bad_input(broken, says):
    with pytest.raises(InputError, match=says):
        broken()
