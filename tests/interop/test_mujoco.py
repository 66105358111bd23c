"""Magnets in MuJoCo: the wrench of the map, energy kept, a body held in the air, and what goes wrong."""

import numpy as np
import pytest

from fieldmap.device.model import MagnetCylinder
from fieldmap.errors import InputError, OutsideMapError
from fieldmap.interop import MagnetForces
from fieldmap.lookup import volume_rule

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed (pip install fieldmap[mujoco])")

MOMENT, MASS, GRAVITY, HEIGHT = 0.8, 0.01119, 9.81, -0.09
SCENE = """
<mujoco>
  <option timestep="{step}" gravity="0 0 -9.81" integrator="RK4"><flag energy="enable"/></option>
  <worldbody>
    <body name="float" pos="{x} {y} {z}" euler="{tilt} 0 0">
      <joint type="free" damping="{damping}"/>
      <geom type="cylinder" size="0.008 0.01" mass="0.01119"/>
    </body>
  </worldbody>
</mujoco>
"""


def scene(x=0.0, y=0.0, z=HEIGHT, tilt=0.0, damping=0.0, step=1e-3):
    model = mujoco.MjModel.from_xml_string(SCENE.format(x=x, y=y, z=z, tilt=tilt, damping=damping, step=step))
    return model, mujoco.MjData(model)


def lift_current(ring):
    return MASS * GRAVITY / (MOMENT * ring.map.gradient(np.array([0, 0, HEIGHT]), np.ones(6))[2, 2])


@pytest.mark.parametrize("finite", [False, True])
def test_passive_forces_are_the_wrench_of_the_map(ring, finite):
    model, data = scene(0.004, -0.003, -0.1, tilt=40.0)
    magnet = volume_rule(MagnetCylinder(0.01, 0.01, 1.3), 2) if finite else np.array([0.1, 0.2, MOMENT])
    currents, offset = np.array([1.0, 2.0, 0.5, -1.0, 0.2, 1.5]), np.array([0.001, 0.0, -0.002])
    with MagnetForces(model, ring.map, {"float": magnet}, currents, offset):
        mujoco.mj_forward(model, data)
    turn = data.xmat[1].reshape(3, 3)
    where = np.array([0.004, -0.003, -0.1]) - offset
    if finite:
        expected = magnet.wrench(ring.map, where, currents, turn)
    else:
        expected = ring.map.wrench(where, turn @ magnet, currents)
    # A free joint's generalised force: force in the world, torque in the body.
    np.testing.assert_allclose(data.qfrc_passive[:3], expected[:3], rtol=1e-9)
    np.testing.assert_allclose(turn @ data.qfrc_passive[3:], expected[3:], rtol=1e-9, atol=1e-15)
    assert mujoco.get_mjcb_passive() is None


def test_energy_is_kept(ring):
    model, data = scene(0.003, 0.002, HEIGHT, tilt=25.0, step=5e-4)
    currents = np.full(6, 0.95 * lift_current(ring))

    def energy():
        mujoco.mj_forward(model, data)
        flux = ring.map.field(data.xpos[1], currents)
        moment = MOMENT * data.xmat[1].reshape(3, 3)[:, 2]
        return data.energy.sum() - moment @ flux, data.energy[1]

    with MagnetForces(model, ring.map, {"float": [0, 0, MOMENT]}, currents):
        start, _ = energy()
        kinetic = []
        for _ in range(300):
            mujoco.mj_step(model, data)
            kinetic.append(data.energy[1])
        end, _ = energy()
    assert max(kinetic) > 1e-4
    assert abs(end - start) < 1e-3 * max(kinetic)


def test_a_levitated_body_stays_up_for_ten_seconds(ring):
    model, data = scene(0.002, -0.001, HEIGHT - 0.002, tilt=5.0, damping=2e-4)
    base, whole = lift_current(ring), 0.0
    heights = []
    with MagnetForces(model, ring.map, {"float": [0, 0, MOMENT]}, np.full(6, base)) as magnets:
        for _ in range(10_000):
            off = HEIGHT - data.qpos[2]
            whole += off * model.opt.timestep
            magnets.currents[:] = base * (1 + 60 * off - 2.7 * data.qvel[2] + 60 * whole)
            mujoco.mj_step(model, data)
            heights.append(data.qpos[2])
    assert np.abs(np.array(heights) - HEIGHT).max() < 0.005
    assert np.abs(heights[-2000:] - np.array(HEIGHT)).max() < 1e-4
    assert np.hypot(*data.qpos[:2]) < 0.004


def test_without_a_controller_it_falls_out_of_the_map(ring):
    model, data = scene(z=HEIGHT - 0.002)
    currents = np.full(6, lift_current(ring))
    magnets = MagnetForces(model, ring.map, {"float": [0, 0, MOMENT]}, currents)
    with magnets:
        mujoco.mj_step(model, data, 50)
        magnets.check()
    with pytest.raises(OutsideMapError), magnets:
        mujoco.mj_step(model, data, 3000)
    assert data.qpos[2] < ring.map.lower[2]
    assert mujoco.get_mjcb_passive() is None


def test_a_body_that_does_not_exist(ring):
    with pytest.raises(InputError, match="flote"):
        MagnetForces(scene()[0], ring.map, {"flote": [0, 0, 1]}, np.ones(6))
