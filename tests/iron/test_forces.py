"""Forces and torques against closed forms, virtual displacement, and each other."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import mu_0

import fieldmap as fm
from fieldmap.errors import InputError
from tests.iron.shared import at, moments_of_two_spheres, sphere_inductance

TILT = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6], [0.0, 0.6, 0.8]])


def turned(angle):
    """Rotation about the global x axis."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def block_and_coils(shift=0.0, angle=0.0):
    """A block, a ball apart from it, a tilted ring coil and a rounded rectangle; the ring moves along y or turns."""
    bodies = (
        fm.Body("block", "iron", (fm.Part(fm.Box((0.03, 0.02, 0.01))),), 0.006),
        fm.Body("ball", "iron", (fm.Part(fm.Sphere(0.006), at(0.004, 0.0, 0.019)),), 0.003),
    )
    centre = np.array([0.003, -0.004 + shift, 0.042])
    place = fm.Placement(centre, turned(angle) @ TILT)
    ring = fm.CircularCoil("ring", 0.008, 0.012, 0.006, 100.0, placement=place)
    size = 0.02, 0.015, 0.004, 0.004, 0.006
    frame = fm.RoundedRectangleCoil("frame", *size, 60.0, -1, placement=at(0, 0, -0.01))
    return fm.Device("block", "", (ring, frame), bodies, {"iron": fm.LinearMaterial("iron", 300.0)})


CURRENTS = np.array([3.0, 2.0])
PARTS = ("block", "ball", "ring", "frame")


@pytest.fixture(scope="module", params=["potential", "flux"])
def solution(request):
    return fm.solve_linear(block_and_coils(), form=request.param)


def test_action_is_reaction(solution):
    """Two pieces of iron and two coils: forces, and torques about any one point, add up to nothing."""
    about = [0.01, 0.02, -0.03]
    forces = np.array([solution.force_on(name, CURRENTS) for name in PARTS])
    torques = np.array([solution.torque_on(name, CURRENTS, about) for name in PARTS])
    assert np.abs(forces.sum(axis=0)).max() < 2e-3 * np.abs(forces).max()
    assert np.abs(torques.sum(axis=0)).max() < 2e-3 * np.abs(torques).max()


def test_forces_add_up_grow_with_the_square_of_the_current_and_turn_about_any_point(solution):
    """Forces of parts add up, grow with the square of the current, and T(b) = T(a) + (a - b) x F."""
    force, together = solution.force_on("ring", CURRENTS), solution.force_on(["block", "ring"], CURRENTS)
    single = solution.force_on("block", CURRENTS) + force
    assert together == pytest.approx(single, abs=2e-3 * np.abs(single).max())
    assert solution.force_on(PARTS, CURRENTS) == pytest.approx(np.zeros(3), abs=1e-12)
    assert solution.force_on("ring", 2 * CURRENTS) == pytest.approx(4 * force)
    assert (solution.force_on("ball", 0 * CURRENTS) == 0).all()
    a, b = np.array([0.01, 0.0, 0.02]), np.array([-0.03, 0.04, 0.0])
    expected = solution.torque_on("ring", CURRENTS, a) + np.cross(a - b, force)
    assert solution.torque_on("ring", CURRENTS, b) == pytest.approx(expected)


def test_virtual_displacement_and_rotation():
    """Force and torque on a coil = derivative of the field energy at constant currents (linear iron)."""
    base = fm.solve_linear(block_and_coils())

    def slope(step, **moves):
        ahead, behind = (
            fm.solve_linear(block_and_coils(**{k: s * v for k, v in moves.items()})).energy(CURRENTS)
            for s in (1, -1)
        )
        return (ahead - behind) / (2 * step)

    force = base.force_on("ring", CURRENTS)
    assert slope(5e-4, shift=5e-4) == pytest.approx(force[1], abs=3e-3 * np.abs(force).max())
    torque = base.torque_on("ring", CURRENTS, block_and_coils().coils[0].placement.position)
    assert slope(0.02, angle=0.02) == pytest.approx(torque[0], rel=3e-3)


def loop_and_sphere_force(height, step=1e-5):
    """Axial force on a coil of 1 A above a sphere, closed form: half the derivative of the inductance that the sphere
    adds."""
    return 0.5 * (sphere_inductance(height + step) - sphere_inductance(height - step)) / (2 * step)


@pytest.mark.parametrize("form", ["potential", "flux"])
def test_loop_and_sphere_against_its_closed_form(form):
    unit = fm.solve_linear(fm.read_device("loop_and_sphere"), form=form)
    exact = loop_and_sphere_force(0.025)
    for name, sign in (("loop", 1), ("sphere", -1)):
        assert unit.force_on(name, [1.0]) == pytest.approx([0, 0, sign * exact], abs=1e-3 * abs(exact))


@pytest.mark.parametrize("gap", [0.4, 1.0])
def test_two_spheres_in_a_uniform_field(gap):
    """F = d/dx of half the total moment times the field (linear): spheres of 50 mm in 1 T along their axis."""
    radius, mu, distance = 0.05, 1000.0, 2 + gap
    bodies = tuple(
        fm.Body(name, "iron", (fm.Part(fm.Sphere(radius), at(0, 0, z)),), 0.011)
        for name, z in (("low", 0.0), ("high", radius * distance))
    )
    law = {"iron": fm.LinearMaterial("iron", mu)}
    device = fm.Device("d", "", (), bodies, law, background=fm.Background(np.array([0.0, 0.0, 1.0])))
    state = fm.solve_linear(device, tolerance=1e-7).at([])
    step = 1e-4
    ahead, behind = (2 * moments_of_two_spheres(mu, distance + s * step)[0] for s in (1, -1))
    slope = (ahead - behind) / (2 * step)
    exact = 0.5 * 4 * np.pi / mu_0 * radius**2 * slope
    high, low = state.force_on("high"), state.force_on("low")
    assert exact < 0
    assert high == pytest.approx([0, 0, exact], abs=5e-3 * abs(exact))
    assert low == pytest.approx(-high, abs=5e-3 * abs(exact))


