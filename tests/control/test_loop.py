"""Closed loops against python-control, Lyapunov's equation, and limits."""

import control as reference
import numpy as np
import pytest
import scipy.linalg

from fieldmap import control
from fieldmap.control import (
    PID,
    AxisReading,
    LoopInstruments,
    LoopRun,
    constant_block,
    pid_block,
    simulate_loop,
    stacked,
)
from fieldmap.errors import InputError
from tests.refusals import refused

TS = 2e-3
VERTICAL = control.from_roots(-0.03, [0.9935], [1.01, 0.905])
# The five settings of chapter 5: (5-12), 7.2.1, 5.7.
SETTINGS = [
    (0.5, 0.007, 0.001),
    (0.334, 0.007, 0.001),
    (0.2, 0.006, 0.0015),
    (0.7, 5.934e-3, 4.6e-4),
    (0.2094, 4.62e-3, 1.171e-3),
]


def pid(Kc, Ti, Td, **options):
    return PID(Kc, Ti, Td, TS, integration="trapezoidal", acts_on_minus_error=True, **options)


def theirs(gains):
    numerator, denominator = control.pid_transfer_function(*gains, TS)
    return reference.feedback(reference.tf(-numerator, denominator, TS) * reference.tf(*VERTICAL, TS), 1)


@pytest.mark.parametrize("gains", SETTINGS)
def test_step_and_its_metrics_are_those_of_python_control(gains):
    """python-control rounds times to whole samples."""
    run = simulate_loop(VERTICAL, pid(*gains), np.ones(2000))
    _, y = reference.step_response(theirs(gains), run.time)
    np.testing.assert_allclose(run.y[0], y, rtol=1e-8, atol=1e-9)
    ours = control.step_metrics(run.time, run.y[0])
    info = reference.step_info(theirs(gains), T=run.time, SettlingTimeThreshold=0.02)
    assert ours.peak_time == pytest.approx(info["PeakTime"], abs=1e-9)
    assert 100 * ours.overshoot == pytest.approx(info["Overshoot"], abs=1e-3)
    assert ours.rise_time == pytest.approx(info["RiseTime"], abs=2 * TS)
    assert ours.settling_time == pytest.approx(info["SettlingTime"], abs=2 * TS)


@pytest.mark.parametrize("reached", [0.05, 0.5])
def test_a_record_that_ends_too_early_has_an_infinite_rise_time(reached):
    """A ramp that ends below 10 % or between 10 and 90 % of the step."""
    time = np.linspace(0.0, 1.0, 11)
    assert control.step_metrics(time, reached * time).rise_time == np.inf


def test_noise_at_rest_obeys_lyapunov():
    """Variance of y from white sensor noise: P = A P A' + B B' for the transfer function from noise to y; 200 runs."""
    gains = SETTINGS[1]
    loop = reference.ss(theirs(gains))
    P = scipy.linalg.solve_discrete_lyapunov(loop.A, loop.B @ loop.B.T)
    expected = float(np.sqrt((loop.C @ P @ loop.C.T).item()))
    noise = np.random.default_rng(4).normal(size=(200, 3000))
    run = simulate_loop(VERTICAL, pid(*gains), np.zeros(3000), runs=200, position_noise=noise)
    assert run.y[:, 1000:].std() == pytest.approx(expected, rel=0.02)


def test_runs_are_independent_of_each_other():
    noise = np.random.default_rng(4).normal(size=(3, 100))
    many = simulate_loop(VERTICAL, pid(*SETTINGS[0]), np.ones(100), runs=3, position_noise=noise)
    for n in range(3):
        one = simulate_loop(VERTICAL, pid(*SETTINGS[0]), np.ones(100), position_noise=noise[n])
        np.testing.assert_array_equal(one.y[0], many.y[n])


def test_a_limited_drive_loses_what_a_free_one_holds():
    """A limited drive loses an unstable plant: a move by 1 needs |u| >= 4.87."""
    wide, narrow = (
        LoopInstruments(drive=np.array([0.0, -limit, limit, 1.0, 0.0, -np.inf, np.inf]))
        for limit in (6.0, 4.0)
    )
    held = simulate_loop(VERTICAL, pid(*SETTINGS[1]), np.ones(1500), instruments=wide)
    lost = simulate_loop(VERTICAL, pid(*SETTINGS[1]), np.ones(1500), instruments=narrow)
    assert held.y[0, -1] == pytest.approx(1.0, abs=1e-3)
    assert not abs(lost.y[0, -1] - 1.0) < 0.5


def test_a_block_controls_as_the_pid_that_it_is_made_of():
    law = pid(*SETTINGS[1], lower=-3.0, upper=3.0, anti_windup="back_calculation")
    noise = {"position_noise": 0.01 * np.random.default_rng(8).normal(size=(2, 400)), "runs": 2}
    own = simulate_loop(VERTICAL, law, np.ones(400), **noise)
    block = simulate_loop(VERTICAL, pid_block(law, AxisReading("x")), np.ones(400), Ts=TS, **noise)
    for name in ("time", "y", "u"):
        np.testing.assert_array_equal(getattr(block, name), getattr(own, name))
    assert isinstance(own, LoopRun)
    np.testing.assert_array_equal(own.error, own.y - 1.0)
    np.testing.assert_array_equal(own.outputs, own.u)


@pytest.mark.parametrize(
    ("controller", "Ts", "where"),
    [
        (pid_block(PID(1.0, 1.0, 0.0, 2e-3), AxisReading("x")), None, "simulate_loop(Ts)"),
        (stacked(constant_block(0.0), constant_block(0.0)), 2e-3, "simulate_loop(controller)"),
        (PID(1.0, 1.0, 0.0, 2e-3), 1e-3, "simulate_loop(Ts)"),
    ],
)
def test_controllers_that_do_not_fit(controller, Ts, where):
    with refused(InputError, where=where):
        simulate_loop(VERTICAL, controller, np.ones(5), Ts=Ts)


def test_disturbance_is_integrated_away():
    run = simulate_loop(VERTICAL, pid(*SETTINGS[1]), np.zeros(2000), disturbance=0.5)
    assert np.abs(run.y).max() > 0.01
    assert abs(run.y[0, -1]) < 1e-6
    assert run.u[0, -1] == pytest.approx(-0.5, abs=1e-4)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"plant": ([1.0, 0.0], [1.0, -0.5])}, "strictly proper"),
        ({"plant": ([1.0, 0.0, 0.0], [1.0, -0.5])}, "proper"),
        ({"plant": (np.eye(2), np.eye(2), np.eye(2))}, "3 parts"),
        ({"plant": (np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)))}, "2 x 1"),
        ({"reference": [0.0, np.nan]}, "entry 1"),
        ({"reference": []}, "one sample or more"),
        ({"reference": np.ones((2, 3))}, "one sample or more"),
        ({"position_noise": np.ones(4)}, "position_noise"),
        ({"disturbance": np.inf}, "disturbance"),
        ({"runs": 0}, "runs"),
    ],
)
def test_bad_input(given, says):
    with pytest.raises(InputError, match=says):
        simulate_loop(**{"plant": VERTICAL, "controller": pid(*SETTINGS[0]), "reference": np.ones(5)} | given)
