"""Magnets in MuJoCo: the wrench of the map, energy kept, a body held in the air, and what goes wrong."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.device.model import MagnetCylinder
from fieldmap.dynamics import RigidBody, SeveralBodies, energy, move, move_adaptively, state_of
from fieldmap.errors import InputError, NotConverged, OutsideMapError
from fieldmap.interop import MagnetForces
from fieldmap.lookup import FiniteMagnet, magnetic_body, volume_rule
from fieldmap.store import write_map
from tests.docs.pages import blocks
from tests.refusals import refused

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


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("finite", [False, True])
def test_passive_forces_are_the_wrench_of_the_map(ring, finite, compiled):
    model, data = scene(0.004, -0.003, -0.1, tilt=40.0)
    magnet = volume_rule(MagnetCylinder(0.01, 0.01, 1.3), 2) if finite else np.array([0.1, 0.2, MOMENT])
    currents, offset = np.array([1.0, 2.0, 0.5, -1.0, 0.2, 1.5]), np.array([0.001, 0.0, -0.002])
    with MagnetForces(model, ring.map, {"float": magnet}, currents, offset, compiled=compiled) as magnets:
        assert magnets.compiled == compiled
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
    if not finite:
        flux, slope = (np.tensordot(currents, part[:, 0], 1) for part in ring.fields(where[None]))
        moment = turn @ magnet
        np.testing.assert_allclose(data.qfrc_passive[:3], moment @ slope, rtol=1e-3)
        np.testing.assert_allclose(turn @ data.qfrc_passive[3:], np.cross(moment, flux), rtol=1e-3)
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


def test_numbers_of_single_precision_are_left_to_python(ring, monkeypatch):
    monkeypatch.setattr(mujoco, "MJTNUM_DTYPE", np.float32, raising=False)
    assert not MagnetForces(scene()[0], ring.map, {"float": [0, 0, 1]}, np.ones(6)).compiled


def test_a_body_that_does_not_exist(ring):
    with pytest.raises(InputError) as caught:
        MagnetForces(scene()[0], ring.map, {"flote": [0, 0, 1]}, np.ones(6))
    assert caught.value.problems[0].received == "flote"


BROAD = np.broadcast_to(1.0, (10**12, 3))
"""An array without memory of its own, for a copy of which no machine has enough."""


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize(
    ("wrong", "where"),
    [
        *(
            ({"magnets": {"float": moment}}, "MagnetForces(magnets['float'])")
            for moment in ([], [0, 0.8], [[0, 0, 0.8]], [0, 0, np.nan], "up", None, [[1], [1, 2]], BROAD)
        ),
        *(({"magnets": magnets}, "MagnetForces(magnets)") for magnets in ({}, None, {0: [0, 0, 1]})),
        *(({"currents": amperes}, "currents") for amperes in ([], [1, 2], [np.nan] * 6, BROAD[:, 0], "x")),
        *(({"offset": offset}, "MagnetForces(offset)") for offset in (0.0, [0, 0], [0, 0, np.inf], BROAD)),
        ({"model": None}, "MagnetForces(model)"),
        ({"field": None}, "MagnetForces(field)"),
    ],
)
def test_what_is_no_model_moment_current_or_offset_is_refused(ring, wrong, where, compiled):
    given = {"model": scene()[0], "field": ring.map, "magnets": {"float": [0, 0, 1]}, "currents": 1.0}
    with refused(InputError, where=where):
        MagnetForces(**(given | wrong), compiled=compiled)


def test_currents_that_are_assigned_are_checked_like_the_first(ring):
    magnets = MagnetForces(scene()[0], ring.map, {"float": [0, 0, 1]}, np.ones(6))
    for wrong in ([], [1, 2], [np.nan] * 6, np.ones((3, 6)), "x"):
        with refused(InputError, where="currents"):
            magnets.currents = wrong
    np.testing.assert_array_equal(magnets.currents, np.ones(6))


def test_the_wrench_on_a_body_by_its_number(ring):
    model, data = scene(0.004, -0.003, -0.1, tilt=40.0)
    mujoco.mj_forward(model, data)
    magnets = MagnetForces(model, ring.map, {"float": [0, 0, 1]}, CURRENTS, [0.001, 0.0, -0.002])
    moment = np.array([0.1, 0.2, MOMENT])
    exact = ring.map.wrench([0.003, -0.003, -0.098], data.xmat[1].reshape(3, 3) @ moment, CURRENTS)
    np.testing.assert_allclose(magnets.wrench(data, 1, moment), exact, rtol=1e-12)
    for body in (-1, 2):
        with refused(InputError, where="wrench(body)", received=str(body)):
            magnets.wrench(data, body, moment)


SEVERAL = """
<mujoco>
  <option timestep="1e-4" gravity="0 0 -9.81" integrator="{integrator}"><flag energy="enable"/></option>
  <worldbody>
    <body name="a" pos="0.004 0 -0.09" euler="20 10 0">
      <freejoint/><inertial pos="0 0 0" mass="0.011" diaginertia="6e-7 7e-7 3e-7"/>
    </body>
    <body name="b" pos="-0.008 0.006 -0.1"><joint type="hinge" axis="0 1 0" pos="0 0 0.01"/>
      <geom type="box" size="0.001 0.002 0.003" pos="0.001 0 0" mass="0.02"/>
      <body name="c" pos="0 0.004 0.012" euler="0 30 5"><joint type="hinge" axis="1 0 0"/>
        <geom type="box" size="0.001 0.002 0.003" mass="0.01"/></body>
    </body>
  </worldbody>
