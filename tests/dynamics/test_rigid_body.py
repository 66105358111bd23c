"""The motion of a rigid magnet in a constant field, against closed forms and an adaptive integrator."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ellipj

from fieldmap.device.model import Payload
from fieldmap.device.payload import MagnetBlock, MagnetSphere
from fieldmap.dynamics import (
    RigidBody,
    angular_momentum,
    body_of_payload,
    energy,
    move,
    move_adaptively,
    state_of,
)
from fieldmap.errors import InputError
from tests.refusals import refused

UNLIKE = np.array([1.0e-6, 1.7e-6, 2.2e-6])


def free_spin(inertia, start, times):
    """Angular velocity (n, 3) of a free rotor I1 < I2 < I3 with L^2 > 2 E I2 and start[1] = 0: Landau, Lifshitz,
    Mechanics, section 37, (37.8)..(37.11)."""
    a, b, c = inertia
    twice = float(inertia @ start**2)
    square = float((inertia * start) @ (inertia * start))
    assert square > twice * b
    assert start[1] == 0.0
    rate = np.sqrt((c - b) * (square - twice * a) / (a * b * c))
    m = (b - a) * (twice * c - square) / ((c - b) * (square - twice * a))
    sn, cn, dn, _ = ellipj(rate * times, m)
    return np.column_stack(
        [
            np.sqrt((twice * c - square) / (a * (c - a))) * cn,
            np.sqrt((twice * c - square) / (b * (c - b))) * sn,
            np.sqrt((square - twice * a) / (c * (c - a))) * dn,
        ]
    )


def spinning(axial, inertia, spin, duration, step, order):
    """A free body: uniform field, neither moment nor weight."""
    body = RigidBody(0.01, inertia, axial.dipole(0.0), gravity=0.0)
    still = axial.map((0.01, 0.0, 0.0)).at([1.0])
    return body, move(still, body, state_of([0, 0, 0], angular_velocity=spin), duration, step, order=order)


@pytest.mark.parametrize(("order", "power"), [("second", 2), ("fourth", 4)])
def test_a_free_rotor_follows_jacobis_functions_at_the_order_of_the_step(axial, order, power):
    start = np.array([20.0, 0.0, 30.0])
    errors = []
    for step in (4e-3, 2e-3, 1e-3):
        _, run = spinning(axial, UNLIKE, start, 1.0, step, order)
        exact = free_spin(UNLIKE, start, run.time)
        errors.append(np.abs(run.states[:, 10:] - exact).max() / 30.0)
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(slopes, power, atol=0.15)
    assert errors[-1] < {2: 2e-3, 4: 2e-5}[power]


def test_a_free_rotor_keeps_its_angular_momentum_in_space_and_its_energy(axial):
    body, run = spinning(axial, UNLIKE, [5.0, 40.0, 3.0], 10.0, 1e-3, "second")
    momentum = angular_momentum(body, run.states)
    np.testing.assert_allclose(momentum, np.broadcast_to(momentum[0], momentum.shape), atol=1e-12 * 6.8e-5)
    kinetic = 0.5 * run.states[:, 10:] ** 2 @ UNLIKE
    # The integrator is symplectic: its error of the energy oscillates, and does not grow.
    first, last = kinetic[: len(kinetic) // 4], kinetic[-len(kinetic) // 4 :]
    assert np.ptp(kinetic) < 1e-3 * kinetic[0]
    assert abs(first.mean() - last.mean()) < 0.02 * np.ptp(kinetic)


def test_an_axisymmetric_body_is_exact_at_any_step(axial):
    """The axis precesses about L at |L| / I1; two steps of 0.5 s against a thousand steps of 1 ms."""
    inertia = [1.2e-6, 1.2e-6, 2.25e-6]
    _, coarse = spinning(axial, inertia, [3.0, 1.0, 20.0], 1.0, 0.5, "second")
    _, fine = spinning(axial, inertia, [3.0, 1.0, 20.0], 1.0, 1e-3, "second")
    np.testing.assert_allclose(coarse.states[-1], fine.states[-1], atol=1e-11)
    axis = fine.states[:, 6:10]
    lean = 1 - 2 * (axis[:, 1] ** 2 + axis[:, 2] ** 2)
    momentum = np.array([3.6e-6, 1.2e-6, 45e-6])
    period = 2 * np.pi / (np.linalg.norm(momentum) / 1.2e-6)
    at = round(period / 1e-3)
    assert abs(lean[at] - 1.0) < 1e-4 < 1.0 - lean.min()


@pytest.mark.parametrize("half_angle", [1e-9, 1e-3, 0.02, 0.0499, 0.0501, 0.3, 2.0])
def test_a_turn_about_the_axis_has_the_sine_and_cosine_of_half_its_angle(axial, half_angle):
    """Below 0.05 the core uses power series."""
    _, run = spinning(axial, [1e-6, 1e-6, 1e-6], [0.0, 0.0, 2.0 * half_angle], 1.0, 1.0, "second")
    expected = [np.cos(half_angle), 0.0, 0.0, np.sin(half_angle)]
    np.testing.assert_allclose(run.states[-1, 6:10], expected, rtol=0, atol=4e-16)


def tilted(angle):
    return [np.cos(angle / 2), np.sin(angle / 2), 0.0, 0.0]


def test_a_spinning_top_floats_and_keeps_its_energy_for_ten_seconds(axial, top):
    """Spin stabilises a magnet opposite to the field (the levitron): ten seconds of bounded motion without losses."""
    start = state_of([1e-3, -5e-4, 1e-3], quaternion=tilted(0.05), angular_velocity=[0.0, 0.0, 200.0])
    run = move(axial.floating(), top, start, 10.0, 1e-4, order="fourth", every=20)
    assert run.inside
    assert np.linalg.norm(run.states[:, :3], axis=1).max() < 4e-3
    total = energy(axial.floating(), top, run.states)
    assert np.ptp(total) < 1e-9 * abs(total[0])
    # Also relative to the energy exchanged between its forms, which is far less than the spin's.
    weight = top.mass * top.gravity * run.states[:, 2]
    assert np.ptp(total) < 1e-8 * np.ptp(weight)


@pytest.mark.parametrize(("order", "power"), [("second", 2), ("fourth", 4)])
def test_order_and_agreement_with_an_adaptive_integrator(axial, order, power):
    body = RigidBody(0.02, UNLIKE, axial.dipole(-1.0), magnet_at=[1e-3, 0.0, 2e-3])
    start = state_of([1e-3, 0.0, 5e-4], [0.0, 0.01, 0.0], tilted(0.3), [5.0, -10.0, 200.0])
    field = axial.floating()
    exact = move_adaptively(field, body, start, np.linspace(0, 0.1, 11))
    errors = []
    for step in (2e-4, 1e-4, 5e-5):
        run = move(field, body, start, 0.1, step, order=order, every=round(0.01 / step))
        errors.append(np.abs((run.states - exact) / np.ptp(exact, axis=0)).max())
    np.testing.assert_allclose(np.log2(np.array(errors[:-1]) / errors[1:]), power, atol=0.2)
    assert errors[-1] < {2: 2e-3, 4: 1e-6}[power]


@pytest.mark.parametrize("moment", [1.0, -1.0])
@pytest.mark.parametrize("curvature", [-2.0, -0.5, 0.0, 0.5, 2.0])
def test_without_spin_and_control_every_equilibrium_escapes(axial, moment, curvature):
    """Earnshaw: at rest on the axis force and torque balance; from 10 um off the axis the magnet moves away."""
    slope = axial.mass * 9.80665 / moment
    field = axial.map((0.02, slope, curvature)).at([1.0])
    body = RigidBody(axial.mass, axial.inertia, axial.dipole(moment))
    still = move(field, body, state_of([0, 0, 0]), 0.05)
    np.testing.assert_allclose(still.states[-1, :6], 0.0, atol=1e-11)
    moved = move(field, body, state_of([1e-5, 0, 1e-5], quaternion=tilted(1e-4)), 8.0, 2e-4)
    away = np.linalg.norm(moved.states[:, :3], axis=1).max()
    assert away > 5e-3 or not moved.inside


def test_a_payload_makes_a_body():
    from fieldmap.device import read_device

    payload = replace(read_device("drive_unit").payload, direction="down")
    body = body_of_payload(payload, radius=5e-3, height=0.02, centre_of_mass=2e-3)
    m = payload.mass
    np.testing.assert_allclose(body.inertia, [m * (25e-6 / 4 + 4e-4 / 12)] * 2 + [m * 25e-6 / 2], rtol=1e-12)
    np.testing.assert_allclose(body.magnet_at, [0, 0, -2e-3])
    np.testing.assert_allclose(body.seen_at, [0, 0, 13e-3])
    assert body.magnet.moments[0, 2] == -payload.moment
    assert not body.upright
    assert "moment down, free to turn" in body.assumptions
    assert body_of_payload(replace(payload, turning="fixed")).upright
    np.testing.assert_allclose(np.unique(body.skin[:, 2].round(9)), [-7e-3, 13e-3])
    assert any("inertia" in words and "10 x 20 mm" in words for words in body.assumptions)


def _points_of_a_ball(number: int) -> np.ndarray:
    """Points spread evenly in a ball of radius 1."""
    rng = np.random.default_rng(1)
    points = rng.uniform(-1, 1, (number, 3))
    return points[(points**2).sum(axis=1) <= 1]


@pytest.mark.parametrize(
    ("magnet", "points"),
    [
        (MagnetSphere(0.02, 1.3), lambda n: 0.01 * _points_of_a_ball(n)),
        (
            MagnetBlock((0.01, 0.02, 0.03), 1.3),
            lambda n: np.random.default_rng(2).uniform(-0.5, 0.5, (n, 3)) * [0.01, 0.02, 0.03],
        ),
    ],
)
def test_inertia_follows_from_a_ball_and_a_block(magnet, points):
    """Against second moments of points spread evenly in the shape."""
    body = body_of_payload(Payload(0.05, magnet=magnet))
    squares = (points(400_000) ** 2).mean(axis=0)
    np.testing.assert_allclose(body.inertia, 0.05 * (squares.sum() - squares), rtol=5e-3)
    assert any("inertia" in note for note in body.assumptions)
    size = [0.02] * 3 if isinstance(magnet, MagnetSphere) else magnet.size
    np.testing.assert_allclose(np.ptp(body.skin, axis=0), size, rtol=1e-12)


def test_a_given_inertia_counts_and_a_dipole_has_none():
    given = (3e-7, 3e-7, 2e-7)
    body = body_of_payload(Payload(0.05, magnet=MagnetSphere(0.02, 1.3), inertia=given))
    assert body.inertia.tolist() == list(given)
    with refused(InputError, remedy="payload.inertia"):
        body_of_payload(Payload(0.05, moment=0.8))


@pytest.mark.parametrize(
    ("inertia", "words"),
    [([1e-6, 1e-6, 3e-6], "I1"), ([0.0, 1e-6, 1e-6], "above 0"), ([1e-6, 1e-6], "3 numbers")],
)
def test_a_body_that_cannot_be_is_named(axial, inertia, words):
    with pytest.raises(InputError, match=words):
        RigidBody(0.01, inertia, axial.dipole(1.0))


def test_a_flat_body_is_one_to_rounding(axial):
    """The largest moment of inertia of a plate is the sum of the other two."""
    flat = np.array([0.1e-6, 0.2e-6, (0.1e-6 + 0.2e-6) * (1.0 + 5e-10)])
    assert RigidBody(0.01, flat, axial.dipole(1.0)).inertia.tolist() == flat.tolist()
    with pytest.raises(InputError):
        RigidBody(0.01, flat * [1.0, 1.0, 1.0 + 2e-9], axial.dipole(1.0))