def test_magnet_and_plate():
    """A magnetised ball is a dipole; an iron plate mirrors it: F = 3 mu0 m^2 / (32 pi d^4) for a moment along the
    normal (Jackson, section 5.12 and the dipole force). The plate is finite: 2 %."""
    radius, height, remanence = 0.004, 0.008, 1.2
    plate = fm.Body("plate", "iron", (fm.Part(fm.Cylinder(0.03, 0.006), at(0, 0, -0.006)),), 0.003)
    ball = fm.Body("ball", "magnet", (fm.Part(fm.Sphere(radius), at(0, 0, height)),), 0.0015)
    materials = {
        "iron": fm.LinearMaterial("iron", 1000.0),
        "magnet": fm.PermanentMagnet("magnet", np.array([0, 0, remanence]), 1.0),
    }
    idle = fm.CircularCoil("idle", 0.01, 0.012, 0.002, 1.0, placement=at(0, 0, 0.05))
    moment = remanence / mu_0 * 4 / 3 * np.pi * radius**3
    exact = 999 / 1001 * 3 * mu_0 * moment**2 / (32 * np.pi * height**4)
    unit = fm.solve_linear(fm.Device("d", "", (idle,), (plate, ball), materials))
    assert unit.force_on("ball", [0.0]) == pytest.approx([0, 0, -exact], abs=0.02 * exact)
    assert unit.force_on("plate", [0.0]) == pytest.approx([0, 0, exact], abs=0.02 * exact)


def test_action_is_reaction_between_saturated_iron_magnet_and_coil():
    """All three kinds of bodies in one state, without symmetry: forces, and torques about any point, cancel to 1 %."""
    core = fm.Body("core", "steel", fm.Cylinder(0.005, 0.02), 0.004)
    block = fm.Box((0.008, 0.006, 0.005))
    magnet = fm.Body("magnet", "magnet", block, 0.003).moved([0.004, 0.002, 0.022])
    materials = {
        "steel": fm.Froehlich("steel", 3000.0, 2.0),
        "magnet": fm.PermanentMagnet("magnet", np.array([0.5, -0.2, 1.0]), 1.05),
    }
    coil = fm.CircularCoil("coil", 0.006, 0.008, 0.012, 300.0, placement=at(0.0005, 0, 0.012))
    state = fm.solve(fm.Device("d", "", (coil,), (core, magnet), materials), [10.0])
    assert state.report.largest_flux_density > 1.6
    about = [0.01, 0.02, -0.03]
    names = ("core", "magnet", "coil")
    forces = np.array([state.force_on(name) for name in names])
    torques = np.array([state.torque_on(name, about) for name in names])
    assert np.abs(forces.sum(axis=0)).max() < 5e-3 * np.abs(forces).max()
    assert np.abs(torques.sum(axis=0)).max() < 5e-3 * np.abs(torques).max()
    assert all(np.abs(force).max() > 0.01 for force in forces)


def test_coaxial_coils_without_iron():
    """Two far, small loops: the force between dipoles on one axis, 3 mu0 m m' / (2 pi d^4)."""
    one = fm.CircularCoil("a", 0.009, 0.011, 0.002, 50.0)
    coils = one, replace(one, name="b", placement=at(0, 0, 0.8))
    unit = fm.solve_linear(fm.Device("d", "", coils))
    moment = 50 * np.pi * (0.009**2 + 0.009 * 0.011 + 0.011**2) / 3
    exact = 3 * mu_0 * moment**2 / (2 * np.pi * 0.8**4)
    assert unit.force_on("a", [1.0, 1.0]) == pytest.approx([0, 0, exact], rel=3e-3, abs=1e-6 * exact)
    assert unit.force_on("b", [1.0, 1.0]) == pytest.approx([0, 0, -exact], rel=3e-3, abs=1e-6 * exact)


def test_bodies_that_touch_have_a_force_together_only():
    device = block_and_coils()
    lid = fm.Body("lid", "iron", (fm.Part(fm.Cylinder(0.008, 0.002), at(0, 0, -0.002)),), 0.004)
    unit = fm.solve_linear(replace(device, bodies=(*device.bodies, lid), coils=device.coils[:1]))
    with pytest.raises(InputError) as caught:
        unit.force_on("lid", [1.0])
    (problem,) = caught.value.problems
    assert "'block'" in problem.received
    assert "['block', 'lid']" in problem.remedy
    together = unit.force_on(["block", "lid"], [1.0])
    rest = unit.force_on(["ball", "ring"], [1.0])
    assert together == pytest.approx(-rest, abs=5e-3 * np.abs(rest).max())


@pytest.mark.parametrize(
    ("call", "where"),
    [
        (lambda s: s.force_on(["blok", "rong"], CURRENTS), "force, name"),
        (lambda s: s.force_on([], CURRENTS), "force, name"),
        (lambda s: s.force_on("block", [1.0]), "currents"),
        (lambda s: s.torque_on("block", CURRENTS, [0.0, np.nan, 0.0]), "torque, about"),
        (lambda s: s.torque_on("block", CURRENTS, [0.0, 0.0]), "torque, about"),
    ],
)
def test_bad_input(solution, call, where):
    with pytest.raises(InputError) as caught:
        call(solution)
    assert {problem.where for problem in caught.value.problems} == {where}
    assert len(caught.value.problems) == (2 if "rong" in caught.value.problems[-1].received else 1)
