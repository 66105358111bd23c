"""Bodies that act on each other: closed forms, the full solver, energy gradients, motion, contacts."""

import numpy as np
import pytest
from scipy.constants import mu_0
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import fieldmap as fm
from fieldmap.dynamics import Drag, RigidBody, SeveralBodies, Walls, move, state_of
from fieldmap.errors import InputError, NotConverged, OutsideMapError
from fieldmap.lookup import MagneticBody, magnetic_body, open_map, volume_rule
from tests.dynamics.conftest import axial_map
from tests.refusals import refused

NONE = MagneticBody(np.zeros((0, 3)), np.zeros((0, 3)))
STEP = 1e-6


def body(magnet, mass=1e-3, inertia=1e-8, **more):
    return RigidBody(mass, np.full(3, inertia), magnet, **more)


def dipole(moment):
    return body(MagneticBody(np.zeros((1, 3)), np.array([moment])))


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("several") / "levitator.h5"
    return fm.generate(fm.read_device("desk_levitator"), path, spacing=3e-3, progress=False)


@pytest.fixture(scope="module", params=["harmonic", "hermite"])
def field(file, request):
    return open_map(file, kind=request.param)


@pytest.fixture(scope="module")
def uniform():
    """1 T along z per ampere, and no iron."""
    return axial_map((1.0, 0.0, 0.0))


def test_two_dipoles_in_empty_space(uniform):
    """Yung, Landecker and Villani, Magn. Electr. Sep. 9 (1998) 39, with the unit vector between the dipoles; action
    equals reaction, for torques about a common point too."""
    moments = np.array([[0.3, -0.2, 0.9], [-0.5, 0.4, 0.1]])
    places = np.array([[0.004, -0.003, 0.001], [-0.006, 0.005, -0.008]])
    turns = Rotation.from_rotvec([[0.3, 0.2, -0.5], [-0.1, 0.7, 0.2]])
    states = [
        state_of(p, quaternion=q) for p, q in zip(places, turns.as_quat()[:, [3, 0, 1, 2]], strict=True)
    ]
    loads = SeveralBodies(uniform, (dipole(moments[0]), dipole(moments[1]))).wrench(states, 0.0)
    a, b = turns.apply(moments)
    r = np.linalg.norm(places[0] - places[1])
    n = (places[0] - places[1]) / r
    force = (
        3 * mu_0 / (4 * np.pi * r**4) * ((a @ n) * b + (b @ n) * a + (a @ b) * n - 5 * (a @ n) * (b @ n) * n)
    )
    torque = mu_0 / (4 * np.pi * r**3) * np.cross(a, 3 * (b @ n) * n - b)
    np.testing.assert_allclose(loads[0], [*force, *torque], rtol=1e-12)
    np.testing.assert_allclose(loads[:, :3].sum(axis=0), 0.0, atol=1e-13 * np.linalg.norm(force))
    about = loads[:, 3:] + np.cross(places, loads[:, :3])
    np.testing.assert_allclose(about.sum(axis=0), 0.0, atol=1e-13 * np.linalg.norm(torque))


@pytest.mark.parametrize("along", [0, 2])
def test_two_soft_beads_in_a_uniform_field(uniform, along):
    """m = c B / (1 - c s), s the field of a unit moment at the other bead: 2 mu0 / (4 pi r^3) along the line between
    them, minus half of that across; F from the energy -c B^2 / (1 - c s) of both."""
    radius, r, flux = 1.5e-3, 4e-3, 0.2
    bead = body(magnetic_body(fm.SoftSphere(2 * radius, mu_r=1e12)))
    places = np.zeros((2, 3))
    places[0, along] = r
    loads = SeveralBodies(uniform, (bead, bead)).wrench([state_of(p) for p in places], flux)
    c, unit = 4 * np.pi * radius**3 / mu_0, mu_0 / (4 * np.pi * r**3)
    share = 2.0 if along == 2 else -1.0
    moment = c * flux / (1 - c * share * unit)
    wanted = np.zeros((2, 6))
    wanted[:, along] = -3 * share * unit / r * moment**2 * np.array([1, -1])
    np.testing.assert_allclose(loads, wanted, rtol=1e-11, atol=1e-12 * np.abs(wanted).max())
    alone = SeveralBodies(uniform, (bead,)).wrench([state_of([0, 0, 0])], flux)
    np.testing.assert_allclose(alone, 0.0, atol=1e-15)


