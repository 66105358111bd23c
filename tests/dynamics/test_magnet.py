"""The wrench on the moving body, against the wrench of the lookup and the gradient of its energy."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fieldmap.core import CoreMap
from fieldmap.core.machine import CoreMachine, Plant, rotation
from fieldmap.device.model import MagnetCylinder
from fieldmap.dynamics import RigidBody, energy, state_of, superposed
from fieldmap.lookup import MagneticBody, unit_block, volume_rule
from tests.dynamics.machines import machine_in

MAGNET = volume_rule(MagnetCylinder(0.01, 0.01, 1.3), 2)
CURRENTS = np.array([1.3, -0.4, 0.7])
OUTSIDE = 1


@pytest.fixture(params=["harmonic", "hermite", "global"])
def field(request, axial):
    return axial.map((0.02, -0.1, 0.5), (0.01, 0.2, -1.0), (-0.01, 0.05, 2.0), kind=request.param)


def states(count=6):
    rng = np.random.default_rng(8)
    for _ in range(count):
        yield state_of(rng.uniform(-0.006, 0.006, 3), quaternion=rng.normal(size=4))


def at_fixed_currents(field, body):
    """A machine without coils, with the body in one field of weight 1."""
    none = np.zeros((0, 4)), np.zeros((0, 7))
    return CoreMachine(
        Plant(CoreMap(unit_block(field)).map, body.numbers(), np.zeros(3), 1.0, None, 1.0, None, *none)
    )


def wrench_of(field, body, state, fixed):
    machine = at_fixed_currents(field.at(CURRENTS), body) if fixed else machine_in(superposed(field), 3, body)
    if not fixed:
        assert machine.follow(CURRENTS)
    load = np.empty(6)
    assert machine.load(state, load) == (0, 0)
    # The second call uses the stored coefficients and gives the same bits.
    again = np.empty(6)
    assert machine.load(state, again) == (0, 0)
    np.testing.assert_array_equal(again, load)
    return load


@pytest.mark.parametrize("fixed", [True, False])
def test_force_and_torque_are_those_of_the_lookup_room(field, fixed):
    """The torque about the magnet's centre plus the lever of the force, in the body's frame."""
    arm = np.array([1e-3, -2e-3, 3e-3])
    body = RigidBody(0.01, [1e-6] * 3, MAGNET, magnet_at=arm, gravity=0.0)
    for state in states():
        turn = rotation(state)
        centre = state[:3] + turn @ arm
        wanted = MAGNET.wrench(field, centre, CURRENTS, turn)
        torque = turn.T @ (wanted[3:] + np.cross(turn @ arm, wanted[:3]))
        found = wrench_of(field, body, state, fixed)
        np.testing.assert_allclose(found[:3], wanted[:3], atol=1e-12)
        np.testing.assert_allclose(found[3:], torque, atol=1e-14)


def test_the_load_is_minus_the_slope_of_the_energy(axial):
    """By place, and by turns about the body's axes; central differences."""
    field = axial.map((0.02, -0.1, 0.5), (0.01, 0.2, -1.0), (-0.01, 0.05, 2.0)).at(CURRENTS)
    body = RigidBody(0.01, [1e-6] * 3, MAGNET, magnet_at=[1e-3, -2e-3, 3e-3], gravity=0.0)
    machine = at_fixed_currents(field, body)
    for state in states(3):
        load = np.empty(6)
        assert machine.load(state, load) == (0, 0)
        slope = np.empty(6)
        for k in range(6):
            moved = []
            for side in (1e-5, -1e-5):
                there = state.copy()
                if k < 3:
                    there[k] += side
                else:
                    turn = Rotation.from_rotvec(np.eye(3)[k - 3] * side)
                    turned = Rotation.from_quat(state[6:10], scalar_first=True) * turn
                    there[6:10] = turned.as_quat(scalar_first=True)
                moved.append(energy(field, body, there)[0])
            slope[k] = (moved[1] - moved[0]) / 2e-5
        np.testing.assert_allclose(load, slope, atol=2e-6 * np.abs(load).max())


def test_a_magnet_that_reaches_out_of_the_map_is_noticed(field, axial):
    load = np.empty(6)
    body = RigidBody(0.01, [1e-6] * 3, MAGNET)
    machine = machine_in(superposed(field), 3, body)
    assert machine.load(state_of([0.018, 0, 0]), load)[0] == OUTSIDE


def test_a_kept_field_is_that_of_the_place_and_of_the_currents(field):
    """Along a path through many cells and back, and after changes of the currents."""
    currents, load = CURRENTS.copy(), np.empty(6)
    moments = np.eye(3)
    bodies = [
        RigidBody(0.01, [1e-6] * 3, MagneticBody(np.zeros((1, 3)), m[None]), gravity=0.0) for m in moments
    ]
    machines = [machine_in(superposed(field), 3, body) for body in bodies]
    path = 0.018 * np.sin(np.arange(60)[:, None] * [0.11, 0.17, 0.23])
    for step, point in enumerate(path):
        if step % 20 == 0:
            currents *= -1.5
            for machine in machines:
                machine.follow(currents)
        flux, slope = field.field_and_gradient(point, currents)
        for machine, moment, row in zip(machines, moments, slope, strict=True):
            assert machine.load(state_of(point), load) == (0, 0)
            wanted = np.concatenate([row, np.cross(moment, flux)])
            np.testing.assert_allclose(load, wanted, rtol=1e-12, atol=1e-14)
    assert machines[0].load(state_of([0.03, 0.0, 0.0]), load)[0] == OUTSIDE
