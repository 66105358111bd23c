"""The wrench that moves the body, against the wrench of the lookup room and the slope of its energy."""

import numpy as np
import pytest

from fieldmap.device.model import MagnetCylinder
from fieldmap.dynamics import RigidBody, energy, state_of
from fieldmap.kernels.map.cached_field import forget, keep_field, kept_at
from fieldmap.kernels.map.map_block import INSIDE, OUTSIDE
from fieldmap.kernels.motion.magnet import magnet_wrench
from fieldmap.kernels.motion.rotation import turn_matrix
from fieldmap.lookup import unit_block, volume_rule

MAGNET = volume_rule(MagnetCylinder(0.01, 0.01, 1.3), 2)
CURRENTS = np.array([1.3, -0.4, 0.7])


@pytest.fixture(params=["harmonic", "hermite", "global"])
def field(request, axial):
    return axial.map((0.02, -0.1, 0.5), (0.01, 0.2, -1.0), (-0.01, 0.05, 2.0), kind=request.param)


def states(count=6):
    rng = np.random.default_rng(8)
    for _ in range(count):
        yield state_of(rng.uniform(-0.006, 0.006, 3), quaternion=rng.normal(size=4))


def wrench_of(field, body, state, fixed):
    load = np.empty(6)
    block = unit_block(field.at(CURRENTS) if fixed else field)
    weights = np.ones(1) if fixed else CURRENTS
    kept = keep_field(block, weights, len(MAGNET.points))
    numbers = body.numbers()
    assert magnet_wrench(kept, numbers, state, load) == INSIDE
    # From the coefficients that it has kept: the same bits.
    again = np.empty(6)
    assert magnet_wrench(kept, numbers, state, again) == INSIDE
    np.testing.assert_array_equal(again, load)
    return load


@pytest.mark.parametrize("fixed", [True, False])
def test_force_and_torque_are_those_of_the_lookup_room(field, fixed):
    """The torque about the magnet's centre and the lever of the force, turned into the body."""
    arm = np.array([1e-3, -2e-3, 3e-3])
    body = RigidBody(0.01, [1e-6] * 3, MAGNET, magnet_at=arm)
    for state in states():
        turn = np.array(turn_matrix(state)).reshape(3, 3)
        centre = state[:3] + turn @ arm
        wanted = MAGNET.wrench(field, centre, CURRENTS, turn)
        torque = turn.T @ (wanted[3:] + np.cross(turn @ arm, wanted[:3]))
        found = wrench_of(field, body, state, fixed)
        np.testing.assert_allclose(found[:3], wanted[:3], atol=1e-12)
        np.testing.assert_allclose(found[3:], torque, atol=1e-14)


def test_the_load_is_minus_the_slope_of_the_energy(axial):
    """By place, and by turning about the axes of the body: central differences."""
    field = axial.map((0.02, -0.1, 0.5), (0.01, 0.2, -1.0), (-0.01, 0.05, 2.0)).at(CURRENTS)
    body = RigidBody(0.01, [1e-6] * 3, MAGNET, magnet_at=[1e-3, -2e-3, 3e-3], gravity=0.0)
    for state in states(3):
        load = np.empty(6)
        magnet_wrench(
            keep_field(unit_block(field), np.ones(1), len(MAGNET.points)), body.numbers(), state, load
        )
        slope = np.empty(6)
        for k in range(6):
            moved = []
            for side in (1e-5, -1e-5):
                there = state.copy()
                if k < 3:
                    there[k] += side
                else:
                    w, u = state[6], state[7:10]
                    turn = np.eye(3)[k - 3] * side / 2
                    there[6] = w - u @ turn
                    there[7:10] = u + w * turn + np.cross(u, turn)
                    there[6:10] /= np.linalg.norm(there[6:10])
                moved.append(energy(field, body, there)[0])
            slope[k] = (moved[1] - moved[0]) / 2e-5
        np.testing.assert_allclose(load, slope, atol=2e-6 * np.abs(load).max())


def test_a_magnet_that_reaches_out_of_the_map_is_noticed(field, axial):
    load = np.empty(6)
    body = RigidBody(0.01, [1e-6] * 3, MAGNET)
    kept = keep_field(unit_block(field), CURRENTS, len(MAGNET.points))
    assert magnet_wrench(kept, body.numbers(), state_of([0.018, 0, 0]), load) == OUTSIDE


def test_a_kept_field_is_that_of_the_place_and_of_the_currents(field):
    """Along a path through many cells and back, and after the currents have changed."""
    currents = CURRENTS.copy()
    kept = keep_field(unit_block(field), currents, 1)
    path = 0.018 * np.sin(np.arange(60)[:, None] * [0.11, 0.17, 0.23])
    for step, point in enumerate(path):
        if step % 20 == 0:
            currents *= -1.5
            forget(kept)
        status, found = kept_at(kept, 0, *point)
        assert status == INSIDE
        flux, slope = field.field_and_gradient(point, currents)
        np.testing.assert_allclose(found, np.concatenate([flux, slope.ravel()]), rtol=1e-12, atol=1e-14)
    assert kept_at(kept, 0, 0.03, 0.0, 0.0)[0] == OUTSIDE