def test_soft_beads_that_overlap_are_refused(uniform):
    """At c s > 1, where the mutual magnetisation diverges."""
    bead = body(magnetic_body(fm.SoftSphere(4e-3, mu_r=1e12)))
    several, states = SeveralBodies(uniform, (bead, bead)), [state_of([0, 0, 0]), state_of([0, 0, 2e-3])]
    with pytest.raises(NotConverged):
        several.wrench(states, 0.1)
    with pytest.raises(NotConverged):
        several.run(states, 0.1, 1e-3)


def bodies(saturating):
    """A finite magnet, a bead, and a magnet with a bead attached."""
    iron = {"material": fm.material("steel_a3")} if saturating else {"mu_r": 500.0}
    magnet, beside = fm.MagnetCylinder(3e-3, 4e-3, 1.2), fm.placed([3e-3, 0.0, 1e-3])
    pieces = [fm.PayloadPiece(magnet), fm.PayloadPiece(fm.SoftSphere(2e-3, **iron), beside)]
    pair = magnetic_body(fm.Payload(mass=1e-3, pieces=pieces), level=2)
    bead = magnetic_body(fm.SoftSphere(3e-3, **iron))
    return [volume_rule(magnet, 2), bead, pair]


PLACES = np.array([[0.005, 0.001, -0.022], [-0.004, -0.003, -0.019], [0.001, 0.004, -0.03]])
TURNS = Rotation.from_rotvec([[0.3, 0.2, 0.1], [0.0, 0.1, 0.4], [-0.5, 0.3, 0.2]])


def poses(places, turns):
    return [state_of(p, quaternion=q) for p, q in zip(places, turns.as_quat()[:, [3, 0, 1, 2]], strict=True)]


@pytest.mark.parametrize("saturating", [False, True])
def test_force_and_torque_are_derivatives_of_the_energy(field, saturating):
    several = SeveralBodies(field, [body(one, gravity=0.0) for one in bodies(saturating)])
    loads = several.wrench(poses(PLACES, TURNS), 1.5)
    expected = np.empty((3, 6))
    for n in range(3):
        for k in range(6):
            energies = []
            for sign in (1, -1):
                places, by = PLACES.copy(), np.zeros((3, 3))
                if k < 3:
                    places[n, k] += sign * STEP
                else:
                    by[n, k - 3] = sign * 1e-4
                energies.append(several.energy(poses(places, Rotation.from_rotvec(by) * TURNS), 1.5))
            expected[n, k] = -(energies[0] - energies[1]) / (2 * STEP if k < 3 else 2e-4)
    for part in (slice(3), slice(3, 6)):
        within = 1e-6 * np.abs(loads[:, part]).max()
        np.testing.assert_allclose(loads[:, part], expected[:, part], rtol=0, atol=within)


def test_one_body_alone_is_as_before(field):
    for one, place in zip(bodies(True), PLACES, strict=True):
        load = SeveralBodies(field, [body(one)]).wrench([state_of(place)], [0.7])
        np.testing.assert_allclose(load[0], one.wrench(field, place, [0.7]), rtol=1e-9, atol=1e-20)