</mujoco>
"""
MAGNETS = {"a": [0.1, -0.2, 0.5], "b": [0.3, 0.0, 0.1], "c": [0.0, 0.2, -0.3]}
CURRENTS = np.array([1.0, 2.0, 0.5, -1.0, 0.2, 1.5])


def several(integrator="Euler"):
    model = mujoco.MjModel.from_xml_string(SEVERAL.format(integrator=integrator))
    data = mujoco.MjData(model)
    data.qvel[:] = np.linspace(-0.3, 0.3, model.nv)
    return model, data


def test_several_magnets_on_joints_compiled_and_in_python(ring):
    """Also the matrix A of MuJoCo's own finite differences."""
    found = []
    for compiled in (True, False):
        model, data = several()
        with MagnetForces(model, ring.map, MAGNETS, CURRENTS, compiled=compiled) as magnets:
            mujoco.mj_step(model, data, 20)
            n = 2 * model.nv
            slope = np.zeros((n, n))
            mujoco.mjd_transitionFD(model, data, 1e-6, True, slope, None, None, None)
            mujoco.mj_forward(model, data)
            # Other currents act at once, on other data too.
            magnets.currents *= 0.5
            other = mujoco.MjData(model)
            mujoco.mj_forward(model, other)
        found.append((data.qfrc_passive.copy(), data.qpos.copy(), slope, other.qfrc_passive.copy()))
    for ours, python in zip(*found, strict=True):
        np.testing.assert_allclose(ours, python, rtol=0, atol=1e-9 * np.abs(python).max())
    model, data = several()
    free = np.zeros_like(slope)
    mujoco.mj_step(model, data, 20)
    mujoco.mjd_transitionFD(model, data, 1e-6, True, free, None, None, None)
    assert np.abs(slope - free).max() > 1e-6


def pair_energy(data, model):
    """Energy of the dipoles in each other's fields, J."""
    at = {name: mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) for name in MAGNETS}
    places = {name: data.xpos[k] for name, k in at.items()}
    moments = {name: data.xmat[k].reshape(3, 3) @ MAGNETS[name] for name, k in at.items()}
    total = 0.0
    for one, other in (("a", "b"), ("a", "c"), ("b", "c")):
        r = places[other] - places[one]
        size = np.linalg.norm(r)
        m, k = moments[one], moments[other]
        total += 1e-7 * (m @ k / size**3 - 3 * (m @ r) * (k @ r) / size**5)
    return total


