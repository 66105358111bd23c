"""Tuned PID controllers: margins and poles by python-control, and margins that no PID controller can reach."""

from dataclasses import replace
from functools import cache

import control
import numpy as np
import pytest

from fieldmap.control import LumpedMagnet, simulate_loop, tune_pid, zero_order_hold
from fieldmap.control.margins import margins_of_curves
from fieldmap.errors import Infeasible, InputError
from tests.refusals import refused

BALL = LumpedMagnet(inductance=0.010, length=0.006, mass=0.066).plant(0.008)


def late(pole, delay, Ts):
    """|pole| / (s - pole), sampled, with a delay of whole samples; in q."""
    kept = np.exp(pole * Ts)
    numerator = [(kept - 1.0) * np.sign(pole)]
    return numerator, np.concatenate([[1.0, -kept], np.zeros(round(delay / Ts))])


def ball(Ts):
    return (*zero_order_hold(BALL.A, BALL.B, Ts), BALL.C, BALL.D)


PLANTS = {
    "the thesis's vertical plant": (([-0.03, 0.0298], [1, -1.915, 0.91405]), 2e-3, {}),
    "a ball below a magnet": (
        ball(2e-4),
        2e-4,
        {"gain_margin": 1.6, "phase_margin": 35.0, "crossover": 30.0},
    ),
    "a ball, slowly": (
        ball(2e-4),
        2e-4,
        {"gain_margin": 1.9, "phase_margin": 20.0, "crossover": 12.0, "modulus": 0.1},
    ),
    "a lag that keeps away from -1": (
        late(-1.0, 0.2, 0.01),
        0.01,
        {"gain_margin": 1.2, "phase_margin": 20.0, "modulus": 0.6},
    ),
    "a lag and a dead time": (late(-1.0, 0.2, 0.01), 0.01, {"integration": "rectangular"}),
    "an unstable lag and a dead time": (late(10.0, 0.01, 1e-3), 1e-3, {"N": 30.0, "gain_margin": 1.8}),
}


@cache
def tuned_for(name):
    """The tuned controller of a plant, the plant, its sampling time, and the margins asked for."""
    plant, Ts, asked = PLANTS[name]
    return tune_pid(plant, Ts, **asked), plant, Ts, asked


def by_python_control(plant, Ts, pid, count=20_000):
    """The loop of the textbook's parts, opened at the controller's output; frequencies, rad/s, and its response."""
    q = control.tf([1.0, 0.0], [1.0], Ts)
    system = control.ss(*plant, Ts) if len(plant) == 4 else control.tf(*plant, Ts)
    integral = Ts / pid.Ti * ((q + 1) / (2 * (q - 1)) if pid.integration == "trapezoidal" else q / (q - 1))
    derivative = pid.Td * (q - 1) / ((pid.Tf + Ts) * q - pid.Tf)
    loop = (-pid.Kc if pid.acts_on_minus_error else pid.Kc) * (1 + integral + derivative) * system
    rates = np.geomspace(1e-3, np.pi / Ts, count)
    return loop, rates, control.frequency_response(loop, rates).frdata[0, 0]


