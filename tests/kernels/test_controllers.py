"""Controller and instrument kernels against a few lines of numpy; small, as they also run uncompiled."""

import numpy as np
import pytest

from fieldmap.kernels.control.instruments import convert, drive, held_scans, measure, round_to_step
from fieldmap.kernels.control.pid import PidGains, PidOptions, pid_run
from fieldmap.kernels.control.regulator import EstimatorRows, RegulatorSettings, regulator_run

IDEAL = np.array([0.0, 1.0, 0.0, -np.inf, np.inf, 0.0, 0.0, 0.0, -np.inf, np.inf])


@pytest.mark.parametrize(
    ("value", "step", "rounded"), [(0.26, 0.1, 0.3), (-0.26, 0.1, -0.3), (0.7, 0.0, 0.7), (-0.5, 1.0, 0.0)]
)
def test_round_to_step(value, step, rounded):
    assert round_to_step(value, step) == pytest.approx(rounded)


def test_limits_come_before_steps():
    assert convert(12.0, 0.3, -10.0, 10.0) == pytest.approx(9.9)
    assert measure(3.7, 0.0, IDEAL) == pytest.approx(3.7)
    assert drive(12.0, 0.0, np.array([0.0, -10.0, 10.0, 0.355, 0.1, -np.inf, 3.6])) == pytest.approx(3.6)


def test_pid_without_limits_is_a_filter():
    errors = np.array([1.0, -0.5, 0.25, 0.0])
    outputs = np.empty(4)
    pid_run(
        errors,
        errors,
        PidGains(2.0, 0.1, 3.0),
        PidOptions(-np.inf, np.inf, anti_windup=0.0, tracking=0.0, trapezoidal=0.0),
        np.zeros(3),
        outputs,
    )
    slopes = np.diff(errors, prepend=0.0)
    np.testing.assert_allclose(outputs, 2 * errors + 0.1 * np.cumsum(errors) + 3 * slopes)


def test_regulator_of_one_state():
    """Filtered state d y of an estimator without memory, feedback k, integral."""
    measured = np.array([0.1, 0.2, -0.1])
    outputs, states = np.empty(3), np.empty((3, 1))
    settings = RegulatorSettings(
        Ts=0.5,
        divisor=2.0,
        lower=-np.inf,
        upper=np.inf,
        estimate=1.0,
        intercept=0.0,
        slope=0.0,
        at_measured=0.0,
    )
    zero = np.zeros((1, 1))
    regulator_run(
        np.zeros(3), measured, EstimatorRows(zero, np.zeros((1, 2)), zero, np.array([0.8])), np.array([3.0, 4.0]),
        settings, np.zeros(3), outputs, states,
    )  # fmt: skip
    integral = 0.5 * np.array([0.0, 0.1, 0.3])
    np.testing.assert_allclose(states[:, 0], 0.8 * measured)
    np.testing.assert_allclose(outputs, -(3.0 * 0.8 * measured + 4.0 * integral) / 2.0)


def test_held_scans():
    scans, out = np.array([1.0, 3.0, 5.0, 7.0, 9.0]), np.empty(5)
    held_scans(scans, 2, 0, 1.0, out)
    np.testing.assert_array_equal(out, [1.0, 2.0, 2.0, 6.0, 6.0])
    held_scans(scans, 1, 2, 1.0, out)
    np.testing.assert_array_equal(out, [1.0, 1.0, 1.0, 3.0, 5.0])
    held_scans(scans, 1, 0, 0.5, out)
    np.testing.assert_array_equal(out, [1.0, 1.0, 3.0, 3.0, 5.0])