def test_magnets_on_each_other(ring):
    """Generalised forces against the loss of the dipoles' energy, by differences."""
    model, data = several()
    none = np.zeros(6)
    mujoco.mj_forward(model, data)
    with MagnetForces(model, ring.map, MAGNETS, none, mutual=True):
        mujoco.mj_forward(model, data)
    expected = np.zeros(model.nv)
    for k in range(model.nv):
        energies = []
        for sign in (1, -1):
            moved = mujoco.MjData(model)
            moved.qpos[:] = data.qpos
            mujoco.mj_integratePos(model, moved.qpos, sign * np.eye(model.nv)[k], 1e-6)
            mujoco.mj_forward(model, moved)
            energies.append(pair_energy(moved, model))
        expected[k] = -(energies[0] - energies[1]) / 2e-6
    np.testing.assert_allclose(data.qfrc_passive, expected, rtol=0, atol=1e-6 * np.abs(expected).max())
    with pytest.raises(InputError):
        MagnetForces(model, ring.map, MAGNETS, none, mutual=True, compiled=False)


def test_bodies_on_each_other_near_iron(tmp_path):
    """A magnet with a bead attached, and another bead, below a core: against our simulator."""
    path = fm.generate(fm.read_device("desk_levitator"), tmp_path / "map.h5", spacing=3e-3, progress=False)
    field = fm.open_map(path)
    pieces = [fm.PayloadPiece(fm.MagnetCylinder(4e-3, 4e-3, 1.2))]
    pieces.append(fm.PayloadPiece(fm.SoftSphere(2e-3, STEEL), fm.placed([4e-3, 0, 1e-3])))
    both, bead = magnetic_body(fm.Payload(MASS, pieces=pieces), 2), magnetic_body(fm.SoftSphere(4e-3, STEEL))
    text = """<mujoco><worldbody>
      <body name="a" pos="0.004 0 0.98"><freejoint/><geom size="0.002" mass="0.01"/></body>
      <body name="b" pos="-0.003 0.002 0.976"><freejoint/><geom size="0.002" mass="0.01"/></body>
    </worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    data, (low, offset) = mujoco.MjData(model), ([0.004, 0, -0.02], [0.0, 0.0, 1.0])
    with MagnetForces(model, field, {"a": both, "b": bead}, [0.7], offset, mutual=True):
        mujoco.mj_forward(model, data)
    one, other = (RigidBody(MASS, np.full(3, 1e-6), magnet) for magnet in (both, bead))
    loads = SeveralBodies(field, (one, other)).wrench([state_of(low), state_of([-0.003, 0.002, -0.024])], 0.7)
    np.testing.assert_allclose(data.qfrc_passive, loads.ravel(), rtol=1e-9, atol=1e-15)
    linear = magnetic_body(fm.SoftSphere(4e-3, mu_r=1e6))
    data.qpos[7:10] = data.qpos[:3] + [0.0, 0.0, 1e-3]
    with (
        pytest.raises(NotConverged),
        MagnetForces(model, field, {"a": linear, "b": linear}, [0.7], offset, mutual=True),
    ):
        mujoco.mj_forward(model, data)
    assert not data.qfrc_passive.any()


def test_energy_of_several_magnets_is_kept(ring):
    model, data = several("RK4")

    def energy():
        mujoco.mj_forward(model, data)
        total = data.energy.sum() + pair_energy(data, model)
        for name, moment in MAGNETS.items():
            k = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
            total -= data.xmat[k].reshape(3, 3) @ moment @ ring.map.field(data.xpos[k], CURRENTS)
        return total

    with MagnetForces(model, ring.map, MAGNETS, CURRENTS, mutual=True) as magnets:
        start, kinetic = energy(), []
        for _ in range(40):
            mujoco.mj_step(model, data)
            kinetic.append(data.energy[1])
        magnets.check()
        assert abs(energy() - start) < 1e-5 * max(kinetic)
    assert np.ptp(kinetic) > 0.1 * max(kinetic)


def falling(ring, magnet, known, currents, steps):
    """The body, tilted and turning, where it begins, and where MuJoCo's Runge-Kutta steps bring it."""
    body = RigidBody(MASS, np.array([6e-7, 7e-7, 3e-7]), magnet, gravity=GRAVITY)
    begin = state_of([0.003, 0.002, HEIGHT], (0.01, 0.0, 0.02), (1.0, 0.1, -0.05, 0.2), (3.0, -2.0, 20.0))
    text = f"""<mujoco><option timestep="1e-4" gravity="0 0 -{GRAVITY}" integrator="RK4"/><worldbody><body name="float">
        <freejoint/><inertial pos="0 0 0" mass="{MASS}" diaginertia="6e-7 7e-7 3e-7"/></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = [*begin[:3], *begin[6:10]], [*begin[3:6], *begin[10:]]
    with MagnetForces(model, ring.map, {"float": known}, currents):
        mujoco.mj_step(model, data, steps)
    return body, begin, data


def turned_alike(data, found):
    """By how much two attitudes differ; q and -q are the same attitude."""
    return min(np.abs(data.qpos[3:] - sign * found[6:10]).max() for sign in (1, -1))


def test_poses_are_those_of_our_simulator(ring):
    """0.1 s at currents that nearly carry it, against an adaptive integrator."""
    currents, magnet = np.full(6, 0.98 * lift_current(ring)), np.array([[0, 0, MOMENT]])
    body, begin, data = falling(ring, FiniteMagnet(np.zeros((1, 3)), magnet), [0, 0, MOMENT], currents, 1000)
    found = move_adaptively(ring.map.at(currents), body, begin, [0.0, 0.1])[-1]
    assert np.abs(data.qpos[:3] - found[:3]).max() < 1e-9
    assert turned_alike(data, found) < 1e-6
    assert np.abs(data.qvel[3:] - found[10:]).max() < 1e-3
    assert np.abs(found[:3] - begin[:3]).max() > 1e-3


STEEL = fm.material("steel_a3")
# Two soft pieces, turned and beside the centre, and a magnet.
BODY = magnetic_body(
    fm.Payload(
        MASS,
        pieces=[
            fm.PayloadPiece(
                fm.SoftEllipsoid((6e-3, 6e-3, 16e-3), STEEL), fm.placed([0, 0, 6e-3], [30.0, 0, 0])
            ),
            fm.PayloadPiece(fm.SoftSphere(8e-3, mu_r=200.0), fm.placed([4e-3, 0.0, -2e-3])),
            fm.PayloadPiece(fm.MagnetSphere(8e-3, 1.2), fm.placed([0.0, 0.0, -6e-3])),
        ],
    )
)


@pytest.mark.parametrize("compiled", [True, False])
def test_soft_iron_feels_the_wrench_of_the_map(ring, compiled):
    model, data = scene(0.004, -0.003, -0.1, tilt=40.0)
    currents = np.array([8.0, 9.0, 6.0, -4.0, 2.0, 5.0])
    with MagnetForces(model, ring.map, {"float": BODY}, currents, compiled=compiled) as magnets:
        assert magnets.compiled == compiled
        mujoco.mj_forward(model, data)
    turn = data.xmat[1].reshape(3, 3)
    expected = ring.map.wrench(np.array([0.004, -0.003, -0.1]), BODY, currents, turn)
    soft = np.linalg.norm(
        expected - replace(BODY, soft=()).wrench(ring.map, [0.004, -0.003, -0.1], currents, turn)
    )
    assert soft > 0.05 * np.linalg.norm(expected)
    np.testing.assert_allclose(data.qfrc_passive[:3], expected[:3], rtol=1e-9)
    np.testing.assert_allclose(turn @ data.qfrc_passive[3:], expected[3:], rtol=1e-9, atol=1e-15)


def test_poses_of_soft_iron_are_those_of_our_simulator(ring):
    """As with magnets, by our steps of fourth order."""
    currents = np.full(6, 6.0)
    body, begin, data = falling(ring, BODY, BODY, currents, 500)
    run = move(ring.map.at(currents), body, begin, 0.05, 2e-5, order="fourth")
    found = run.states[-1]
    assert np.abs(data.qpos[:3] - found[:3]).max() < 1e-8
    assert turned_alike(data, found) < 1e-5
    # The energy, with that of the induced moments, is kept.
    total = energy(ring.map.at(currents), body, run.states[[0, -1]])
    magnetic = BODY.energy(ring.map, [begin[:3], found[:3]], currents, None)
    assert abs(np.ptp(total)) < 1e-6 * abs(magnetic).max()


FREE, HINGED = "<freejoint/>", '<joint type="slide"/><joint type="hinge" axis="1 0 0"/>'


@pytest.mark.parametrize(
    ("count", "joints", "integrator", "bound"),
    [
        (1, FREE, "Euler", 1.3),
        (3, FREE, "Euler", 1.35),
        (3, FREE, "RK4", 1.4),
        (1, HINGED, "Euler", 1.3),
        (3, HINGED, "Euler", 1.5),
    ],
    ids=["one", "three", "three by RK4", "one hinged", "three hinged"],
)
def test_a_step_with_the_map_costs_little_more_than_one_without(ring, count, joints, integrator, bound):
    """In turns of a millisecond. The bodies have magnets and nothing else: no steps are cheaper."""
    bodies = "".join(
        f'<body name="{k}" pos="{0.005 * k} 0 -0.09">{joints}<geom size="0.001" mass="0.01"/></body>'
        for k in range(count)
    )
    option = f'<option timestep="1e-6" integrator="{integrator}"/>'
    text = f"<mujoco>{option}<worldbody>{bodies}</worldbody></mujoco>"
    model = mujoco.MjModel.from_xml_string(text)
    magnets = MagnetForces(model, ring.map, {str(k): [0, 0, MOMENT] for k in range(count)}, CURRENTS)

    def seconds():
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 20)
        begin = time.perf_counter()
        mujoco.mj_step(model, data, 500)
        return (time.perf_counter() - begin) / 500

    ratios, without = [], []
    for _ in range(200):
        without.append(seconds())
        with magnets:
            ratios.append(seconds() / without[-1])
    step, ratio = 1e6 * np.median(without), np.median(ratios)
    print(f"{count} magnets {joints} {integrator}: a step {step:.2f} us, with the map times {ratio:.2f}")
    assert ratio < bound


def test_another_model_feels_nothing_and_contexts_nest(ring):
    (model, data), (other, beside) = scene(), scene()
    magnets = MagnetForces(model, ring.map, {"float": [0, 0, MOMENT]}, CURRENTS)
    with magnets:
        mujoco.mj_forward(other, beside)
        assert not beside.qfrc_passive.any()
        with MagnetForces(other, ring.map, {"float": [0, 0, 2 * MOMENT]}, CURRENTS):
            mujoco.mj_forward(other, beside)
        mujoco.mj_forward(model, data)
    np.testing.assert_allclose(beside.qfrc_passive, 2 * data.qfrc_passive, rtol=1e-12)
    assert data.qfrc_passive.any()
    mujoco.mj_forward(model, data)
    assert not data.qfrc_passive.any()


def test_the_lines_of_the_documentation(ring, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_map("linear.h5", ring.data)
    Path("levitator.xml").write_text(blocks("simulators.md", "xml", "## MuJoCo")[0])
    names = {}
    exec(blocks("simulators.md", below="## MuJoCo")[0], names)
    assert np.abs(names["data"].qpos[:3] - [0.0, 0.0, -0.09]).max() < 1e-4