@pytest.mark.parametrize("name", PLANTS)
def test_the_margins_are_those_of_python_control_and_as_asked(name):
    tuned, plant, Ts, asked = tuned_for(name)
    # python-control interpolates with splines.
    _, rates, loop = by_python_control(plant, Ts, tuned.pid, 4000)
    gains, phases, _, *at = control.stability_margins(control.frd(loop, rates), returnall=True)
    found, margins = tuned.margins, {"gain_margin": 2.0, "phase_margin": 45.0, "modulus": 0.4} | asked
    # python-control leaves out a crossing at half the sampling rate itself.
    ends = [-1.0 / loop[-1].real] if loop[-1].real < 0.0 else []
    gains = np.concatenate([gains, ends])
    assert found.gain_up == pytest.approx(min(gains[gains > 1.0], default=np.inf), rel=1e-3)
    assert found.gain_down == pytest.approx(max(gains[gains < 1.0], default=0.0), rel=1e-3)
    assert found.phase == pytest.approx(np.abs(phases).min(), rel=1e-3)
    assert found.crossover == pytest.approx(at[1][np.abs(phases).argmin()] / (2.0 * np.pi), rel=1e-3)
    assert found.modulus == pytest.approx(np.abs(1.0 + loop).min(), rel=1e-3)
    assert found.gain_up >= margins["gain_margin"]
    assert found.gain_down <= 1.0 / margins["gain_margin"]
    assert found.phase >= margins["phase_margin"]
    assert found.modulus >= margins["modulus"]
    assert tuned.share >= 1.0
    assert found.crossover == pytest.approx(asked.get("crossover", found.crossover), rel=1e-3)
    assert tuned.pid.Ti >= 4.0 * tuned.pid.Td
    assert tuned.pid.Tf == pytest.approx(tuned.pid.Td / asked.get("N", 10.0))


@pytest.mark.parametrize("name", PLANTS)
def test_a_constant_disturbance_is_taken_off_as_fast_as_the_integral_says(name):
    """The simulated loop is stable, and the integral of the error is -Ti / Kc for a unit disturbance."""
    tuned, plant, Ts, _ = tuned_for(name)
    pid = tuned.pid
    run = simulate_loop(plant, pid, np.zeros(round(9.0 / Ts)), disturbance=1.0)
    assert run.u[0, -1] == pytest.approx(-1.0, abs=1e-6)
    sign = -1.0 if pid.acts_on_minus_error else 1.0
    assert Ts * run.y.sum() == pytest.approx(sign * pid.Ti / pid.Kc, rel=1e-5)


@pytest.mark.parametrize("name", ["the thesis's vertical plant", "a lag and a dead time"])
def test_no_controller_near_it_takes_off_more(name):
    """300 controllers with up to 30 % more |Kc| / Ti: none is stable and keeps the margins, which are computed here."""
    tuned, plant, Ts, _ = tuned_for(name)
    pid, generator = tuned.pid, np.random.default_rng(3)
    near, kept = 0, 0
    for _ in range(300):
        up, ratio = 1.0 + generator.uniform(0.01, 0.3), generator.uniform(0.5, 2.0)
        Ti = pid.Ti * ratio
        Td = min(pid.Td * generator.uniform(0.3, 3.0), Ti / 4.0)
        other = replace(pid, Kc=pid.Kc * ratio * up, Ti=Ti, Td=Td, Tf=Td / 10.0)
        loop, _, answers = by_python_control(plant, Ts, other)
        if np.abs(control.feedback(loop).poles()).max() > 1.0:
            continue
        at = np.flatnonzero(np.diff(np.abs(answers) >= 1.0))
        phase = np.degrees(np.abs(np.angle(-answers[at]))).min(initial=180.0)
        real = np.append(np.flatnonzero(np.diff(np.sign(answers.imag)) != 0.0), len(answers) - 1)
        gains = np.abs(answers[real[answers.real[real] < 0.0]])
        factor = 1.0 / gains[gains < 1.0].max(initial=1e-9)
        shares = phase / 44.9, np.log(factor) / np.log(1.99), np.abs(1.0 + answers).min() / 0.399
        near, kept = near + (min(shares) > 0.8), kept + (min(shares) >= 1.0)
    assert near > 5
    assert kept == 0


def test_a_plant_of_the_other_sign_has_the_same_gains():
    tuned, (top, bottom), Ts, asked = tuned_for("a lag and a dead time")
    up, down = tuned.pid, tune_pid((-np.array(top), bottom), Ts, **asked).pid
    assert (up.acts_on_minus_error, down.acts_on_minus_error) == (False, True)
    assert (up.Kc, up.Ti, up.Td) == pytest.approx((down.Kc, down.Ti, down.Td), rel=1e-6)


