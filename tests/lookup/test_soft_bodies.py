"""Soft spheres and ellipsoids, several pieces in one body, currents for them: against closed forms and differences."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.constants
from scipy.integrate import quad
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation

import fieldmap as fm
from fieldmap.device.payload import (
    MagnetCylinder,
    MagnetSphere,
    Payload,
    PayloadPiece,
    SoftEllipsoid,
    SoftSphere,
)
from fieldmap.errors import Infeasible, InputError, NotConverged
from fieldmap.field import CompletedField, Field
from fieldmap.kernels.coils.loop import loop_flux_density_and_gradient
from fieldmap.lookup import (
    compiled_wrench,
    demagnetising_factors,
    interpolate,
    magnetic_body,
    soft_sphere_force,
    volume_rule,
    wrench_actuation,
)
from fieldmap.lookup.inverse_problem import Goal
from fieldmap.lookup.soft_body import knots_of
from fieldmap.store import Grid, MapData
from tests.lookup.conftest import Loops

MU0 = scipy.constants.mu_0
STEEL = fm.material("steel_a3")
IRON = fm.Froehlich("iron", mu_r=1000.0, saturation=2.0)
NONE = np.zeros(0)


class Gradient(Field):
    """B0 + G x: uniform gradient."""

    coil_names = ()

    def __init__(self, flux, slope):
        self.flux, self.slope = np.array(flux, float), np.array(slope, float)

    def field(self, points, currents):
        return self.flux + np.atleast_2d(points) @ self.slope.T

    def gradient(self, points, currents):
        return np.broadcast_to(self.slope, (len(np.atleast_2d(points)), 3, 3))


SLOPE = np.array([[0.3, 0.5, -0.2], [0.5, -0.9, 0.7], [-0.2, 0.7, 0.6]])
FLUX = np.array([0.02, -0.05, 0.08])


TURN = Rotation.from_rotvec([0.4, -0.7, 0.3]).as_matrix()


def wrench(shape, flux=FLUX, slope=SLOPE, at=(0.0, 0.0, 0.0), turn=TURN):
    return Gradient(flux, slope).wrench(np.array(at), magnetic_body(shape), NONE, turn)


def moment(shape, flux, turn=None):
    return magnetic_body(shape).induced_moment(Gradient(flux, SLOPE), np.zeros(3), NONE, turn)[0]


@pytest.mark.parametrize("mu_r", [1.5, 30.0, 1e9, np.inf])
def test_a_sphere_in_a_uniform_gradient(mu_r):
    # m = 3 V / mu0 (mu_r - 1) / (mu_r + 2) B, F = m grad B: Jackson, Classical Electrodynamics (1999), (5.115).
    sphere, at = SoftSphere(4e-3, mu_r=mu_r), np.array([0.01, 0.02, -0.01])
    share = 1.0 if np.isinf(mu_r) else (mu_r - 1) / (mu_r + 2)
    exact = 3 * sphere.volume / MU0 * share * (FLUX + SLOPE @ at)
    found = wrench(sphere, at=at)
    np.testing.assert_allclose(found[:3], SLOPE.T @ exact, rtol=1e-12)
    np.testing.assert_allclose(found[3:], 0, atol=1e-15 * np.linalg.norm(exact))


def test_a_saturated_sphere_has_the_moment_of_its_saturation():
    sphere = SoftSphere(4e-3, IRON)
    strong = 1e3 * FLUX
    np.testing.assert_allclose(np.linalg.norm(moment(sphere, strong)), sphere.volume * 2.0 / MU0, rtol=3e-5)
    # At each field the law holds: h = b0 - J / 3.
    for size in (1e-4, 0.1, 0.5, 0.66, 0.7, 1.0, 3.0):
        b0 = size * np.array([0.6, 0.0, 0.8])
        j = np.linalg.norm(moment(sphere, b0)) * MU0 / sphere.volume
        h = size - j / 3
        law = 999 * h / (1 + 999 * h / 2.0)
        # The law has 240 knots for ten decades.
        assert j == pytest.approx(law, rel=2e-5)


@pytest.mark.parametrize(
    ("axes", "factors"),
    [
        ((1.0, 1.0, 1.0), (1 / 3, 1 / 3, 1 / 3)),
        # Osborn (1945), prolate and oblate spheroids of ratio m: (2.5), (2.9).
        (
            (1.0, 1.0, 5.0),
            (None, None, 1 / 24 * (5 / (2 * np.sqrt(24)) * np.log((5 + 24**0.5) / (5 - 24**0.5)) - 1)),
        ),
        ((5.0, 5.0, 1.0), (None, None, 25 / 24 * (1 - np.arcsin(np.sqrt(24) / 5) / np.sqrt(24)))),
        ((1.0, 1.0, 1e6), (0.5, 0.5, 0.0)),
        ((1e6, 1e6, 1.0), (0.0, 0.0, 1.0)),
    ],
)
def test_demagnetising_factors_of_spheroids(axes, factors):
    found = demagnetising_factors(axes)
    assert found.sum() == pytest.approx(1.0, abs=1e-14)
    for value, exact in zip(found, factors, strict=True):
        if exact is not None:
            assert value == pytest.approx(exact, abs=3e-6 if 1e6 in axes else 1e-13)


def test_demagnetising_factors_of_three_axes():
    a = np.array([1.0, 1.7, 3.1])
    found = demagnetising_factors(2 * a)
    for k in range(3):

        def shape(s, k=k):
            return 1 / ((s + a[k] ** 2) * np.sqrt(np.prod(s + a**2)))

        assert found[k] == pytest.approx(a.prod() / 2 * quad(shape, 0, np.inf, epsabs=1e-13)[0], rel=1e-8)
    for wrong in ([1.0, 0.0, 1.0], [1.0, -1.0, 1.0], [1.0, np.inf, 1.0], [np.nan, 1.0, 1.0], [1.0, 1.0]):
        with pytest.raises(InputError) as caught:
            demagnetising_factors(wrong)
        assert caught.value.problems[0].where == "demagnetising_factors(axes)"
    # Equal axes need no integral; its three values would differ by rounding.
    assert demagnetising_factors([2.0, 2.0, 2.0]).tolist() == [1.0 / 3.0] * 3


def test_torque_of_a_prolate_ellipsoid():
    # T = V / mu0 (N_x - N_z) chi^2 B^2 sin(2 angle) / 2 / ((1 + N_x chi) (1 + N_z chi)).
    body, angle, size, chi = SoftEllipsoid((2e-3, 2e-3, 8e-3), mu_r=50.0), 0.4, 0.03, 49.0
    n = demagnetising_factors(body.size)
    flux = size * np.array([np.sin(angle), 0.0, np.cos(angle)])
    found = wrench(body, flux, np.zeros((3, 3)), turn=None)
    exact = body.volume / MU0 * (n[0] - n[2]) * chi**2 * size**2 * np.sin(2 * angle) / 2
    exact /= (1 + n[0] * chi) * (1 + n[2] * chi)
    # The long axis turns towards the field: about +y.
    assert found[4] == pytest.approx(exact, rel=1e-12)
    np.testing.assert_allclose(found[[0, 1, 2, 3, 5]], 0, atol=1e-15)


@pytest.mark.parametrize("size", [1e-3, 0.3, 0.8, 3.0])
def test_ellipsoids_of_a_law_fulfil_its_equations(size):
    body = SoftEllipsoid((2e-3, 3e-3, 7e-3), STEEL)
    n, points = demagnetising_factors(body.size), STEEL.points()
    b0 = size * np.array([0.5, -0.6, 0.7])
    j = moment(body, b0) * MU0 / body.volume
    h = b0 - n * j
    np.testing.assert_allclose(np.cross(h, j), 0, atol=1e-9 * np.linalg.norm(j) * size)
    if np.linalg.norm(h) > points.field[-1]:
        assert np.linalg.norm(j) == pytest.approx(points.polarisation[-1], rel=1e-12)
    else:
        exact = np.interp(np.linalg.norm(h), points.field, points.polarisation)
        assert np.linalg.norm(j) == pytest.approx(exact, rel=2e-2)


def test_knots_of_a_law_have_the_integral_of_its_cubics():
    """The integral of J dh from 0, against scipy's cubics, for arbitrary knots and slopes."""
    h, j, slope = (
        np.array([0.0, 0.3, 1.0, 2.5]),
        np.array([0.0, 1.2, 1.7, 1.9]),
        np.array([5.0, 2.0, 0.4, 0.1]),
    )
    points = SimpleNamespace(field=h, polarisation=j, slope=slope)
    found = knots_of(SimpleNamespace(points=lambda: points))
    law = CubicHermiteSpline(h, j, slope)
    exact = h, j, slope, [law.integrate(0.0, end) for end in h]
    for ours, theirs in zip(found, exact, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-12)


