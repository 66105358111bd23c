"""Controllers and models against the numbers that the thesis prints, to the printed digits."""

import numpy as np
import pytest

from fieldmap import control

TS = 2e-3
VERTICAL = control.from_roots(-0.03, [0.9935], [1.01, 0.905])  # (5-17), Table 5-4
A = np.array(
    [[-44.94, 248.3, 0.0], [1.0, 0.0, 0.0], [-15.63, -50.97, 0.0]]
)  # (7-10), 248.3 with its true sign
B = np.array([[1.0], [0.0], [0.0]])
Q = np.array([[5000, 796.64, 0], [796.64, 5000, 0], [0, 0, 10000]])  # (7-12)
R = 1e-10


def close(ours, printed, half_unit):
    assert (np.abs(np.subtract(ours, printed)) <= np.multiply(half_unit, 1 + 1e-6)).all(), ours


def test_pid_of_5_16():
    numerator, denominator = control.pid_transfer_function(0.5, 0.007, 0.001, TS)
    close(numerator, [0.82143, -0.92857, 0.25], 5e-6)
    close(denominator, [1.0, -1.0, 0.0], 0)
    close(sorted(np.roots(numerator)), [0.4422, 0.6882], 5e-5)


def test_sampled_model_7_6():
    close(VERTICAL.numerator, [-0.03, 0.0298], 5e-5)
    close(VERTICAL.denominator, [1.0, -1.915, 0.9141], 5.1e-5)  # 0.91405 lies between 0.9140 and 0.9141


def test_continuous_model_7_7():
    numerator, denominator = control.continuous(VERTICAL, TS)
    close(numerator, [-15.63, -50.97], 5e-3)
    close(denominator[:2], [1.0, 44.94], 5e-3)
    close(denominator[2], -248.3, 5e-2)


def test_state_space_7_9_and_its_misprint():
    """The printed -248.3 would make the characteristic polynomial s^2 + 44.94 s + 248.3: a stable plant."""
    model = control.controller_form([-15.63, -50.97], [1.0, 44.94, -248.3])
    close(model.A, [[-44.94, 248.3], [1, 0]], 0)
    close(model.C, [[-15.63, -50.97]], 0)
    assert np.linalg.eigvals(model.A).max() > 0
    assert np.linalg.eigvals([[-44.94, -248.3], [1, 0]]).max() < 0


def test_with_integral_7_10_and_sampled_7_11():
    model = control.controller_form([-15.63, -50.97], [1.0, 44.94, -248.3])
    wide = control.with_output_integral(model.A, model.B, model.C)
    close(wide.A, A, 0)
    close(wide.C, [[-15.63, -50.97, 0]], 0)
    A_d, B_d = control.zero_order_hold(wide.A, wide.B, TS)
    close(A_d, [[0.9145, 0.4750, 0], [0.0019, 1.0005, 0], [-0.03, -0.1095, 1]], 5e-5)
    close(B_d, [[0.0019], [0], [0]], 5e-5)


def test_regulator_gain_7_13():
    close(control.lqrd(A, B, Q, R, TS), [[627.22, 2306.04, -914.07]], 5e-3)


def test_the_misprint_of_7_10_gives_another_gain():
    printed = A.copy()
    printed[0, 1] = -248.3
    assert abs(control.lqrd(printed, B, Q, R, TS)[0, 1] / 2306.0 - 1) > 0.2


def test_estimator_7_17():
    """All entries but A_est[0, 0], printed 0.8989; from (5-17) in full digits, noise 4e-4 both."""
    numerator, denominator = control.continuous(VERTICAL, TS)
    model = control.controller_form(numerator, denominator)
    estimator = control.kalmd(model.A, model.B, model.C, 4e-4, 4e-4, TS)
    close(estimator.A_est[0, 0], 0.8984, 5e-5)
    close(estimator.A_est[0, 1], 0.4224, 5e-5)
    close(estimator.A_est[1], [-0.000495, 0.9926], [5e-7, 5e-5])
    close(estimator.B_est, [[0.001913, -0.001032], [1.942e-6, -0.0001541]], [[5e-7, 5e-7], [5e-10, 5e-8]])
    close(
        estimator.C_est,
        [[-15.25, -49.74], [0.9836, -0.05349], [-0.002376, 0.9923]],
        [[5e-3, 5e-3], [5e-5, 5e-6], [5e-7, 5e-5]],
    )
    close(estimator.D_est, [[0, 0.02415], [0, -0.001049], [0, -0.000152]], [[0, 5e-6], [0, 5e-7], [0, 5e-7]])


@pytest.mark.parametrize("plant", [VERTICAL, ([-0.03, 0.029805], [1, -1.915, 0.91405])])
def test_equilibrium_gain_7_20_is_misprinted(plant):
    """The thesis prints 4.8178; 0.00095 / 0.000195 = 4.8718, so two digits are exchanged."""
    assert 1 / control.steady_gain(plant, TS) == pytest.approx(4.8718, abs=5e-5)
