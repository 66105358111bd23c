"""Moments that a field induces in soft ellipsoids, and bodies of them, against the equations they solve."""

import pickle
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq

from fieldmap.core.body import CoreBody, Soft
from tests.core.map_cases import no_reaction

FACTORS = np.array([0.5, 0.3, 0.2])
KNOTS = np.array([0.0, 1e-3, 4e-3, 0.1])
J = np.array([0.0, 0.8, 1.4, 1.8])
SLOPES = np.array([800.0, 500.0, 50.0, 0.0])
TURN = np.array([[0.0, -1.0, 0.0], [0.6, 0.0, -0.8], [0.8, 0.0, 0.6]])
POSE = np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
LAW = CubicHermiteSpline(KNOTS, J, SLOPES)
DIPOLES = np.array([[1e-3, -2e-3, 5e-4, 0.3, -0.2, 0.8]])


def polarisation(h):
    """J(h); constant beyond the last knot."""
    return float(LAW(h)) if h < KNOTS[-1] else J[-1]


def work(h):
    """The integral of J dh."""
    return sum(quad(polarisation, a, min(b, h))[0] for a, b in pairwise(KNOTS) if h > a) + max(
        0.0, (h - KNOTS[-1]) * J[-1]
    )


def pieces(reluctance=0.02):
    """One piece of constant permeability and one with a law, the second turned."""
    law = np.array([KNOTS, J, SLOPES, [work(h) for h in KNOTS]])
    sphere = Soft(np.zeros(3), np.eye(3), np.full(3, 1 / 3), 2.0, reluctance, np.zeros((4, 0)))
    return sphere, Soft(np.array([1e-3, 0.0, 2e-3]), TURN, FACTORS, 3.0, 0.0, law)


def induced(body, flux, turns=None, soft=None):
    """Moments (n, q, 3), energies (n,) and slopes (n, soft, 3, 3) or, for 0, none of them."""
    n, q = flux.shape[:2]
    slopes = None if soft == 0 else np.empty((n, q if soft is None else soft, 3, 3))
    found, nothing = (np.empty((n, q, 3)), np.empty(n)), np.zeros((n, q, 0, 3, 3))
    turn = np.tile(np.eye(3), (n, 1, 1)) if turns is None else turns
    fields, reaction = (flux, np.zeros((n, q, 3, 3))), (0, nothing[..., 0], nothing)
    assert body.at_poses(turn, fields, reaction, (np.empty((n, 6)), found[1], found[0], slopes))
    return *found, slopes


def of_one(piece, flux):
    """Moment, energy and slopes of one piece in flux (3,)."""
    moments, energies, slopes = induced(CoreBody(np.zeros((0, 6)), [piece]), flux[None, None])
    return moments[0, 0], energies[0], slopes[0, 0]


@pytest.mark.parametrize("reluctance", [0.0, 0.02, 10.0])
def test_a_sphere_of_constant_permeability(reluctance):
    flux = np.array([0.1, -0.2, 0.3])
    moment, energy, slope = of_one(pieces(reluctance)[0], flux)
    exact = 2.0 * flux / (reluctance + 1 / 3)
    np.testing.assert_allclose(moment, exact, rtol=1e-15)
    np.testing.assert_allclose(slope, np.eye(3) * 2.0 / (reluctance + 1 / 3), rtol=1e-15)
    assert energy == pytest.approx(-0.5 * exact @ flux, rel=1e-14)


@pytest.mark.parametrize("size", [1e-6, 0.05, 0.4, 0.9, 2.0])
def test_an_ellipsoid_with_a_law(size):
    """h_i = b_i - N_i J_i with J along h, J(|h|) of the law, found by bisection."""
    along = size * np.array([0.6, -0.5, 0.4])

    def off(s):
        return sum((along / (s + FACTORS * polarisation(s))) ** 2) - 1.0

    s = brentq(off, 1e-12, 10.0, xtol=1e-16, rtol=1e-15)
    h = along / (1 + FACTORS * polarisation(s) / s)
    assert np.linalg.norm(h) == pytest.approx(s, rel=1e-9)
    j = polarisation(s) * h / s
    moment, energy, _ = of_one(pieces()[1], TURN @ along)
    np.testing.assert_allclose(TURN.T @ moment, 3.0 * j, rtol=1e-9, atol=1e-18)
    # -integral of m dB = -V (integral of J dh + N J^2 / 2), over mu0.
    assert energy == pytest.approx(-3.0 * (work(s) + 0.5 * FACTORS @ j**2), rel=1e-8)


