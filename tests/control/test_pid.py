"""The PID controller against its law written out, scipy's filters, and results by hand at limits."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal

from fieldmap.control import PID, RunningPID, pid_transfer_function, run_pid
from fieldmap.control.pid import ANTI_WINDUP
from fieldmap.errors import InputError

TS = 2e-3
SETTINGS = [(0.5, 0.007, 0.001), (0.334, 0.007, 0.001), (1.0, np.inf, 1e-6), (0.2, 0.006, 0.0)]
ERRORS = np.random.default_rng(1).normal(size=200)


RULES = {"rectangular": "backward_diff", "trapezoidal": "bilinear"}


@pytest.mark.parametrize("integration", RULES)
@pytest.mark.parametrize("Tf", [0.0, 3e-4, 0.02])
@pytest.mark.parametrize(("Kc", "Ti", "Td"), SETTINGS)
def test_it_is_the_textbook_controller_sampled_by_scipy(Kc, Ti, Td, Tf, integration):
    """Kc (1 + 1 / (s Ti) + s Td / (1 + s Tf)) (Astrom and Murray, Feedback Systems, 2nd edition, section 11.5), each
    part sampled separately; the derivative by backward differences."""

    def part(top, bottom, rule):
        (numerator,), denominator, _ = scipy.signal.cont2discrete((top, bottom), TS, rule)
        return scipy.signal.lfilter(numerator, denominator, ERRORS)

    integral = 0.0 if Ti == np.inf else part([1.0], [Ti, 0.0], RULES[integration])
    of_error = part([1.0, 0.0], [Tf, 1.0], "backward_diff") if Tf else np.diff(ERRORS, prepend=0.0) / TS
    expected = Kc * (ERRORS + integral + Td * of_error)
    ours = run_pid(PID(Kc, Ti, Td, TS, Tf=Tf, integration=integration), ERRORS, 0 * ERRORS)
    np.testing.assert_allclose(ours, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
    numerator, denominator = pid_transfer_function(Kc, Ti, Td, TS, Tf=Tf, integration=integration)
    filtered = scipy.signal.lfilter(numerator, denominator, ERRORS)
    np.testing.assert_allclose(filtered, expected, rtol=1e-9, atol=1e-11 * np.abs(expected).max())


def written_out(pid, references, measured):
    """(1) and (2) of docs/theory/control.md, sample by sample."""
    sign = -1.0 if pid.acts_on_minus_error else 1.0
    time = pid.tracking_time or (np.sqrt(pid.Ti * pid.Td) if pid.Td else pid.Ti)
    integral = error = slope = derivative = 0.0
    outputs = []
    for reference, seen in zip(references, measured, strict=True):
        before, error = error, sign * (reference - seen)
        steep, slope = slope, sign * (pid.c * reference - seen)
        derivative *= pid.Tf / (pid.Tf + TS)
        derivative += pid.Kc * pid.Td / (pid.Tf + TS) * (slope - steep)
        added = pid.Kc * TS / pid.Ti * ((error + before) / 2 if pid.integration == "trapezoidal" else error)
        wanted = pid.Kc * sign * (pid.b * reference - seen) + integral + added + derivative
        outputs.append(np.clip(wanted, pid.lower, pid.upper))
        beyond = wanted - outputs[-1]
        if pid.anti_windup != "clamping" or beyond * added <= 0:
            integral += added
        if pid.anti_windup == "back_calculation":
            integral -= min(1.0, TS / time) * beyond
    return outputs


@pytest.mark.parametrize("integration", RULES)
@pytest.mark.parametrize("anti_windup", ANTI_WINDUP)
@pytest.mark.parametrize("minus", [True, False])
@pytest.mark.parametrize(("Tf", "b", "c"), [(0.0, 1.0, 1.0), (0.0, 0.6, 0.0), (0.003, 1.0, 0.3)])
@pytest.mark.parametrize(("Td", "tracking"), [(0.004, None), (0.0, None), (0.004, 0.03), (0.004, 1e-9)])
def test_the_law_written_out(integration, anti_windup, minus, Tf, b, c, Td, tracking):
    """To 1e-12 of the largest term; the output is at its limits for a part of the time."""
    pid = PID(0.5, 0.05, Td, TS, -1.0, 1.5, integration, anti_windup, tracking, Tf, minus, b, c)
    references, measured = 0.3 * ERRORS[::-1], np.cumsum(ERRORS) / 4
    expected = written_out(pid, references, measured)
    np.testing.assert_allclose(run_pid(pid, references, measured), expected, rtol=0, atol=2e-12)
    assert 10 < np.sum(np.isin(expected, [-1.0, 1.5])) < 195


def test_the_filter_takes_off_noise_and_passes_slopes():
    """For y = t the derivative part is -Kc Td (1 - a^n), a = Tf / (Tf + Ts). For white noise of variance 1, the
    variance after (1 - q^-1) / (1 - a q^-1) is 2 / (1 + a)."""
    Td, Tf = 0.05, 0.018
    kept, n = Tf / (Tf + TS), np.arange(100)
    of_slope = run_pid(PID(3.0, np.inf, Td, TS, Tf=Tf), 0.0, TS * n) + 3.0 * TS * n
    np.testing.assert_allclose(of_slope, -3.0 * Td * (1.0 - kept**n), atol=1e-13)
    noise = np.random.default_rng(2).normal(size=200_000)
    through = run_pid(PID(1.0, np.inf, Td, TS, Tf=Tf), 0.0, noise) + noise
    assert through.std() == pytest.approx(Td / (Tf + TS) * np.sqrt(2.0 / (1.0 + kept)), rel=5e-3)
    bare = run_pid(PID(1.0, np.inf, Td, TS), 0.0, noise) + noise
    assert bare.std() / through.std() == pytest.approx(10.0 * np.sqrt(1.9), rel=5e-3)


@pytest.mark.parametrize(
    ("b", "c", "kick"), [(1.0, 1.0, 14.1), (1.0, 0.0, 4.1), (0.0, 1.0, 10.1), (0.5, 0.2, 4.1)]
)
def test_weights_of_the_set_point_at_a_step(b, c, kick):
    """By hand: Kc = 4, Ts / 2 Ti = 1 / 40, Td / (Tf + Ts) = 2.5: 4 (b + 1 / 40 + 2.5 c)."""
    pid = PID(4.0, 0.04, 0.01, TS, Tf=0.002, b=b, c=c)
    assert run_pid(pid, 1.0, [0.0])[0] == pytest.approx(kick, rel=1e-14)
    # The measured value has no weight.
    assert run_pid(pid, 0.0, [1.0])[0] == pytest.approx(-14.1, rel=1e-14)


BY_HAND = {
    # Integral after each sample: 0.1, 0.85, 1.6, 2.35, 2.2875, 2.225.
    "none": [0.5, 2.0, 2.0, 2.0, 2.0, 1.975],
    # 0.1 until the error changes its sign, then 0.0375, -0.025.
    "clamping": [0.5, 2.0, 2.0, 2.0, -0.2125, -0.275],
    # 0.85 - 1.85 / 4 = 0.3875, 1.1375 - 2.1375 / 4 = 0.603125, 1.353125 - 2.353125 / 4 = 0.76484375, less 0.0625 each.
    "back_calculation": [0.5, 2.0, 2.0, 2.0, 0.45234375, 0.38984375],
}


@pytest.mark.parametrize("anti_windup", ANTI_WINDUP)
def test_a_limit_by_hand(anti_windup):
    """Kc = 1, Ts / Ti = Ts / Tt = 1/4, rectangular, the output at most 2."""
    pid = PID(1.0, 4.0, 0.0, 1.0, -np.inf, 2.0, "rectangular", anti_windup, tracking_time=4.0)
    errors = [0.4, 3.0, 3.0, 3.0, -0.25, -0.25]
    np.testing.assert_allclose(run_pid(pid, errors, np.zeros(6)), BY_HAND[anti_windup], rtol=1e-14)


def test_from_hand_to_automatic_without_a_bump():
    """At rest the output stays; an error adds the integral part of each sample: 2 (0.1 / 0.5) 0.3."""
    running = RunningPID(PID(2.0, 0.5, 0.3, 0.1, Tf=0.05, b=0.4, c=0.2, acts_on_minus_error=True))
    running.start(7.5, reference=1.2, measured=1.2)
    np.testing.assert_allclose([running.step(1.2, 1.2) for _ in range(3)], 7.5, rtol=1e-14)
    running.start(7.5, reference=1.5, measured=1.2)
    np.testing.assert_allclose([running.step(1.5, 1.2) for _ in range(3)], 7.5 - 0.12 * np.arange(1, 4))


def test_other_gains_at_the_first_sample_without_a_bump():
    running = RunningPID(PID(2.0, np.inf, 0.3, 0.1))
    running.start(7.5, reference=1.5, measured=1.2)
    running.change(PID(3.0, np.inf, 0.4, 0.1))
    assert running.step(1.5, 1.2) == pytest.approx(7.5, rel=1e-14)


@pytest.mark.parametrize("minus", [False, True])
def test_other_gains_without_a_bump(minus):
    """At rest away from the reference, where the proportional parts differ, and on a slope seen by both controllers."""
    old = PID(2.0, np.inf, 0.3, 0.1, Tf=0.4, b=0.5, c=0.7, acts_on_minus_error=minus)
    new = PID(5.0, np.inf, 0.6, 0.1, Tf=0.4, b=0.9, c=0.1, acts_on_minus_error=minus)
    running = RunningPID(old)
    still = [running.step(1.0, 0.4) for _ in range(300)][-1]
    running.change(new)
    assert [running.step(1.0, 0.4) for _ in range(50)] == pytest.approx([still] * 50, rel=1e-12)
    # A step of the measured value meets the new gains: 5 (1 + 0.6 / 0.5).
    assert abs(running.step(1.0, 0.5) - still) == pytest.approx(0.1 * 5.0 * 2.2, rel=1e-9)
    running = RunningPID(old)
    for measured in (0.0, 0.1, 0.2):
        running.step(1.0, measured)
    twin = RunningPID(old)
    twin.memory[:], after = running.memory, replace(new, Ti=3.0)
    running.change(after)
    # The derivative part decays as with the old gains, because both controllers have the same filter.
    same = [twin.step(1.0, 0.2) for _ in range(20)]
    running.controller = replace(after, Ti=np.inf)
    added = 5.0 * 0.1 / 3.0 * 0.8 * np.arange(1, 21) * (-1.0 if minus else 1.0)
    np.testing.assert_allclose([running.step(1.0, 0.2) for _ in range(20)], same + added, rtol=1e-12)


def test_gains_without_derivative_end_it():
    running = RunningPID(PID(2.0, 0.5, 0.3, 0.1))
    running.step(1.0, 0.0)
    integral = 2.0 * 0.1 / 0.5 * 0.5
    running.change(PID(2.0, 0.5, 0.0, 0.1))
    assert running.step(1.0, 0.0) == pytest.approx(2.0 + integral + 2.0 * 0.1 / 0.5, rel=1e-14)


def test_one_call_a_sample_is_the_same():
    pid = PID(
        0.5, 0.007, 0.001, TS, lower=-1.0, upper=1.5, anti_windup="back_calculation", acts_on_minus_error=True
    )
    running = RunningPID(pid)
    stepped = [running.step(0.3, measured) for measured in ERRORS]
    np.testing.assert_array_equal(stepped, run_pid(pid, 0.3, ERRORS))
    running.reset()
    assert running.step(0.3, ERRORS[0]) == stepped[0]


@pytest.mark.parametrize(
    ("anti_windup", "samples"), [("none", 1500), ("clamping", 2), ("back_calculation", 12)]
)
def test_the_way_back_from_a_limit(anti_windup, samples):
    """Error 1 for a second, then -1: an integral wound up to 50 takes as long to unwind. PI, Ti = 20 ms."""
    pid = PID(1.0, 0.02, 0.0, TS, upper=2.0, anti_windup=anti_windup)
    errors = np.concatenate([np.ones(500), -np.ones(1500)])
    outputs = run_pid(pid, errors, 0 * errors)
    below = int(np.argmax(outputs[500:] < 2.0))
    assert outputs[499] == 2.0
    assert below <= samples
    assert (below > 400) == (anti_windup == "none")


def test_tracking_time_is_that_of_an_exponential():
    """The excess of the integral beyond the output's limit decays to 1/e in Tt (PI without error)."""
    pid = PID(1.0, 1e6, 0.0, TS, upper=1.0, anti_windup="back_calculation", tracking_time=0.1)
    running = RunningPID(pid)
    running.reset(integral=11.0)
    for _ in range(50):
        running.step(0.0, 0.0)
    # At an error of -5 the output is the integral less 5, which is within the limits again.
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
        (lambda: PID(0.5, 0.007, 0.001, TS, Tf=-1e-3), "Tf"),
        (lambda: PID(0.5, 0.007, 0.001, TS, b=np.nan), "b"),
        (lambda: PID(0.5, 0.007, 0.001, TS, c=np.inf), "c"),
        (lambda: RunningPID(PID(0.5, 0.007, 0.001, TS)).start(np.nan, 0.0, 0.0), "output"),
        (lambda: PID(0.5, 0.007, 0.001, TS, lower=1.0, upper=1.0), "rise"),
        (lambda: PID(0.5, 0.007, 0.001, TS, anti_windup="yes"), "none, clamping, back_calculation"),
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
