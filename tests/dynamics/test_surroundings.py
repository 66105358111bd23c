"""Drag, walls and eddy currents against closed forms and quadrature."""

from itertools import pairwise

import numpy as np
import pytest

from fieldmap.constants import MU0
from fieldmap.core.machine import plate_force
from fieldmap.dynamics import Drag, Plate, RigidBody, Walls, move, state_of
from fieldmap.errors import InputError
from tests.refusals import refused

MOMENT, HEIGHT, SIGMA = 0.8, 0.02, 3.5e7


def falling(axial, drag, duration, **more):
    body = RigidBody(0.01, [1e-6] * 3, axial.dipole(0.0))
    still = axial.map((0.01, 0.0, 0.0), half=10.0).at([1.0])
    return move(still, body, state_of([0, 0, 0], **more), duration, 1e-3, order="fourth", drag=drag)


def test_quadratic_drag_along_an_axis_of_a_body_that_lies(axial):
    lying = [np.cos(np.pi / 4), np.sin(np.pi / 4), 0.0, 0.0]  # the body's y axis points up
    run = falling(axial, Drag(body_quadratic=(9.0, 0.04, 9.0)), 1.0, quaternion=lying)
    terminal = np.sqrt(0.01 * 9.80665 / 0.04)
    np.testing.assert_allclose(
        run.states[:, 5], -terminal * np.tanh(9.80665 / terminal * run.time), atol=1e-8
    )
    assert np.abs(run.states[:, [3, 4]]).max() < 1e-12


def test_linear_drag_falls_towards_its_terminal_speed(axial):
    """The body's y axis points up: only its second coefficient, and the map's third, slow the fall."""
    lying = [np.cos(np.pi / 4), np.sin(np.pi / 4), 0.0, 0.0]
    for drag, resistance in (
        (Drag(body_linear=(9.0, 0.05, 7.0)), 0.05),
        (Drag(linear=(9.0, 0.05, 7.0)), 7.0),
        (Drag(linear=(0.0, 0.0, 0.02), body_linear=(0.0, 0.03, 0.0)), 0.05),
    ):
        run = falling(axial, drag, 1.0, quaternion=lying)
        terminal = 0.01 * 9.80665 / resistance
        exact = -terminal * (1 - np.exp(-resistance / 0.01 * run.time))
        np.testing.assert_allclose(run.states[:, 5], exact, atol=3e-3 * terminal if resistance > 1 else 1e-8)
        assert np.abs(run.states[:, [3, 4]]).max() < 1e-9


def test_drag_of_turning_slows_a_spin(axial):
    run = falling(axial, Drag(turning=(0.0, 0.0, 3e-6)), 1.0, angular_velocity=[0.0, 0.0, 7.0])
    np.testing.assert_allclose(run.states[:, 12], 7.0 * np.exp(-3.0 * run.time), atol=1e-9)


@pytest.mark.parametrize(("order", "power"), [("second", 2), ("fourth", 4)])
def test_losses_do_not_spoil_the_order(axial, order, power):
    body = RigidBody(0.02, axial.inertia, axial.dipole(-1.0))
    drag = Drag(linear=(0.3, 0.2, 0.1), body_quadratic=(2.0, 1.0, 3.0), turning=(1e-4, 2e-4, 3e-5))
    plate = Plate(SIGMA, 0.01, (0.0, 0.0, -0.02))
    start = state_of([1e-3, 0, 0], [0.05, 0.0, 0.02], [0.98, 0.2, 0, 0], [5.0, 0.0, 50.0])
    ends = [
        move(axial.floating(), body, start, 0.1, h, order=order, drag=drag, plate=plate).states[-1]
        for h in (1e-3, 5e-4, 2.5e-4, 1.25e-4)
    ]
    changes = [np.abs(a - b).max() for a, b in pairwise(ends)]
    np.testing.assert_allclose(np.log2(np.array(changes[:-1]) / changes[1:]), power, atol=0.4)


@pytest.mark.parametrize("restitution", [0.3, 0.8])
def test_a_bounce_has_the_restitution_that_was_asked_for(axial, restitution):
    body = RigidBody(0.01, [1e-6] * 3, axial.dipole(0.0), skin=[[0, 0, -2e-3]], gravity=0.0)
    still = axial.map((0.01, 0.0, 0.0)).at([1.0])
    walls = Walls(floor=-0.01, restitution=restitution)
    start = state_of([0, 0, 0], [0.0, 0.0, -0.5])
    run = move(still, body, start, 0.06, 1e-5, walls=walls)
    assert run.touched
    # The wall does not pull, so the body leaves the spring-damper a little earlier than half a period.
    assert abs(run.states[-1, 5] - 0.5 * restitution) < 0.08
    assert run.states[:, 2].min() > -0.011