@pytest.mark.parametrize("size", [0.0, 1e-6, 0.05, 0.4, 0.9])
def test_slopes_are_those_of_the_moment_and_of_the_energy(size):
    piece, flux, step = pieces()[1], size * np.array([0.5, 0.6, -0.4]), 1e-5 * max(size, 1e-3)
    moment, _, slope = of_one(piece, flux)
    ahead, behind = ([of_one(piece, flux + way * step * unit) for unit in np.eye(3)] for way in (1, -1))
    exact = np.array([(a[0] - b[0]) / (2 * step) for a, b in zip(ahead, behind, strict=True)]).T
    np.testing.assert_allclose(slope, exact, atol=1e-6 * np.abs(slope).max())
    np.testing.assert_allclose(slope, slope.T, atol=1e-12 * np.abs(slope).max())
    by_energy = [(a[1] - b[1]) / (2 * step) for a, b in zip(ahead, behind, strict=True)]
    np.testing.assert_allclose(by_energy, -moment, atol=1e-7 * np.linalg.norm(moment) + 1e-12)


def test_bodies_at_several_poses():
    body, turns = CoreBody(DIPOLES, pieces()), np.array([np.eye(3), TURN])
    flux = np.random.default_rng(1).normal(size=(2, 3, 3))
    moments, energies, slopes = induced(body, flux, turns, soft=2)
    for n in range(2):
        np.testing.assert_allclose(moments[n, 0], turns[n] @ DIPOLES[0, 3:], rtol=1e-14)
        sum_of = -moments[n, 0] @ flux[n, 0]
        for p, piece in enumerate(pieces()):
            own, energy, slope = of_one(piece, turns[n].T @ flux[n, 1 + p])
            np.testing.assert_allclose(moments[n, 1 + p], turns[n] @ own, rtol=1e-13)
            np.testing.assert_allclose(slopes[n, p], turns[n] @ slope @ turns[n].T, rtol=1e-12, atol=1e-12)
            sum_of += energy
        assert energies[n] == pytest.approx(sum_of, rel=1e-14)
    again, _, none = induced(pickle.loads(pickle.dumps(body)), flux, turns, soft=0)
    np.testing.assert_array_equal(again, moments)
    assert none is None


def loaded(body, weights, flux, gradient, turn=POSE):
    """Wrench (6,) and its slopes (6, k)."""
    wrench, slopes = np.empty(6), np.empty((6, len(weights)))
    body.wrench_slopes(turn, weights, (flux, gradient), no_reaction(flux), wrench, slopes)
    return wrench, slopes


def fields(points, count):
    """`count` fields at the points: flux (points, count, 3) and gradient (points, count, 3, 3)."""
    rng = np.random.default_rng(2)
    return 0.05 * rng.normal(size=(points, count, 3)), rng.normal(size=(points, count, 3, 3))


def test_the_wrench_is_the_sum_over_dipoles_and_soft_pieces():
    body, weights, (flux, gradient) = CoreBody(DIPOLES, pieces()), np.array([1.0, -0.6]), fields(3, 2)
    b, g = np.einsum("k,pki->pi", weights, flux), np.einsum("k,pkij->pij", weights, gradient)
    moments = [DIPOLES[0, 3:], *(of_one(piece, POSE.T @ b[1 + p])[0] for p, piece in enumerate(pieces()))]
    points, force, torque = [DIPOLES[0, :3], *(piece.centre for piece in pieces())], np.zeros(3), np.zeros(3)
    for p, (point, moment) in enumerate(zip(points, moments, strict=True)):
        m = POSE @ moment
        force += m @ g[p]
        torque += np.cross(m, b[p]) + np.cross(POSE @ point, m @ g[p])
    np.testing.assert_allclose(loaded(body, weights, flux, gradient)[0], [*force, *torque], rtol=1e-12)


@pytest.mark.parametrize("soft", [(), pieces()])
def test_slopes_by_weights_leave_an_error_of_second_order(soft):
    """Taylor's test, and central differences."""
    body, weights, at = CoreBody(DIPOLES, soft), np.array([1.0, -0.6]), fields(1 + len(soft), 2)
    here, slopes = loaded(body, weights, *at)
    exact = np.column_stack(
        [
            (loaded(body, weights + d, *at)[0] - loaded(body, weights - d, *at)[0]) / 2e-5
            for d in 1e-5 * np.eye(2)
        ]
    )
    np.testing.assert_allclose(slopes, exact, atol=1e-6 * np.abs(exact).max())
    way = np.array([0.3, 0.7])
    left = [
        np.linalg.norm(loaded(body, weights + t * way, *at)[0] - here - t * slopes @ way)
        for t in (1e-3, 5e-4)
    ]
    assert left[0] < 1e-13 * np.linalg.norm(here) if not soft else 3.5 < left[0] / left[1] < 4.5


def test_arguments_that_do_not_fit_are_refused():
    body, weights, at = CoreBody(DIPOLES, pieces()), np.array([1.0, -0.6]), fields(3, 2)
    with pytest.raises(TypeError):
        CoreBody(np.zeros((1, 5)))
    with pytest.raises(TypeError):
        CoreBody(DIPOLES, [pieces()[1]._replace(law=np.zeros((3, 4)))])
    with pytest.raises(TypeError):
        loaded(body, weights, at[0][:2].copy(), at[1])
    with pytest.raises(TypeError):
        loaded(body, weights, *at, turn=np.zeros((2, 3)))
    with pytest.raises(TypeError):
        induced(body, np.zeros((1, 1, 3)))