PAIR = Payload(
    mass=0.01,
    pieces=[
        PayloadPiece(SoftSphere(4e-3, STEEL), fm.placed([0.0, 0.0, 6e-3])),
        PayloadPiece(SoftEllipsoid((2e-3, 3e-3, 6e-3), IRON), fm.placed([4e-3, 0.0, 0.0], [20.0, 30.0, 0.0])),
        PayloadPiece(MagnetSphere(3e-3, 1.2), fm.placed([0.0, -5e-3, 0.0], [90.0, 0.0, 0.0])),
    ],
)
AT, AMPERES = np.array([0.003, 0.002, -0.004]), np.array([1.0, -0.7, 0.4])
LOOPS = [(0.016, [0.02, 0.0, 0.03]), (0.025, [-0.02, 0.01, 0.035]), (0.02, [0.0, -0.02, -0.04])]


@pytest.mark.parametrize("turns", [300.0, 3e3, 2e4])
def test_wrench_is_the_slope_of_the_energy_by_place_and_by_turn(turns):
    field, body = Loops(LOOPS, turns), magnetic_body(PAIR)
    at, currents = AT, AMPERES
    found = body.wrench(field, at, currents, TURN)
    size = [np.linalg.norm(found[:3]), np.linalg.norm(found[3:])]
    for j in range(3):
        unit = np.eye(3)[j]
        moved = [body.energy(field, at + s * 1e-5 * unit, currents, TURN) for s in (-1, 1)]
        assert (moved[0] - moved[1]) / 2e-5 == pytest.approx(found[j], abs=2e-5 * size[0])
        spun = [
            body.energy(field, at, currents, Rotation.from_rotvec(s * 1e-4 * unit).as_matrix() @ TURN)
            for s in (-1, 1)
        ]
        assert (spun[0] - spun[1]) / 2e-4 == pytest.approx(found[3 + j], abs=2e-5 * size[1])


