"""Balances with the iron's reaction to magnets: against the wrench of the map, differences, and made-up readings."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

import fieldmap as fm
from fieldmap.errors import NotConverged
from fieldmap.levitation import (
    LiftReadings,
    calibrate,
    equilibrium_at,
    equilibrium_surface,
    find_equilibrium,
    lift_current,
    magnet_balance,
    stationary_points,
)
from fieldmap.levitation.comparison import LiftAtHeight, fit_force
from fieldmap.lookup import magnetic_body

DEVICE = fm.read_device("desk_levitator")
MAGNET, WEIGHT = DEVICE.payload, 9.80665 * DEVICE.payload.mass
DIPOLE, FREE, DOWN = (
    replace(MAGNET, **changed)
    for changed in ({"volume_level": 1}, {"turning": "free"}, {"direction": "down"})
)
BESIDE, BELOW = np.array([0.0013, 0.0007, -0.0253]), np.array([0.0, 0.0, -0.025])
CURRENT, SCALE = 0.3, 1.3


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return fm.generate(DEVICE, tmp_path_factory.mktemp("map") / "desk.h5", spacing=3e-3, progress=False)


@pytest.fixture(scope="module")
def field(file):
    return fm.open_map(file)


@pytest.fixture(scope="module")
def alone(file):
    """The same map without the reaction."""
    return fm.open_map(file, reaction=False)


def wrenches(field, payload, places, current):
    """Force (n, 3), N, on the payload by the map's own wrench; a free payload is at the moment without torque."""
    if payload.turning != "free":
        return magnetic_body(payload).wrench(field, places, [current])[:, :3]
    flux = field.field(places, [current])
    moments = np.array([free_moment(field, *at, payload.moment) for at in zip(places, flux, strict=True)])
    return field.wrench(places, moments, [current])[:, :3]


def free_moment(field, place, flux, size):
    """The moment of least energy -m . B - m . A m / 2: (l - A) m = B in the axes of A, |m| = size for the largest l."""
    strength, axes = np.zeros(3), np.eye(3)
    if field.reaction is not None:
        b = field.reaction.fields(place[None])[0][:, 0]
        strength, axes = np.linalg.eigh(np.einsum("k,ki,kj->ij", field.reaction.signs, b, b))
    inside = flux @ axes

    def excess(l):
        return np.linalg.norm(inside / (l - strength)) - size

    low = strength.max() + 1e-9 * np.linalg.norm(flux) / size
    found = brentq(excess, low, strength.max() + 2 * np.linalg.norm(flux) / size, xtol=1e-18, rtol=1e-15)
    return axes @ (inside / (found - strength))


def stated(result):
    """The words on the reaction in a result."""
    return [words for words in result.assumptions if "reaction" in words]


