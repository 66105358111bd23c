"""Derivatives of an equilibrium by the currents, against the equilibrium itself (Taylor) and a closed form."""

import numpy as np
import pytest

from fieldmap.device.model import Payload
from fieldmap.errors import InputError
from fieldmap.levitation import equilibrium_sensitivity, stationary_points
from tests.levitation.conftest import lifting_above
from tests.refusals import refused

PAYLOAD = Payload(mass=0.01119, moment=0.813)


@pytest.fixture
def three_coils(polynomial_field, vertical_part):
    """B_z at z = 0: coil 0 -100 (x^2 + 2 y^2) and lift, coil 1 x + 8 x^3, coil 2 y + 20 x y."""
    bowl, along_x, along_y = np.zeros((3, 3)), np.zeros((4, 1)), np.zeros((2, 2))
    bowl[2, 0], bowl[0, 2] = -100.0, -200.0
    along_x[1, 0], along_x[3, 0] = 1.0, 8.0
    along_y[0, 1], along_y[1, 1] = 1.0, 20.0
    return polynomial_field([lifting_above(bowl, 0.14), vertical_part(along_x), vertical_part(along_y)])


CURRENTS = np.array([1.0, 0.8, -0.5])


def place(source, currents, height=0.0):
    (point,) = stationary_points(source, currents, PAYLOAD, height).points
    return point.position


def test_the_equilibrium_moves_as_predicted_to_second_order(three_coils):
    at = place(three_coils, CURRENTS)
    found = equilibrium_sensitivity(three_coils, CURRENTS, PAYLOAD, at)
    way, sizes = np.array([0.3, -0.7, 0.6]), np.array([0.04, 0.02, 0.01])
    moved = [(place(three_coils, CURRENTS + t * way) - at)[:2] for t in sizes]
    left = np.linalg.norm(moved - np.outer(sizes, found.at_held_height @ way), axis=1)
    slopes = np.diff(np.log(left)) / np.diff(np.log(sizes))
    assert (slopes > 1.9).all()
    assert left[-1] < 0.02 * np.linalg.norm(sizes[-1] * found.at_held_height @ way)


def test_with_the_lift_held_all_currents_answer(three_coils):
    at = place(three_coils, CURRENTS)
    found = equilibrium_sensitivity(three_coils, CURRENTS, PAYLOAD, at)
    lift = three_coils.gradient(at[None], CURRENTS)[0, 2, 2]
    way = np.array([1.0, 0.5, -0.4])
    left = []
    for t in (0.02, 0.01):
        changed = CURRENTS + t * way
        # Lift is in proportion to the currents here: they are scaled until the lift at the new place is the old lift.
        for _ in range(20):
            there = place(three_coils, changed)
            changed = changed * lift / three_coils.gradient(there[None], changed)[0, 2, 2]
        left.append(np.linalg.norm((there - at)[:2] - t * found.with_lift_held @ way))
    assert left[1] < 0.3 * left[0]


@pytest.mark.parametrize("step", [None, 0.3])
def test_with_the_lift_held_neither_push_nor_lift_changes_to_first_order(three_coils, step):
    """At the moved place and the scaled currents. The field is linear in the currents, so the step does not matter."""
    at = place(three_coils, CURRENTS)
    found = equilibrium_sensitivity(three_coils, CURRENTS, PAYLOAD, at, step=step)
    force = three_coils.gradient(at[None], CURRENTS)[0, 2]
    for k, way in enumerate(np.eye(3)):
        left = []
        for t in (2e-3, 1e-3):
            moved = at + np.append(t * found.with_lift_held[:, k], 0.0)
            amperes = (CURRENTS + t * way) * (1.0 + t * found.level_per_current[k])
            left.append(np.linalg.norm(three_coils.gradient(moved[None], amperes)[0, 2] - force))
        changed = np.linalg.norm(three_coils.gradient(at[None], CURRENTS + 1e-3 * way)[0, 2] - force)
        assert left[1] < 0.02 * changed
        assert left[1] == pytest.approx(left[0] / 4.0, rel=0.1)


def test_noise_of_one_coil_is_its_column_squared(three_coils):
    found = equilibrium_sensitivity(three_coils, CURRENTS, PAYLOAD, place(three_coils, CURRENTS))
    covariance = found.noise([0.0, 0.035, 0.0])
    np.testing.assert_allclose(covariance, 0.035**2 * np.outer(*[found.at_held_height[:, 1]] * 2), rtol=1e-12)
    rng = np.random.default_rng(5)
    drawn = 0.035 * rng.normal(size=(20000, 3)) @ found.at_held_height.T
    np.testing.assert_allclose(np.sqrt(np.diag(found.noise(0.035))), drawn.std(axis=0), rtol=0.03)
    held = found.noise([0.0, 0.0, 0.02], lift_held=True)
    np.testing.assert_allclose(held, 0.02**2 * np.outer(*[found.with_lift_held[:, 2]] * 2), rtol=1e-12)
    with pytest.raises(InputError):
        found.noise([0.01, -1e-9, 0.01])


def test_at_a_fold_there_is_no_derivative(polynomial_field):
    flat = np.zeros((4, 3))
    flat[3, 0], flat[0, 2] = 1e3, -100.0
    field = polynomial_field([lifting_above(flat, 0.14)])
    with pytest.raises(InputError, match="fold"):
        equilibrium_sensitivity(field, [1.0], PAYLOAD, np.zeros(3))
    # Next to the fold the derivative exists.
    equilibrium_sensitivity(field, [1.0], PAYLOAD, np.array([1e-5, 0.0, 0.0]))
    with refused(InputError, where="equilibrium_sensitivity(step)"):
        equilibrium_sensitivity(field, [1.0], PAYLOAD, np.array([1e-5, 0.0, 0.0]), step=0.0)


def test_without_lift_no_level_holds_it(polynomial_field, vertical_part):
    """B_z = 500 x^3 - 50 y^2 at z = 0: a push, and nothing upward."""
    g = np.zeros((4, 3))
    g[3, 0], g[0, 2] = 500.0, -50.0
    with refused(InputError, where="equilibrium_sensitivity(currents)", received="0.0] N"):
        equilibrium_sensitivity(polynomial_field([vertical_part(g)]), [1.0], PAYLOAD, [1e-3, 0.0, 0.0])