def test_a_body_is_the_sum_of_its_pieces_with_their_arms():
    field, at, currents = Loops(LOOPS, 3e3), AT, AMPERES
    together = magnetic_body(PAIR).wrench(field, at, currents, TURN)
    apart = np.zeros(6)
    for piece in PAIR.pieces:
        arm = TURN @ piece.placement.position
        load = magnetic_body(piece.shape).wrench(field, at + arm, currents, TURN @ piece.placement.rotation)
        apart += np.concatenate([load[:3], load[3:] + np.cross(arm, load[:3])])
    np.testing.assert_allclose(together, apart, rtol=1e-10, atol=1e-15)


def test_slopes_by_the_currents_pass_a_taylor_test():
    field, body = Loops(LOOPS, 3e3), magnetic_body(PAIR)
    at, currents, along = AT, AMPERES, np.array([0.3, 1.0, -0.6])
    about = wrench_actuation(field, at, body, currents, TURN)
    here = body.wrench(field, at, currents, TURN)
    np.testing.assert_allclose(about.matrix @ currents + about.constant, here, rtol=1e-12)
    # A law of cubics is smooth to its second derivative except at knots; the steps stay between two knots.
    steps = np.array([1e-2, 3e-3, 1e-3])
    off = [
        np.linalg.norm(body.wrench(field, at, currents + s * along, TURN) - here - s * about.matrix @ along)
        for s in steps
    ]
    assert np.polyfit(np.log(steps), np.log(off), 1)[0] == pytest.approx(2.0, abs=0.1)