def test_friction_slows_a_body_that_slides_on_a_floor(axial):
    body = RigidBody(0.01, [1e-3] * 3, axial.dipole(0.0), skin=[[0, 0, 0]])
    still = axial.map((0.01, 0.0, 0.0)).at([1.0])
    walls = Walls(floor=0.0, restitution=0.05, friction=0.2)
    depth = 0.01 * 9.80665 / walls.numbers(0.01)[0]
    run = move(still, body, state_of([0, 0, -depth], [0.1, 0, 0]), 0.04, 1e-5, walls=walls)
    np.testing.assert_allclose(run.states[-1, 3], 0.1 - 0.2 * 9.80665 * 0.04, rtol=1e-3)


def test_a_tube_keeps_a_body_and_a_ceiling_too(axial):
    body = RigidBody(0.01, [1e-6] * 3, axial.dipole(0.0), skin=[[0, 0, 0]], gravity=0.0)
    still = axial.map((0.01, 0.0, 0.0)).at([1.0])
    walls = Walls(ceiling=0.012, radius=0.008, restitution=0.9, friction=0.0)
    run = move(still, body, state_of([0, 0, 0], [0.3, 0.2, 0.25]), 0.5, 1e-5, walls=walls)
    assert run.touched
    assert np.hypot(run.states[:, 0], run.states[:, 1]).max() < 0.0092
    assert run.states[:, 2].max() < 0.0132
    assert run.states[-1, 5] < 0.0


# ---- eddy currents -----------------------------------------------------------------------------------------


def rayleigh(plate, place, m, v, spin):
    """Force and torque of a plate on a dipole, from the kernel."""
    rate = np.cross(spin, m)
    force, turning = plate_force(plate.numbers, *(np.array(a, float) for a in (place, m, v, rate)))
    return np.concatenate([force, np.cross(m, turning)])


def loss_in_layer(m, v, rate, height):
    """Dissipated power per conductance in a thin layer, W ohm, by quadrature of |E|^2 over the plane.

    A charge above a plane has the normal flux density del^2 W with W = (mu0 / 4 pi) ln(R + z), so E is tangential and
    free of sources, E = -z x grad dW/dt. A dipole's W is (m . d/dsource) W. Derivatives by central differences.
    """
    eps = 2e-3 * height
    # Polar grid: Gauss points mapped rationally to the radius, equidistant angles.
    t, wt = np.polynomial.legendre.leggauss(60)
    t, wt = 0.5 * (t + 1), 0.5 * wt
    r, wr = height * t / (1 - t), height * wt / (1 - t) ** 2
    angle = 2 * np.pi * np.arange(24) / 24
    x, y = np.outer(r, np.cos(angle)), np.outer(r, np.sin(angle))

    def w(s):
        """W for the source displaced by s (3,)."""
        dx, dy, dz = x - s[0], y - s[1], height + s[2]
        return MU0 / (4 * np.pi) * np.log(np.sqrt(dx**2 + dy**2 + dz**2) + dz)

    def along(f, d):
        length = np.linalg.norm(d)
        step = eps * d / length
        return lambda s: length * (f(s + step) - f(s - step)) / (2 * eps)

    def changes(s):
        """dW/dt."""
        return along(along(w, m), v)(s) + along(w, rate)(s)

    total = 0.0
    for axis in np.eye(3)[:2]:
        total = total + along(changes, axis)(np.zeros(3)) ** 2
    return float((total * (wr * r)[:, None]).sum() * 2 * np.pi / 24)


@pytest.mark.parametrize("seed", range(4))
def test_what_the_plate_takes_is_what_it_heats(seed):
    """-F . v - T . spin against the loss by quadrature of the field in the plane; random moment, velocity, spin."""
    rng = np.random.default_rng(seed)
    m, v, spin = rng.normal(size=3), rng.normal(size=3), rng.normal(size=3) / HEIGHT
    thin = Plate(SIGMA, 1e-6 * HEIGHT, (0, 0, 0))
    load = rayleigh(thin, (0, 0, HEIGHT), m, v, spin)
    heat = SIGMA * thin.thickness * loss_in_layer(m, v, np.cross(spin, m), HEIGHT)
    np.testing.assert_allclose(-load[:3] @ v - load[3:] @ spin, heat, rtol=2e-4)