def test_force_on_two_magnets_as_bodies_of_the_device(file):
    """Against the full solver with both magnets meshed; the iron's reaction to the other magnet changes the sum by more
    than 5 %."""
    device, field = fm.read_device("desk_levitator"), open_map(file)
    places = np.array([[-0.005, 0.0, -0.019], [0.005, 0.001, -0.0205]])
    parts = [
        fm.Body(
            f"magnet {k}",
            "ndfeb",
            (fm.Part(fm.Cylinder(3e-3, 5e-3), fm.Placement(place - [0, 0, 2.5e-3])),),
            1.2e-3,
            edge_size=0.6e-3,
        )
        for k, place in enumerate(places)
    ]
    magnet = fm.PermanentMagnet("ndfeb", np.array([0.0, 0.0, 1.2]), 1.0)
    known = {**device.materials, "ndfeb": magnet}
    solution = fm.solve_linear(fm.Device("both", "", device.coils, (*device.bodies, *parts), known))
    exact = np.array([solution.force_on(part.name, [0.4]) for part in parts])
    one = volume_rule(fm.MagnetCylinder(6e-3, 5e-3, 1.2), 4)
    found = SeveralBodies(field, [body(one), body(one)]).wrench([state_of(p) for p in places], 0.4)[:, :3]
    np.testing.assert_allclose(found, exact, atol=5e-3 * np.linalg.norm(exact, axis=1).min())
    whole = exact.sum(axis=0)
    assert found.sum(axis=0) == pytest.approx(whole, abs=5e-3 * np.linalg.norm(whole))
    alone = sum(one.wrench(field, place, [0.4])[:3] for place in places)
    assert np.linalg.norm(alone - whole) > 0.05 * np.linalg.norm(whole)


BALL = fm.MagnetSphere(3e-3, 1.2)
CEILING = Walls(ceiling=-0.02, restitution=1.0, friction=0.0)


def test_energy_is_kept_for_ten_seconds(file):
    """Two magnets swing and turn on a smooth ceiling below the core, which attracts them to its axis while they repel
    each other. Their centres touch the ceiling all the time."""
    mass, radius, current = 0.107e-3, 1.5e-3, 2.0
    one = body(magnetic_body(BALL, 1), mass, 0.4 * mass * radius**2, skin=np.zeros((1, 3)))
    several = SeveralBodies(open_map(file, kind="hermite"), (one, one), walls=CEILING)
    start = np.array(
        [
            state_of([-0.006, 0.001, -0.02], quaternion=(1, 0.1, 0.2, 0)),
            state_of([0.005, -0.002, -0.02], (0, 0.02, 0), (1, -0.15, 0.1, 0)),
        ]
    )
    spring = CEILING.numbers(mass)[0]
    start[:, 2] += (several.wrench(start, current)[:, 2] - mass * one.gravity) / spring
    run = several.run(start, current, 10.0, 5e-5, sample=0.02, order="fourth")
    assert run.inside
    assert run.touched
    assert not run.collided
    heights, places = run.states[:, :, 2] + 0.02, run.states[:, :, :3]
    assert (heights > 0).all()
    total = [several.energy(states, current) for states in run.states]
    total = np.array(total) + 0.5 * spring * (heights**2).sum(axis=1)
    kinetic = 0.5 * mass * (run.states[:, :, 3:6] ** 2).sum(axis=(1, 2))
    kinetic += 0.5 * one.inertia[0] * (run.states[:, :, 10:] ** 2).sum(axis=(1, 2))
    assert np.abs(total - total[0]).max() < 1e-6 * np.ptp(kinetic)
    # They swing across the axis and back, and come closer than 12 mm to each other.
    assert (np.ptp(places[:, :, 0], axis=0) > 0.01).all()
    assert np.linalg.norm(places[:, 0] - places[:, 1], axis=1).min() < 0.012


def test_steps_are_of_their_order(file):
    """Two magnets that fly past each other, at halved steps."""
    several = SeveralBodies(open_map(file, kind="hermite"), [body(one) for one in bodies(False)[::2]])
    start = [state_of(PLACES[0], (-0.4, 0.0, 0.0)), state_of(PLACES[2], (0.4, 0.0, 0.0), (1, 0.3, 0, 0))]
    for order, wanted in (("second", 2), ("fourth", 4)):
        ends = [several.run(start, 1.0, 4e-3, step, order=order).states[-1] for step in (1e-4, 5e-5, 2.5e-5)]
        rate = np.log2(np.abs(ends[0] - ends[1]).max() / np.abs(ends[1] - ends[2]).max())
        assert rate == pytest.approx(wanted, abs=0.4)