def test_rules_for_the_magnets_among_pieces(opened):
    pieces = [
        SoftSphere(3e-3, STEEL),
        PayloadPiece(MagnetCylinder(4e-3, 5e-3, 1.2), fm.placed([0.0, 0.0, 2e-3])),
    ]
    payload, at, currents = (
        Payload(2e-3, pieces=pieces),
        np.array([0.001, 0.0, -0.002]),
        np.linspace(-3.0, 4.0, 8),
    )
    exact = magnetic_body(payload, level=5).wrench(opened, at, currents)
    chosen = magnetic_body(payload, field=opened.at(currents), tolerance=1e-3)
    assert chosen.error < 1e-3
    assert 1 < len(chosen.points) < len(magnetic_body(payload, level=5).points)
    np.testing.assert_allclose(
        chosen.wrench(opened, at, currents)[:3], exact[:3], atol=2e-3 * np.linalg.norm(exact[:3])
    )


def test_stiffness_is_the_slope_of_the_force():
    field, body = Loops(LOOPS, 3e3), magnetic_body(PAIR)
    at, currents = AT, AMPERES
    stiffness = body.stiffness(field, at, currents, TURN)
    steps = 1e-5 * np.eye(3)
    ahead, behind = (body.wrench(field, at + s * steps, currents, TURN)[:, :3] for s in (1, -1))
    exact = -(ahead - behind).T / 2e-5
    np.testing.assert_allclose(stiffness, exact, atol=1e-4 * np.abs(exact).max())


# One dipole leaves out the response to the gradient, six dipoles the response to the second gradient.
@pytest.mark.parametrize(("level", "order", "most"), [(1, 2.0, 0.02), (2, 4.0, 2e-4)])
@pytest.mark.parametrize("mu_r", [1.5, 100.0, 1e9])
def test_what_the_rule_of_a_sphere_leaves_out(level, order, most, mu_r):
    field, at, currents = CompletedField(Loops(LOOPS, 3e3)), AT[None], AMPERES
    sizes = np.array([0.5e-3, 1e-3, 2e-3, 4e-3]) * level
    off, turning = [], []
    for diameter in sizes:
        exact = soft_sphere_force(field, at, currents, diameter, mu_r)[0]
        bead = Payload(1e-3, pieces=[SoftSphere(diameter, mu_r=mu_r)], soft_level=level)
        found = magnetic_body(bead).wrench(field, at[0], currents, TURN)
        off.append(np.linalg.norm(found[:3] - exact) / np.linalg.norm(exact))
        turning.append(np.linalg.norm(found[3:]) / (diameter / 2 * np.linalg.norm(exact)))
    assert np.polyfit(np.log(sizes), np.log(off), 1)[0] == pytest.approx(order, abs=0.1)
    assert off[-1] < most * level**order
    # A sphere has no torque; six dipoles have a torque of the order that they leave out.
    assert turning[-1] < (1e-13 if level == 1 else 3e-3)


def test_the_rules_of_a_cylinder_converge():
    field, at, currents = Loops(LOOPS, 3e3), AT, AMPERES
    magnet = MagnetCylinder(0.010, 0.008, 1.3)
    exact = volume_rule(magnet, 8).wrench(field, at, currents, TURN)
    off = [
        np.linalg.norm((volume_rule(magnet, n).wrench(field, at, currents, TURN) - exact)[:3])
        / np.linalg.norm(exact[:3])
        for n in (1, 2, 3, 4)
    ]
    # Rule n misses less than (a / R)^(2 n); a: radius of the magnet, 6.4 mm; R: distance of the nearest wire, 34 mm.
    nearest = min(np.hypot(np.linalg.norm((at - c)[:2]) - r, (at - c)[2]) for r, c in LOOPS)
    gain = (np.hypot(5e-3, 4e-3) / nearest) ** 2
    assert (np.array(off) < gain ** np.arange(1, 5)).all()
    assert np.polyfit(range(4), np.log(off), 1)[0] == pytest.approx(np.log(gain), rel=0.1)


