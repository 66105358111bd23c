"""The PID controller against its law (5-10) written out, scipy's filters, and what limits must do."""

import numpy as np
import pytest
import scipy.signal

from fieldmap.control import PID, RunningPID, pid_transfer_function, run_pid
from fieldmap.errors import InputError

TS = 2e-3
SETTINGS = [(0.5, 0.007, 0.001), (0.334, 0.007, 0.001), (1.0, np.inf, 1e-6), (0.2, 0.006, 0.0)]
ERRORS = np.random.default_rng(1).normal(size=200)


@pytest.mark.parametrize("integration", ["rectangular", "trapezoidal"])
@pytest.mark.parametrize(("Kc", "Ti", "Td"), SETTINGS)
def test_transfer_function_is_what_runs(Kc, Ti, Td, integration):
    numerator, denominator = pid_transfer_function(Kc, Ti, Td, TS, integration=integration)
    filtered = scipy.signal.lfilter(numerator, denominator, ERRORS)
    ours = run_pid(PID(Kc, Ti, Td, TS, integration=integration), ERRORS, 0 * ERRORS)
    np.testing.assert_allclose(ours, filtered, rtol=1e-9, atol=1e-11)


def written_out(pid, references, measured):
    """(1) and (2) of docs/theory/control.md, sample by sample."""
    sign = -1.0 if pid.acts_on_minus_error else 1.0
    time = pid.tracking_time or (np.sqrt(pid.Ti * pid.Td) if pid.Td else pid.Ti)
    integral = error = slope = 0.0
    outputs = []
    for reference, seen in zip(references, measured, strict=True):
        before, error = error, sign * (reference - seen)
        steep, slope = slope, error if pid.derivative == "error" else -sign * seen
        added = pid.Kc * TS / pid.Ti * ((error + before) / 2 if pid.integration == "trapezoidal" else error)
        wanted = pid.Kc * error + integral + added + pid.Kc * pid.Td / TS * (slope - steep)
        outputs.append(np.clip(wanted, pid.lower, pid.upper))
        beyond = wanted - outputs[-1]
        if pid.anti_windup != "hold" or beyond * added <= 0:
            integral += added
        if pid.anti_windup == "track":
            integral -= min(1.0, TS / time) * beyond
    return outputs


@pytest.mark.parametrize("integration", ["rectangular", "trapezoidal"])
@pytest.mark.parametrize("anti_windup", ["none", "hold", "track"])
@pytest.mark.parametrize("derivative", ["error", "measurement"])
@pytest.mark.parametrize("minus", [True, False])
@pytest.mark.parametrize(("Td", "tracking"), [(0.004, None), (0.0, None), (0.004, 0.03), (0.004, 1e-9)])
def test_the_law_written_out(integration, anti_windup, derivative, minus, Td, tracking):
    """To 1e-12 of the largest term, with limits that it is at for a part of the time."""
    pid = PID(0.5, 0.05, Td, TS, -1.0, 1.5, integration, anti_windup, tracking, derivative, minus)
    references, measured = 0.3 * ERRORS[::-1], np.cumsum(ERRORS) / 4
    expected = written_out(pid, references, measured)
    np.testing.assert_allclose(run_pid(pid, references, measured), expected, rtol=0, atol=2e-12)
    assert 10 < np.sum(np.isin(expected, [-1.0, 1.5])) < 195


def test_one_call_a_sample_is_the_same():
    pid = PID(0.5, 0.007, 0.001, TS, lower=-1.0, upper=1.5, anti_windup="track", acts_on_minus_error=True)
    running = RunningPID(pid)
    stepped = [running.step(0.3, measured) for measured in ERRORS]
    np.testing.assert_array_equal(stepped, run_pid(pid, 0.3, ERRORS))
    running.reset()
    assert running.step(0.3, ERRORS[0]) == stepped[0]


@pytest.mark.parametrize(("anti_windup", "samples"), [("none", 1500), ("hold", 2), ("track", 12)])
def test_the_way_back_from_a_limit(anti_windup, samples):
    """A second of error 1, then error -1: an integral wound up to 50 takes as long to unwind; PI, Ti = 20 ms."""
    pid = PID(1.0, 0.02, 0.0, TS, upper=2.0, anti_windup=anti_windup)
    errors = np.concatenate([np.ones(500), -np.ones(1500)])
    outputs = run_pid(pid, errors, 0 * errors)
    below = int(np.argmax(outputs[500:] < 2.0))
    assert outputs[499] == 2.0
    assert below <= samples
    assert (below > 400) == (anti_windup == "none")


def test_tracking_time_is_that_of_an_exponential():
    """With the output held at its limit the wound-up excess decays to 1/e in Tt (PI without error)."""
    pid = PID(1.0, 1e6, 0.0, TS, upper=1.0, anti_windup="track", tracking_time=0.1)
    running = RunningPID(pid)
    running.reset(integral=11.0)
    for _ in range(50):
        running.step(0.0, 0.0)
    # Of an error of -5 the output is the integral less 5, within its limit again.
    assert running.step(-5.0, 0.0) + 5.0 - 1.0 == pytest.approx(10.0 / np.e, rel=0.02)


def test_from_rest_without_integral_the_pole_at_one_is_gone():
    numerator, denominator = pid_transfer_function(2.0, np.inf, 0.004, TS)
    assert len(denominator) == 2
    np.testing.assert_allclose(np.polyval(numerator, 1.0) / np.polyval(denominator, 1.0), 2.0)


@pytest.mark.parametrize(
    ("broken", "says"),
    [
        (lambda: PID(0.5, 0.007, 0.001, 0.0), "Ts"),
        (lambda: PID(0.5, 0.0, 0.001, TS), "Ti"),
        (lambda: PID(0.5, np.nan, 0.001, TS), "Ti"),
        (lambda: PID(np.inf, 0.007, 0.001, TS), "Kc"),
        (lambda: PID(0.5, 0.007, -0.001, TS), "Td"),
        (lambda: PID(0.5, 0.007, 0.001, TS, lower=1.0, upper=1.0), "rise"),
        (lambda: PID(0.5, 0.007, 0.001, TS, anti_windup="yes"), "none, hold, track"),
        (lambda: PID(0.5, 0.007, 0.001, TS, integration="euler"), "rectangular"),
        (lambda: PID(0.5, 0.007, 0.001, TS, tracking_time=0.0), "tracking_time"),
        (lambda: pid_transfer_function(0.5, 0.007, 0.001, 0.0), "Ts"),
        (lambda: run_pid(PID(0.5, 0.007, 0.001, TS), 0.0, [0.0, np.nan]), "entry 1"),
        (lambda: RunningPID(PID(0.5, 0.007, 0.001, TS)).step(0.0, np.inf), "measured"),
    ],
)
def test_bad_input(broken, says):
    with pytest.raises(InputError, match=says):
        broken()


def test_a_bad_sample_does_no_harm():
    running = RunningPID(PID(0.5, 0.007, 0.001, TS))
    twin = RunningPID(PID(0.5, 0.007, 0.001, TS))
    assert running.step(1.0, 0.0) == twin.step(1.0, 0.0)
    with pytest.raises(InputError):
        running.step(1.0, np.nan)
    assert running.step(1.0, 0.1) == twin.step(1.0, 0.1)