def test_what_an_unstable_plant_with_a_dead_time_cannot_have():
    """No PID controller holds 1 / (s - p) with a dead time of 2 / p or more (Silva, Datta and Bhattacharyya, PID
    Controllers for Time-Delay Systems, 2005, theorem 4.1). Shorter dead times bound the margins; those are reached."""
    with pytest.raises(Infeasible) as caught:
        tune_pid(late(10.0, 0.21, 0.01), 0.01, N=np.inf)
    assert caught.value.reachable is None
    assert caught.value.problems[0].where == "tune_pid(plant)"
    plant, asked = late(10.0, 0.04, 4e-3), {"gain_margin": 2.0, "phase_margin": 60.0}
    with pytest.raises(Infeasible) as caught:
        tune_pid(plant, 4e-3, **asked)
    best = caught.value.reachable
    assert 0.2 < best.share < 1.0
    assert best.largest_pole < 1.0
    assert f"{10.0:.3g} 1/s" in caught.value.problems[0].received
    had = {"gain_margin": 2.0 ** (0.98 * best.share), "phase_margin": 60.0 * 0.98 * best.share}
    assert tune_pid(plant, 4e-3, **had, modulus=0.4 * 0.98 * best.share).share >= 1.0
    # Larger margins make the disturbance rejection slower.
    rates = [
        tuned.pid.Kc / tuned.pid.Ti
        for phase in (10.0, 15.0, 20.0)
        for tuned in [tune_pid(plant, 4e-3, gain_margin=1.2, phase_margin=phase, modulus=0.1)]
    ]
    assert rates[0] > rates[1] > rates[2]


def test_a_gain_that_ends_at_half_the_sampling_rate():
    """Gain k before 0.5 / (q - 0.5): the pole 0.5 (1 - k) is -1 at k = 3; with the sign reversed it is 1 at k = 1."""
    frequencies = np.geomspace(1e-4, 0.5, 2000)
    curve = 0.5 / (np.exp(2j * np.pi * frequencies) - 0.5)
    up, down, phase, at, modulus = margins_of_curves(frequencies, 1.5 * curve[None])[:, 0]
    assert (up, down) == (pytest.approx(2.0, rel=1e-6), 0.0)
    assert modulus == pytest.approx(0.5, rel=1e-6)
    # |1.5 curve| = 1 at cos(w) = 0.6875, where the curve turns by 180 degrees less the angle of 0.5 - q.
    q = np.exp(1j * np.arccos(0.6875))
    assert at == pytest.approx(np.arccos(0.6875) / (2.0 * np.pi), rel=1e-5)
    assert phase == pytest.approx(np.degrees(np.abs(np.angle(0.75 / (0.5 - q)))), rel=1e-4)
    still = np.zeros_like(curve)
    for open_loop in margins_of_curves(frequencies, np.array([still, -still])).T:
        np.testing.assert_array_equal(open_loop, [np.inf, 0.0, np.nan, np.nan, 1.0])


@pytest.mark.parametrize(
    ("given", "where"),
    [
        ({"gain_margin": 1.0}, "tune_pid(gain_margin)"),
        ({"gain_margin": np.nan}, "tune_pid(gain_margin)"),
        ({"phase_margin": 0.0}, "tune_pid(phase_margin)"),
        ({"phase_margin": 180.0}, "tune_pid(phase_margin)"),
        ({"modulus": 1.0}, "tune_pid(modulus)"),
        ({"crossover": 250.0}, "tune_pid(crossover)"),
        ({"crossover": 0.0}, "tune_pid(crossover)"),
        ({"N": 0.0}, "tune_pid(N)"),
        ({"integration": "euler"}, "tune_pid(integration)"),
        ({"plant": ([1.0, 0.0], [1.0, -0.5])}, "tune_pid(plant)"),
        ({"Ts": 0.0}, "tune_pid(Ts)"),
    ],
)
def test_bad_input(given, where):
    plant, Ts, _ = PLANTS["the thesis's vertical plant"]
    with refused(InputError, where=where):
        tune_pid(**{"plant": plant, "Ts": Ts} | given)