GRID = Grid([-0.012, -0.012, -0.012], [0.002, 0.002, 0.002], (13, 13, 13))


@pytest.fixture(scope="module")
def opened():
    """Eight loops around a cube, 40 mm from its middle, 1000 A turns."""
    points, flux, slope = GRID.points(), [], []
    for k in range(8):
        angle = np.pi / 2 * k + (np.pi / 4 if k >= 4 else 0.0)
        lift = 0.0 if k < 4 else -0.7
        axis = np.array([np.cos(angle), np.sin(angle), lift])
        axis /= np.linalg.norm(axis)
        side = np.cross(axis, [0.0, 0.0, 1.0])
        side /= np.linalg.norm(side)
        turn = np.column_stack([side, np.cross(axis, side), axis])
        b, g = loop_flux_density_and_gradient((points - 0.04 * axis) @ turn, 0.015)
        flux.append(1e3 * b @ turn.T)
        slope.append(1e3 * np.einsum("ij,njk,lk->nil", turn, g, turn))
    shape = (8, *GRID.shape, 3)
    names = tuple(str(k + 1) for k in range(8))
    data = MapData(
        GRID, names, np.ones(8), flux_density=np.reshape(flux, shape), gradient=np.reshape(slope, (*shape, 3))
    )
    return interpolate(data)


BEAD = SoftSphere(3e-3, STEEL)
WEIGHT = 9.81 * 7850 * BEAD.volume


def test_currents_for_a_force_on_a_bead(opened):
    bead, at = magnetic_body(BEAD), np.array([0.001, -0.002, 0.001])
    for force in ([0.0, 0.0, WEIGHT], [0.3 * WEIGHT, -0.5 * WEIGHT, 1.2 * WEIGHT], [0.0, 0.0, -WEIGHT]):
        currents = opened.currents_for(at, force=force, moment=bead)
        np.testing.assert_allclose(opened.wrench(at, bead, currents)[:3], force, atol=1e-8 * WEIGHT)
        # From a start nearby the power is only a little more, if at all.
        again = opened.currents_for(at, force=force, moment=bead, start=1.02 * currents)
        assert again @ again <= (1 + 1e-4) * (currents @ currents)
    # No direction in the null space of the slopes saves power.
    about = opened.actuation(at, currents, bead)
    slopes = about.matrix[8:11]
    _, _, right = np.linalg.svd(slopes)
    assert np.abs(right[3:] @ currents).max() < 2e-3 * np.linalg.norm(currents)


def test_least_power_of_one_axis_is_the_strongest_eigenvector(opened):
    # Linear iron, F_z only: F_z = i^T Q i, and the least power is F_z over the largest eigenvalue.
    bead, at = magnetic_body(SoftSphere(3e-3, mu_r=1e9)), np.array([0.001, -0.002, 0.001])
    flux, slope = opened.unit_field(at), opened.unit_gradient(at)
    matrix = 3 * BEAD.volume / MU0 * np.einsum("ki,ni->kn", flux, slope[:, :, 2])
    largest = np.linalg.eigvalsh(0.5 * (matrix + matrix.T))[-1]
    currents = opened.currents_for(at, force=[np.nan, np.nan, WEIGHT], moment=bead)
    assert currents @ currents == pytest.approx(WEIGHT / largest, rel=1e-5)


