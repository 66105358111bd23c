"""The regulator against equations (7-15), (7-16), (7-21) written out, and the separation of its poles."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

from fieldmap import control
from fieldmap.control import Regulator, RunningRegulator, run_regulator
from fieldmap.control.regulator import riccati
from fieldmap.errors import InputError

TS = 2e-3
VERTICAL = control.from_roots(-0.03, [0.9935], [1.01, 0.905])
MODEL = control.controller_form(*control.continuous(VERTICAL, TS))
WIDE = control.with_output_integral(MODEL.A, MODEL.B, MODEL.C)
Q = np.array([[5000, 796.64, 0], [796.64, 5000, 0], [0, 0, 10000]])
GAIN = control.lqrd(WIDE.A, WIDE.B, Q, 1e-10, TS)
ESTIMATOR = control.kalmd(MODEL.A, MODEL.B, MODEL.C, 4e-4, 4e-4, TS)
REGULATOR = Regulator(GAIN, ESTIMATOR, TS, equilibrium=(0.3, 4.8718), divisor=0.69)
MEASURED = np.random.default_rng(2).normal(scale=0.1, size=60)


@pytest.mark.parametrize("limit", [np.inf, 0.6])
@pytest.mark.parametrize("equilibrium_at", ["reference", "measured"])
@pytest.mark.parametrize("estimate", ["predicted", "filtered", "delayed"])
def test_equations_written_out(estimate, equilibrium_at, limit):
    """At a limit the estimator receives the limited output."""
    regulator = replace(
        REGULATOR, estimate=estimate, equilibrium_at=equilibrium_at, lower=-limit, upper=limit
    )
    predicted, filtered_before, third = np.zeros(2), np.zeros(2), 0.0
    expected, states = [], []
    for measured in MEASURED:
        deviation = measured - 0.05
        outputs = ESTIMATOR.C_est @ predicted + ESTIMATOR.D_est @ [0.0, deviation]
        fed = {"predicted": predicted, "filtered": outputs[1:], "delayed": filtered_before}[estimate]
        equilibrium = 0.3 + 4.8718 * (measured if equilibrium_at == "measured" else 0.05)
        output = np.clip(equilibrium - (GAIN[0, :2] @ fed + GAIN[0, 2] * third) / 0.69, -limit, limit)
        control_signal = output - equilibrium
        expected.append(output)
        states.append(outputs[1:])
        predicted = ESTIMATOR.A_est @ predicted + ESTIMATOR.B_est @ [control_signal, deviation]
        filtered_before, third = outputs[1:], third + TS * deviation
    ours, ours_states = run_regulator(regulator, 0.05, MEASURED)
    assert (np.abs(expected).max() == limit) == np.isfinite(limit)
    np.testing.assert_allclose(ours, expected, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(ours_states, states, rtol=1e-10, atol=1e-15)


def test_one_call_a_sample_is_the_same():
    running = RunningRegulator(REGULATOR)
    stepped = [running.step(0.05, measured) for measured in MEASURED]
    outputs, states = run_regulator(REGULATOR, 0.05, MEASURED)
    np.testing.assert_array_equal(stepped, outputs)
    np.testing.assert_array_equal(running.states, states[-1])


def test_poles_of_regulator_and_estimator_separate():
    """The free motion on the model itself has the poles of A - B k and of A_est."""
    A_d, B_d = control.zero_order_hold(WIDE.A, WIDE.B, TS)
    # The integrator of (7-16) adds Ts times the output instead of the output's integral over the sample.
    A_d[2, :2], B_d[2] = TS * MODEL.C[0], 0.0
    poles = np.concatenate([np.linalg.eigvals(A_d - B_d @ GAIN), np.linalg.eigvals(ESTIMATOR.A_est)])
    assert np.abs(poles).max() < 1
    regulator = Regulator(GAIN, ESTIMATOR, TS, estimate="predicted")
    kick = np.zeros(60)
    kick[0] = 1.0
    plant = control.StateSpace(*control.zero_order_hold(MODEL.A, MODEL.B, TS), MODEL.C, MODEL.D)
    run = control.simulate_loop(plant, regulator, np.zeros(60), disturbance=kick)
    polynomial = np.poly(poles).real
    free = np.convolve(run.y[0], polynomial, mode="valid")[5:]
    assert np.abs(free).max() < 1e-9 * np.abs(run.y).max()


@pytest.mark.parametrize(
    ("broken", "says"),
    [
        (lambda: Regulator(GAIN[:, :2], ESTIMATOR, TS), "one for the integral"),
        (lambda: Regulator(GAIN * np.nan, ESTIMATOR, TS), "finite"),
        (lambda: Regulator(GAIN, ESTIMATOR, 0.0), "Ts"),
        (lambda: Regulator(GAIN, ESTIMATOR, TS, divisor=0.0), "divisor"),
        (lambda: Regulator(GAIN, ESTIMATOR, TS, estimate="true"), "predicted"),
        (lambda: Regulator(GAIN, ESTIMATOR, TS, lower=1.0, upper=-1.0), "rise"),
        (lambda: Regulator(GAIN, ESTIMATOR._replace(B_est=np.eye(2, 1)), TS), "2 x 2"),
        (lambda: Regulator(GAIN, ESTIMATOR._replace(D_est=np.ones((3, 2))), TS), "D = 0"),
        (lambda: RunningRegulator(REGULATOR).step(np.nan, 0.0), "reference"),
        (lambda: run_regulator(REGULATOR, 0.0, [np.inf]), "finite"),
    ],
)
def test_bad_input(broken, says):
    with pytest.raises(InputError, match=says):
        broken()


def test_a_problem_that_balancing_makes_too_hard_is_solved_without(monkeypatch):
    """A scalar Riccati equation, whose positive root is known; the solver fails as LAPACK's reordering does."""
    solve = scipy.linalg.solve_discrete_are

    def fails_if_balanced(A, B, Q, R, s=None, balanced=True):
        if balanced:
            raise ValueError("Reordering failed")
        return solve(A, B, Q, R, s=s, balanced=False)

    monkeypatch.setattr(scipy.linalg, "solve_discrete_are", fails_if_balanced)
    P, gain = riccati("scalar", *(np.array([[value]]) for value in (1.2, 1.0, 1.0, 1.0)))
    # P^2 - a^2 P - 1 = 0 with a = 1.2
    assert P[0, 0] == pytest.approx(0.72 + np.hypot(0.72, 1.0), rel=1e-12)
    assert abs(1.2 - gain[0, 0]) < 1.0