def test_one_body_moves_as_it_does_alone(file):
    field, start = open_map(file, kind="hermite"), state_of(PLACES[2], (0.1, 0.0, 0.0), (1, 0.3, 0, 0))
    one = body(bodies(True)[2])
    alone = move(field.at([0.6]), one, start, 0.01, every=10)
    run = SeveralBodies(field, (one,)).run([start], 0.6, 0.01)
    np.testing.assert_allclose(run.states[:, 0], alone.states, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(run.time, alone.time, atol=1e-15)


def test_drag_along_the_axes_of_each_body(uniform):
    """Two bodies of different orientation move as each does alone."""
    drag = Drag(body_linear=(0.1, 0.0, 0.3), turning=(1e-7, 0.0, 3e-7))
    start = [
        state_of([0.01, 0, 0], (0.1, 0.2, 0.3), (1, 0.5, 0, 0), (9, 0, 5)),
        state_of([-0.01, 0, 0], (0.2, 0.1, -0.3), (1, 0, -0.7, 0.2), (0, 7, 5)),
    ]
    still = body(NONE, gravity=0.0)
    run = SeveralBodies(uniform, (still, still), drag=drag).run(start, 0.0, 0.01)
    for n in range(2):
        alone = move(uniform.at([0.0]), still, start[n], 0.01, drag=drag, every=10)
        np.testing.assert_allclose(run.states[:, n], alone.states, rtol=1e-12, atol=1e-15)


def colliding(uniform, velocities, spin=(0, 0, 0), masses=(1e-3, 3e-3), **walls):
    """The states before and after two balls of radius 2 mm, without magnets, collide along x; and the bodies."""
    pair = [body(NONE, mass, 2e-9 * (1e3 * mass), gravity=0.0) for mass in masses]
    several = SeveralBodies(uniform, pair, walls=Walls(contact_time=1e-3, **walls), radii=[2e-3, 2e-3])
    start = np.array([state_of([-3e-3, 0, 0], velocities[0], (1, 0, 0, 0), spin), state_of([3e-3, 0, 0])])
    start[1, 3:6] = velocities[1]
    run = several.run(start, 0.0, 0.03, 1e-6)
    assert run.collided
    assert not run.touched
    return run.states[0], run.states[-1], pair


@pytest.mark.parametrize("restitution", [1.0, 0.4])
def test_balls_bounce(uniform, restitution):
    before, after, pair = colliding(
        uniform, [(0.3, 0, 0), (-0.1, 0, 0)], restitution=restitution, friction=0.0
    )
    # The reduced mass on a damped spring that only pushes: docs/theory/dynamics.md (19), (20).
    share, rate = -np.log(restitution) / np.pi, np.pi / 1e-3

    def slope(_, y):
        return y[1], -max(rate**2 * (1 + share**2) * y[0] + 2 * share * rate * y[1], 0.0)

    apart = -solve_ivp(slope, (0.0, 3e-3), (0.0, 0.4), rtol=1e-9, atol=1e-12).y[1, -1]
    assert 1.0 <= apart / (0.4 * restitution) < 1.25
    masses = np.array([one.mass for one in pair])
    assert masses @ after[:, 3] == pytest.approx(masses @ before[:, 3], rel=1e-9)
    assert after[1, 3] - after[0, 3] == pytest.approx(apart, rel=1e-3)


def test_balls_that_rub_keep_both_momenta(uniform):
    before, after, pair = colliding(
        uniform, [(0.3, 0.1, 0.02), (-0.1, 0, 0)], (10.0, -20.0, 200.0), friction=0.3
    )

    def momenta(states):
        linear = [one.mass * row[3:6] for one, row in zip(pair, states, strict=True)]
        turning = [
            Rotation.from_quat(row[[7, 8, 9, 6]]).apply(one.inertia * row[10:])
            for one, row in zip(pair, states, strict=True)
        ]
        orbit = [np.cross(row[:3], p) for row, p in zip(states, linear, strict=True)]
        return np.sum(linear, axis=0), np.sum(turning, axis=0) + np.sum(orbit, axis=0)

    for first, last in zip(momenta(before), momenta(after), strict=True):
        np.testing.assert_allclose(last, first, atol=1e-9 * np.linalg.norm(first))
    assert np.abs(after[1, 10:]).max() > 1.0


def test_a_body_without_radius_touches_no_other(uniform):
    pair = [body(NONE, gravity=0.0), body(NONE, gravity=0.0)]
    start = [state_of([-3e-3, 0, 0], (0.3, 0, 0)), state_of([3e-3, 0, 0])]
    run = SeveralBodies(uniform, pair, radii=[2e-3, 0.0]).run(start, 0.0, 0.03)
    assert not run.collided
    assert run.states[-1, 0, 3] == 0.3


def test_a_controller_is_asked_once_a_sample(uniform):
    """A moment across the field of 1 T/A turns by the controller's currents, each held until the next sample."""
    one, asked = dipole([1.0, 0.0, 0.0]), []
    start, currents = [state_of([0, 0, 0]), state_of([0.01, 0, 0])], [1e-3, -2e-3, 0.0]

    def control(time, states):
        asked.append((time, states))
        return [currents[len(asked) - 1]]

    light = body(one.magnet, inertia=1e-6, gravity=0.0)
    still = body(NONE, gravity=0.0)
    run = SeveralBodies(uniform, (light, still)).run(start, control, 0.006, 1e-4, sample=2e-3)
    assert [time for time, _ in asked] == pytest.approx([0.0, 2e-3, 4e-3])
    np.testing.assert_array_equal([states for _, states in asked], run.states[:3])
    np.testing.assert_allclose(run.currents[:, 0], [1e-3, -2e-3, 0.0, 0.0])
    # m x B turns the moment about -y: 1e-3 N m over 1e-6 kg m^2 for 2 ms, then twice as fast back.
    np.testing.assert_allclose(run.states[:, 0, 11], [0.0, -2.0, 2.0, 2.0], atol=1e-2)


def test_a_controller_of_constant_currents_changes_nothing(field):
    several = SeveralBodies(field, [body(one) for one in bodies(True)])
    start = poses(PLACES, TURNS)
    steady = several.run(start, 0.8, 0.004)
    asked = several.run(start, lambda time, states: [0.8], 0.004)
    np.testing.assert_allclose(asked.states, steady.states, rtol=1e-12, atol=1e-12)
    assert steady.known


def test_what_leaves_the_map_ends_the_run(field):
    several = SeveralBodies(field, [dipole([0, 0, 0.01]), dipole([0, 0, 0.01])])
    start = [state_of([0, 0, -0.02]), state_of([0.005, 0, -0.04], (0, 0, -1.0))]
    run = several.run(start, 0.0, 0.1)
    assert not run.inside
    assert 0.003 < run.time[-1] < 0.006
    assert len(run.states) == len(run.time) == len(run.currents)
    with pytest.raises(OutsideMapError):
        several.wrench([start[0], state_of([0, 0, -0.05])], 0.0)


def test_refusals(field):
    pair = (dipole([0, 0, 0.01]), dipole([0, 0, 0.01]))
    several, start = SeveralBodies(field, pair), [state_of([0, 0, -0.02]), state_of([0.005, 0, -0.02])]
    for wrong in (
        lambda: SeveralBodies(field, ()),
        lambda: SeveralBodies(field, pair, radii=[1e-3]),
        lambda: SeveralBodies(field, pair, radii=[1e-3, -1e-3]),
        lambda: several.wrench(start[:1], 0.0),
        lambda: several.run(start, 0.0, 0.1, 1e-4, sample=1.5e-4),
        lambda: several.run(start, lambda time, states: [1.0, 2.0], 0.1),
        lambda: several.run(start, lambda time, states: [np.nan], 0.1),
    ):
        with refused(InputError):
            wrong()