# One demand is met, one is not; without a bound each took 4000 evaluations of the field and more.
@pytest.mark.parametrize(
    ("at", "force", "limits", "met"),
    [
        ([-11.29e-3, 4.82e-3, -9.41e-3], [0.01623, 0.01419, 0.01818], (0, 2.0), True),
        ([4.47e-3, -7.95e-3, 8.01e-3], [0.03143, -0.05984, -0.03585], (0, 2.0), False),
    ],
)
def test_the_work_of_a_search_has_a_bound(opened, monkeypatch, at, force, limits, met):
    seen, about, asked = set(), Goal.about, 0

    def counting(goal, values):
        nonlocal asked
        asked += values.tobytes() not in seen
        seen.clear()
        seen.add(values.tobytes())
        return about(goal, values)

    monkeypatch.setattr(Goal, "about", counting)
    bead, wanted = magnetic_body(BEAD), WEIGHT * np.array(force)
    if met:
        found = opened.currents_for(at, wanted, bead, limits)
        np.testing.assert_allclose(opened.wrench(at, bead, found)[:3], wanted, atol=1e-6 * WEIGHT)
    else:
        with pytest.raises((Infeasible, NotConverged)):
            opened.currents_for(at, wanted, bead, limits)
    assert 250 < asked < 550


def test_currents_for_more_than_limits_allow(opened):
    bead = magnetic_body(BEAD)
    at, force = np.array([0.001, -0.002, 0.001]), np.array([0.0, 0.0, WEIGHT])
    free = opened.currents_for(at, force=force, moment=bead)
    limit = 0.95 * np.abs(free).max()
    held = opened.currents_for(at, force=force, moment=bead, limits=limit)
    assert np.abs(held).max() <= limit * (1 + 1e-12)
    assert held @ held > free @ free
    np.testing.assert_allclose(opened.wrench(at, bead, held)[:3], force, atol=1e-7 * WEIGHT)
    with pytest.raises(Infeasible) as caught:
        opened.currents_for(at, force=1e3 * force, moment=bead, limits=limit)
    problem = caught.value.problems[0]
    assert problem.where == "currents_for"
    # No start was given that could be moved; the error is of the search that reached most.
    assert "move start" not in problem.remedy
    assert "start=" in problem.remedy
    assert caught.value.reachable[2] > 0.5 * force[2]
    with pytest.raises(Infeasible, match="move start"):
        opened.currents_for(at, force=1e3 * force, moment=bead, limits=limit, start=held)


def test_currents_of_one_sense_for_a_bead(opened):
    """A bead is pulled by the square of the currents: reversed currents give the same force."""
    bead, at, coils = magnetic_body(BEAD), np.array([0.001, -0.002, 0.001]), len(opened.coil_names)
    force = np.array([np.nan, np.nan, 0.5 * WEIGHT])
    none, most = np.zeros(coils), np.full(coils, 50.0)
    ahead = opened.currents_for(at, force=force, moment=bead, limits=[none, most])
    behind = opened.currents_for(at, force=force, moment=bead, limits=[-most, none])
    assert ahead.min() >= 0.0 >= behind.max()
    for currents in (ahead, behind):
        assert opened.wrench(at, bead, currents)[2] == pytest.approx(force[2], rel=1e-7)
    assert behind @ behind == pytest.approx(ahead @ ahead, rel=1e-4)


def test_currents_for_magnets_in_a_body_are_those_for_their_dipole(opened):
    magnet, at = magnetic_body(MagnetSphere(3e-3, 1.2)), np.array([0.001, 0.0, -0.002])
    force, torque = [1e-3, -2e-3, 3e-3], [1e-6, 0.0, 0.0]
    dipole = magnet.moments[0] @ TURN.T
    expected = opened.currents_for(at, force, dipole, torque=[*torque[:2], np.nan])
    found = opened.currents_for(at, force, magnet, torque=[*torque[:2], np.nan], orientation=TURN)
    np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())
    plain = opened.actuation(at, expected, dipole)
    body = opened.actuation(at, expected, magnet, TURN)
    assert (body.rows, body.constant) == (plain.rows, None)
    np.testing.assert_allclose(body.matrix, plain.matrix, rtol=1e-9, atol=1e-12)


