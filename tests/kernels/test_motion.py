"""The kernels of a moving body, small enough to run without compilation."""

import numpy as np

from fieldmap.kernels.motion.layout import FIRST, INERTIA, STATE
from fieldmap.kernels.motion.rotation import free_turn, normalise, to_body, to_map, turn_matrix
from fieldmap.kernels.motion.step import X0, X1


def state_with(quaternion, spin):
    state = np.zeros(STATE)
    state[6:10] = quaternion / np.linalg.norm(quaternion)
    state[10:13] = spin
    return state


def test_the_matrix_of_a_quaternion_turns_and_turns_back():
    turn = turn_matrix(state_with(np.array([0.3, -0.5, 0.7, 0.2]), 0.0))
    matrix = np.array(turn).reshape(3, 3)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(matrix) > 0
    np.testing.assert_allclose(to_body(turn, *to_map(turn, 1.0, 2.0, 3.0)), [1.0, 2.0, 3.0], atol=1e-15)
    quarter = turn_matrix(state_with(np.array([1.0, 0.0, 0.0, 1.0]), 0.0))  # about z: x becomes y
    np.testing.assert_allclose(to_map(quarter, 1.0, 0.0, 0.0), [0.0, 1.0, 0.0], atol=1e-15)


def test_a_spin_about_a_principal_axis_turns_by_its_angle():
    body = np.zeros(FIRST)
    body[INERTIA : INERTIA + 3] = 1e-6, 2e-6, 2.5e-6
    for axis in range(3):
        spin = np.zeros(3)
        spin[axis] = 7.0
        state = state_with(np.array([1.0, 0.0, 0.0, 0.0]), spin)
        for _ in range(10):
            free_turn(state, body, 0.03)
            normalise(state)
        half = np.array([np.cos(1.05), 0.0, 0.0, 0.0])
        half[1 + axis] = np.sin(1.05)
        np.testing.assert_allclose(state[6:10], half, atol=1e-14)
        np.testing.assert_allclose(state[10:], spin, atol=1e-14)


def test_the_parts_of_a_composed_step_fulfil_the_conditions_of_fourth_order():
    np.testing.assert_allclose([2 * X1 + X0, 2 * X1**3 + X0**3], [1.0, 0.0], atol=1e-15)