def damping_matrix(plate, place, m):
    return np.array([-rayleigh(plate, place, m, *np.split(e, 2)) for e in np.eye(6)]).T


@pytest.mark.parametrize("seed", range(3))
def test_damping_is_symmetric_and_takes_energy(seed):
    """Onsager: the damping matrix of velocity and spin is symmetric; it has no negative eigenvalue."""
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=3)
    plate = Plate(SIGMA, 0.01, tuple(-0.02 * normal / np.linalg.norm(normal)), tuple(normal))
    matrix = damping_matrix(plate, (0, 0, 0), rng.normal(size=3))
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-12 * np.abs(matrix).max())
    assert np.linalg.eigvalsh(matrix).min() > -1e-12 * np.abs(matrix).max()


def test_thin_sheet_is_the_slow_limit_of_reitz():
    """Drag w/v lift, lift 3 mu0 m^2 / (32 pi h^4) (1 - w / sqrt(v^2 + w^2)): Reitz, J. Appl. Phys. 41, 2067 (1970)."""
    sheet = Plate(SIGMA, 1e-6, (0, 0, 0))
    w, v = sheet.critical_speed, 1e-3
    lift = 3 * MU0 * MOMENT**2 / (32 * np.pi * HEIGHT**4) * (v / w) ** 2 / 2
    drag = w / v * lift
    damping = sheet.damping((0, 0, HEIGHT), (0, 0, MOMENT))
    np.testing.assert_allclose(damping[0, 0] * v, drag, rtol=1e-3)


def test_an_upright_dipole_is_damped_twice_as_much_upward_as_sideways():
    for thickness in (1e-4, 0.01, np.inf):
        plate = Plate(SIGMA, thickness, (0, 0, 0))
        found = plate.damping((0.1, 0, HEIGHT), (0, 0, MOMENT))
        np.testing.assert_allclose(found, np.diag([0.5, 0.5, 1.0]) * found[2, 2], atol=1e-15)


def test_a_half_space_goes_with_the_inverse_cube_and_a_sheet_with_the_fourth_power():
    """mu0^2 m^2 sigma / (128 pi h^3) for a half space, from the sheet's integrated over the depth."""
    half = Plate(SIGMA, np.inf, (0, 0, 0))
    sheet = Plate(SIGMA, 1e-7, (0, 0, 0))
    one, two = (
        [plate.damping((0, 0, h), (0, 0, MOMENT))[0, 0] for h in (HEIGHT, 2 * HEIGHT)]
        for plate in (half, sheet)
    )
    np.testing.assert_allclose(one[0], MU0**2 * MOMENT**2 * SIGMA / (128 * np.pi * HEIGHT**3), rtol=1e-12)
    np.testing.assert_allclose([one[0] / one[1], two[0] / two[1]], [8.0, 16.0], rtol=1e-4)


def test_layers_add_up():
    whole = Plate(SIGMA, 0.03, (0, 0, 0)).damping((0, 0, HEIGHT), (0.3, -0.2, MOMENT))
    parts = [
        Plate(SIGMA, 0.01, (0, 0, -d)).damping((0, 0, HEIGHT), (0.3, -0.2, MOMENT)) for d in (0, 0.01, 0.02)
    ]
    np.testing.assert_allclose(sum(parts), whole, rtol=1e-12)


def test_a_falling_magnet_ends_at_the_speed_that_the_plate_allows(axial):
    """m g / damping, in a uniform field above a very good conductor, which makes the fall slow."""
    body = RigidBody(0.01, [1e-5] * 3, axial.dipole(MOMENT))
    uniform = axial.map((0.05, 0.0, 0.0), half=0.05).at([1.0])
    plate = Plate(3.5e11, np.inf, (0, 0, -0.06))
    damping = plate.damping((0, 0, 0), (0, 0, MOMENT))[2, 2]
    run = move(uniform, body, state_of([0, 0, 0]), 0.02, 1e-5, plate=plate)
    np.testing.assert_allclose(run.states[-1, 5], -0.01 * 9.80665 / damping, rtol=0.02)


def test_a_place_behind_the_face_is_named():
    with refused(InputError, where="Plate.damping(position)"):
        Plate(SIGMA, 0.01, (0, 0, 0)).damping((0, 0, -0.01), (0, 0, 1.0))
