"""Linear models against scipy.signal and python-control."""

import control as reference
import numpy as np
import pytest
import scipy.signal

from fieldmap import control
from fieldmap.errors import InputError

TS = 2e-3
VERTICAL = control.from_roots(-0.03, [0.9935], [1.01, 0.905])
RNG = np.random.default_rng(5)
MATRICES = [(RNG.normal(size=(n, n)) * 5, RNG.normal(size=(n, m))) for n, m in ((1, 1), (2, 1), (4, 2))]


@pytest.mark.parametrize(("A", "B"), MATRICES)
def test_zero_order_hold_is_that_of_scipy_and_has_an_inverse(A, B):
    theirs = scipy.signal.cont2discrete((A, B, np.eye(len(A)), np.zeros_like(B)), 0.05)
    ours = control.zero_order_hold(A, B, 0.05)
    back = control.inverse_zero_order_hold(*ours, 0.05)
    for found, matrix, inverse, given in zip(ours, theirs, back, (A, B), strict=False):
        np.testing.assert_allclose(found, matrix, rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(inverse, given, rtol=1e-8, atol=1e-9)


def test_an_integrator_has_no_inverse_matrix_and_still_is_sampled():
    """dx/dt = v, dv/dt = u: x grows by u Ts^2 / 2, though A is singular."""
    A_d, B_d = control.zero_order_hold([[0, 1], [0, 0]], [[0], [1]], 0.1)
    np.testing.assert_allclose(A_d, [[1, 0.1], [0, 1]], atol=1e-15)
    np.testing.assert_allclose(B_d[:, 0], [0.005, 0.1], atol=1e-15)


def test_transfer_functions_through_python_control():
    theirs = reference.sample_system(reference.tf([2.0, 3.0], [1.0, 4.0, 5.0]), TS)
    numerator, denominator = control.sampled(([2.0, 3.0], [1.0, 4.0, 5.0]), TS)
    np.testing.assert_allclose(denominator, theirs.den[0][0], rtol=1e-9)
    np.testing.assert_allclose(numerator[1:], theirs.num[0][0], rtol=1e-6)
    assert abs(numerator[0]) < 1e-12


def test_sampled_and_continuous_are_inverse():
    back = control.sampled(control.continuous(VERTICAL, TS), TS)
    np.testing.assert_allclose(back.numerator[-2:], VERTICAL.numerator, rtol=1e-8)
    np.testing.assert_allclose(back.denominator, VERTICAL.denominator, rtol=1e-10)


def test_closed_loop_is_that_of_python_control():
    numerator, denominator = control.pid_transfer_function(0.334, 0.007, 0.001, TS)
    plant, pid = reference.tf(*VERTICAL, TS), reference.tf(-numerator, denominator, TS)
    theirs = reference.feedback(pid * plant, 1)
    ours = control.closed_loop(VERTICAL, (-numerator, denominator))
    np.testing.assert_allclose(ours.numerator, theirs.num[0][0], rtol=1e-10)
    np.testing.assert_allclose(ours.denominator, theirs.den[0][0], rtol=1e-10)


@pytest.mark.parametrize("coefficients", [([1.0, 2.0], [1.0, 4.0, 5.0]), ([3.0, 1.0, 2.0], [2.0, 4.0, 6.0])])
def test_realisation_has_the_same_frequency_response(coefficients):
    model = control.controller_form(*coefficients)
    s = 1j * np.array([0.1, 1.0, 10.0])
    theirs = np.polyval(coefficients[0], s) / np.polyval(coefficients[1], s)
    ours = [(model.C @ np.linalg.solve(x * np.eye(2) - model.A, model.B) + model.D)[0, 0] for x in s]
    np.testing.assert_allclose(ours, theirs, rtol=1e-12)
    back = control.to_transfer_function(model)
    np.testing.assert_allclose(
        np.polyval(back.numerator, s) / np.polyval(back.denominator, s), theirs, rtol=1e-12
    )


def test_conjugate_roots():
    np.testing.assert_allclose(
        control.from_roots(2.0, [], [0.5 + 0.1j, 0.5 - 0.1j]).denominator, [1, -1, 0.26]
    )


def test_gain_at_rest():
    assert control.steady_gain(([2.0, 3.0], [1.0, 4.0, 5.0])) == pytest.approx(0.6)
    assert control.steady_gain(([0.5], [1.0, -0.9]), TS) == pytest.approx(5.0)
    assert control.steady_gain(([1.0], [1.0, 0.0])) == np.inf


@pytest.mark.parametrize(
    ("broken", "says"),
    [
        (lambda: control.transfer_function([1, 2, 3], [1, 2]), "proper"),
        (lambda: control.transfer_function([1], [0, 0]), "zero"),
        (lambda: control.transfer_function([np.nan], [1, 2]), "finite"),
        (lambda: control.from_roots(1.0, [], [0.5 + 0.1j]), "conjugate"),
        (lambda: control.zero_order_hold([[1]], [[1]], 0.0), "Ts"),
        (lambda: control.zero_order_hold([[1]], [[1]], np.inf), "Ts"),
        (lambda: control.zero_order_hold([[1, 2]], [[1]], TS), "1 x 1"),
        (lambda: control.zero_order_hold([[1.0]], [[1], [2]], TS), "1 x any"),
        (lambda: control.inverse_zero_order_hold([[-0.5]], [[1]], TS), "negative real axis"),
        (lambda: control.continuous(([1.0], [1.0, 0.0]), TS), "dead time"),
        (
            lambda: control.to_transfer_function(
                control.StateSpace(np.eye(2), np.eye(2), np.eye(2), np.eye(2))
            ),
            "1",
        ),
    ],
)
def test_bad_input(broken, says):
    with pytest.raises(InputError, match=says):
        broken()