def test_a_field_of_points_takes_bodies_as_a_map_does(opened):
    bead, at = magnetic_body(PAIR), np.array([0.001, 0.0, -0.002])
    currents = np.linspace(-3.0, 4.0, 8)
    whole = opened.wrench(at, bead, currents, TURN)
    np.testing.assert_array_equal(opened.at(currents).wrench(at, bead, TURN), whole)
    np.testing.assert_allclose(opened.wrench(at[None, None], bead, currents, TURN), whole[None, None])
    with pytest.raises(InputError) as caught:
        opened.wrench(at, [0.0, 0.0, 1.0], currents, TURN)
    assert caught.value.problems[0].where == "wrench, orientations"


def test_moments_and_energies_of_places_are_those_of_each(opened):
    """Two soft pieces and a magnet, with one row of currents for all places or a row for each."""
    body, amperes = magnetic_body(PAIR), np.linspace(-3.0, 4.0, 8)
    places, turns = 1e-3 * np.array([[1.0, 0.5, -2.5], [-0.5, 1.0, 0.0]]), np.stack([TURN, TURN.T])
    for currents in (amperes, np.array([amperes, 0.5 * amperes])):
        rows = np.broadcast_to(currents, (2, 8))
        for ask, shape in (
            (body.energy, ()),
            (body.induced_moment, (2, 3)),
            (body.whole_moment, (3,)),
            (body.wrench, (6,)),
        ):
            together = ask(opened, places, currents, turns)
            apart = [ask(opened, *one) for one in zip(places, rows, turns, strict=True)]
            assert together.shape == (2, *shape)
            assert [np.shape(one) for one in apart] == [shape, shape]
            np.testing.assert_allclose(together, apart, rtol=1e-12, atol=1e-20)
    induced = body.induced_moment(opened, places, amperes, turns)
    own = turns @ body.moments[0]
    np.testing.assert_allclose(
        body.whole_moment(opened, places, amperes, turns), induced.sum(axis=1) + own, rtol=1e-12
    )
    assert body.count == 3
    assert body.moment == pytest.approx(1.2 / MU0 * np.pi / 6 * 27e-9)


def test_compiled_wrench_and_slopes_are_those_of_the_body(opened):
    body, at = magnetic_body(PAIR), np.array([0.001, 0.0005, -0.0025])
    currents = np.linspace(-3.0, 4.0, 8)
    function, data = compiled_wrench(opened, body)
    wrench, slopes = np.empty(6), np.empty((6, 8))
    assert function(data, currents, at, TURN, wrench, slopes)
    np.testing.assert_allclose(wrench, opened.wrench(at, body, currents, TURN), rtol=1e-10, atol=1e-16)
    about = wrench_actuation(opened, at, body, currents, TURN)
    np.testing.assert_allclose(slopes, about.matrix, rtol=1e-9, atol=1e-15)
    assert not function(data, currents, np.array([0.0, 0.0, 0.0119]), TURN, wrench, slopes)
    assert np.isnan(wrench).all()


def test_bad_bodies_are_refused():
    for wrong, received in (
        (SoftSphere(1e-3), "neither"),
        (SoftSphere(1e-3, STEEL, 10.0), "both"),
        (SoftSphere(1e-3, "steel"), "the name 'steel'"),
        (SoftSphere(1e-3, fm.PermanentMagnet("magnet", 1.05, [0.0, 0.0, 1.2])), "a magnet"),
        (SoftSphere(1e-3, mu_r=0.5), "0.5"),
        (SoftSphere(1e-3, mu_r=1.0), "1.0"),
    ):
        with pytest.raises(InputError) as caught:
            magnetic_body(wrong)
        assert caught.value.problems[0].received == received
    with pytest.raises(InputError) as caught:
        wrench_actuation(Loops(LOOPS, 3e3), np.zeros(3), magnetic_body(BEAD))
    assert caught.value.problems[0].where == "actuation, currents"