@pytest.mark.parametrize("payload", [MAGNET, DIPOLE, DOWN, FREE], ids=["magnet", "dipole", "down", "free"])
def test_force_and_stiffness(field, payload):
    balance = magnet_balance(field, np.array([CURRENT]), payload, None)
    np.testing.assert_allclose(
        balance.magnetic_force(BESIDE[None]), wrenches(field, payload, BESIDE[None], CURRENT), rtol=1e-10
    )
    steps = 1e-6 * np.eye(3)
    ahead, behind = (wrenches(field, payload, BESIDE + way * steps, CURRENT) for way in (1, -1))
    expected = -(ahead - behind).T / 2e-6
    np.testing.assert_allclose(balance.stiffness(BESIDE), expected, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("payload", [MAGNET, DIPOLE, FREE], ids=["magnet", "dipole", "free"])
def test_an_equilibrium_is_where_the_whole_force_is_the_weight(field, payload):
    found = find_equilibrium(field, [CURRENT], payload)
    force = wrenches(field, payload, found.position[None], CURRENT)[0]
    np.testing.assert_allclose(force, [0.0, 0.0, WEIGHT], atol=1e-7 * WEIGHT)


@pytest.mark.parametrize("model", ["fixed", "rigid", "rigid upright"])
def test_the_iron_carries_two_fifths_of_the_weight_without_currents(field, alone, model):
    if model != "rigid":
        balance = magnet_balance(field, np.zeros(1), MAGNET, None, model)
        assert 0.39 <= balance.magnetic_force(BELOW[None])[0, 2] / WEIGHT <= 0.40
        assert not magnet_balance(alone, np.zeros(1), MAGNET, None, model).magnetic_force(BELOW[None]).any()
    upright = magnet_balance(field, np.array([CURRENT]), MAGNET, None, model)
    assert 0.39 <= upright.reaction_force(BELOW[None])[0, 2] / WEIGHT <= 0.40


@pytest.mark.parametrize("payload", [MAGNET, DIPOLE, DOWN, FREE], ids=["magnet", "dipole", "down", "free"])
@pytest.mark.parametrize("height", [-0.0195, -0.0253])
def test_the_current_carries_the_rest(field, alone, payload, height):
    """Near the core the coil pushes down; a free magnet turns with the field, which then pulls it up."""
    if payload is FREE and height > -0.021:
        with pytest.raises(NotConverged):
            lift_current(field, payload, [0.0, 0.0, height], first=CURRENT)
        return
    place = np.array([0.0, 0.0, height])
    found = lift_current(field, payload, place, first=CURRENT)
    off = wrenches(field, replace(payload, turning=None), place[None], 0.0)[0, 2]
    way = -1.0 if payload is DOWN else 1.0
    if payload is not FREE:
        assert np.sign(found.current) == np.sign(WEIGHT - off) * way
    assert wrenches(field, payload, place[None], found.current)[0, 2] == pytest.approx(WEIGHT, rel=1e-7)
    without = lift_current(alone, payload, place, first=CURRENT)
    assert wrenches(alone, payload, place[None], without.current)[0, 2] == pytest.approx(WEIGHT, rel=1e-7)
    per_ampere = wrenches(alone, replace(payload, turning=None), place[None], 1.0)[0, 2]
    if payload is not FREE:
        assert without.current == pytest.approx(WEIGHT / per_ampere, rel=1e-9)
        assert found.current == pytest.approx((WEIGHT - off) / per_ampere, rel=1e-6)
        np.testing.assert_allclose(found.force_per_ampere[2], per_ampere, rtol=1e-6)


def test_results_say_whether_the_reaction_is_in_and_how_large_it_is(field, alone):
    found = lift_current(field, MAGNET, BELOW)
    balance = magnet_balance(field, np.zeros(1), MAGNET, None)
    share = balance.magnetic_force(found.position[None])[0, 2] / WEIGHT
    of_set = stationary_points(field, [CURRENT], MAGNET, BELOW[2], samples=6)
    for result in (found, of_set):
        (words,) = stated(result)
        assert f": in, {share:.2g} of the weight" in words
    (words,) = stated(find_equilibrium(field, [CURRENT], MAGNET))
    assert ": in, " in words
    for result in (lift_current(alone, MAGNET, BELOW), find_equilibrium(alone, [CURRENT], MAGNET)):
        (words,) = stated(result)
        assert words.endswith("left out")
    (words,) = stated(find_equilibrium(fm.solve_linear(DEVICE), [CURRENT], MAGNET))
    assert words.endswith("left out")
    coil = fm.solve_linear(replace(DEVICE, bodies=()))
    assert not stated(lift_current(coil, MAGNET, BELOW))


def test_the_state_of_a_map_has_the_reaction(field):
    state = field.at([CURRENT])
    found = find_equilibrium(state, payload=MAGNET)
    np.testing.assert_allclose(found.position, find_equilibrium(field, [CURRENT], MAGNET).position, atol=1e-9)


def test_a_scale_of_the_field_leaves_the_reaction_as_it_is(field, alone):
    """Lifts of a machine with a coil that is stronger by a factor: the fit returns the factor."""
    heights = np.linspace(-0.035, -0.024, 5)
    places = np.column_stack([np.zeros((5, 2)), heights])
    drawn = wrenches(field, MAGNET, places, 0.0)[:, 2]
    per_ampere = wrenches(alone, MAGNET, places, 1.0)[:, 2]
    currents = (WEIGHT - drawn) / (SCALE * per_ampere)
    found = calibrate(field, MAGNET, LiftReadings(heights, currents[:, None]), fit=("field_scale",))
    assert found.values["field_scale"] == pytest.approx(SCALE, rel=1e-6)
    assert any(f": in, {drawn.max() / WEIGHT:.2g} of the weight" in words for words in found.assumptions)
    rows = [
        LiftAtHeight(z, None, measured=i, lift_share=(own + i * force) / WEIGHT)
        for z, i, own, force in zip(heights, currents, drawn, per_ampere, strict=True)
    ]
    fit = fit_force(field, MAGNET, rows)
    assert fit.factor == pytest.approx(SCALE, rel=1e-6)
    np.testing.assert_allclose(fit.currents, currents, rtol=1e-6)
    for k in (0, 4):
        about = (field, MAGNET, lambda u, k=k: (np.array([u]), heights[k]), [0.0, 0.0])
        point, level = equilibrium_at(*about, 1.1 * currents[k], True, SCALE)
        assert level == pytest.approx(currents[k], rel=1e-6)
        assert point.reaction == pytest.approx(drawn[k], rel=1e-9)
    found = equilibrium_surface(field, MAGNET, [0.0], [0.0], currents[0], heights[0])
    assert found.field_scale == pytest.approx(SCALE, rel=1e-6)


@pytest.mark.parametrize("payload", [MAGNET, FREE], ids=["magnet", "free"])
@pytest.mark.parametrize("place", [BESIDE, np.array([0.0013, 0.0007, -0.019])], ids=["beside", "nearer"])
def test_the_stiffness_of_a_scaled_field(field, payload, place):
    balance = magnet_balance(field, np.array([CURRENT]), payload, None)
    steps = 1e-6 * np.eye(3)
    ahead, behind = (balance.scaled_force(place + way * steps, SCALE) for way in (1, -1))
    expected = -(ahead - behind).T / 2e-6
    np.testing.assert_allclose(
        balance.scaled_stiffness(place, SCALE), expected, atol=1e-4 * np.abs(expected).max()
    )
