"""Beads of soft iron in motion: the compiled force, a bead held under coils, scenarios, and assumptions."""

from dataclasses import replace

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.dynamics import body_of_payload, prepare, read_scenario, sampled_field, state_of, superposed
from fieldmap.lookup import magnetic_body
from fieldmap.sources import CoilSet
from tests.conftest import DEVICES
from tests.dynamics.machines import machine_in

# The shipped scenario of a bead: five coils, with earlier and smaller steps and no noise.
STEPS = {
    "duration_s": 1.0,
    "drag.linear_N_s_per_m": [1e-4, 1e-4, 1e-4],
    "sensors.zero_depth_mm": 0,
    "noise.off": True,
    "start.depth_mm": 15,
    "reference.0.at_s": 0.2,
    "reference.0.by_mm": -0.5,
    "reference.1.at_s": 0.4,
    "reference.1.by_mm": 0.4,
}


@pytest.fixture(scope="module")
def five():
    device = fm.read_device(DEVICES / "five_coils_above_a_bead.toml")
    return device, sampled_field(CoilSet(device.coils, device.bounds), 1.5e-3)


def test_compiled_force_and_energy_are_those_of_the_body(five):
    _, field = five
    payload = fm.Payload(
        mass=2e-3,
        pieces=[
            fm.PayloadPiece(
                fm.SoftEllipsoid((2e-3, 3e-3, 5e-3), fm.material("steel_a3")), fm.placed([0, 0, 2e-3])
            ),
            fm.PayloadPiece(fm.SoftSphere(2e-3, mu_r=50.0), fm.placed([1e-3, 0.0, -2e-3])),
            fm.PayloadPiece(fm.MagnetSphere(2e-3, 1.2), fm.placed([0.0, 0.0, -4e-3])),
        ],
        inertia=(1e-9, 1e-9, 1e-9),
    )
    body, currents = body_of_payload(payload, centre_of_mass=1e-3), np.array([3.0, -2.0, 5.0, 1.0, 9.0])
    machine = machine_in(superposed(field), 5, replace(body, gravity=0.0))
    assert machine.follow(currents)
    load = np.empty(6)
    for quaternion in ([1.0, 0.0, 0.0, 0.0], [0.8, 0.3, -0.4, 0.2]):
        state = state_of([0.0021, 0.0012, -0.0157], quaternion=quaternion)
        w, x, y, z = state[6:10]
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        turn = np.eye(3) + 2 * w * cross + 2 * cross @ cross
        assert machine.load(state, load) == (0, 0)
        centre = state[:3] + turn @ body.magnet_at
        expected = body.magnet.wrench(field, centre, currents, turn)
        np.testing.assert_allclose(load[:3], expected[:3], rtol=1e-10)
        torque = expected[3:] + np.cross(turn @ body.magnet_at, expected[:3])
        np.testing.assert_allclose(turn @ load[3:], torque, rtol=1e-9)
        whole = body.magnet.energy(field, centre, currents, turn)
        assert machine.energy(state) == pytest.approx(whole, rel=1e-10)


def test_a_bead_is_held_and_moved_by_the_shipped_regulator(five):
    device, field = five
    experiment = prepare(read_scenario("bead", STEPS), field, device)
    # The lift is of least power, by the inverse of the map.
    point, bead = experiment.operating_point, magnetic_body(device.payload)
    load = field.wrench(point.state[:3], bead, point.currents)
    np.testing.assert_allclose(load[:3], [0.0, 0.0, 0.263e-3 * 9.80665], atol=1e-6 * 2.6e-3)
    least = field.currents_for([0.0, 0.0, -0.015], force=[0, 0, 0.263e-3 * 9.80665], moment=bead)
    assert point.currents @ point.currents == pytest.approx(least @ least, rel=0.05)
    run = fm.simulate("bead", STEPS, field_map=field, device=device)
    assert run.event is None
    end = run.sensed[-100:]
    np.testing.assert_allclose(end, np.broadcast_to([4e-4, 0.0, -0.0145], end.shape), atol=4e-5)
    text = " ".join(run.assumptions)
    assert "1 induced dipole" in text
    assert "soft iron" in text


@pytest.mark.parametrize("scale", [0.8, 1.25])
def test_a_scaled_field_carries_a_bead_with_currents_scaled_the_other_way(five, scale):
    device, field = five
    plain, scaled = (
        prepare(read_scenario("bead", STEPS | {"field.scale": s}), field, device) for s in (1.0, scale)
    )
    currents = scaled.operating_point.currents
    load = field.wrench(scaled.operating_point.state[:3], magnetic_body(device.payload), scale * currents)
    np.testing.assert_allclose(load[:3], [0.0, 0.0, 0.263e-3 * 9.80665], atol=1e-6 * 2.6e-3)
    least = plain.operating_point.currents
    assert currents @ currents == pytest.approx(least @ least / scale**2, rel=0.05)


def test_inertia_and_surface_of_a_bead(five):
    device, _ = five
    body = body_of_payload(device.payload)
    np.testing.assert_allclose(body.inertia, 0.1 * 0.263e-3 * 4e-3**2)
    np.testing.assert_allclose(np.linalg.norm(body.skin, axis=1), 2e-3)
    assert "moment induced, free to turn" in body.assumptions
    assert replace(body, upright=True).numbers().inertia.min() > 1.0
