"""Equilibria over both signals, for coils that hold the magnet at the centroid of the currents."""

from dataclasses import replace

import numpy as np
import pytest

from fieldmap.currents import LiftAndDirections
from fieldmap.device.model import Payload
from fieldmap.errors import InputError, NoEquilibrium
from fieldmap.field import as_field
from fieldmap.levitation import equilibrium_surface
from tests.levitation.conftest import PolynomialField, lifting_above
from tests.refusals import refused

PLACES = 0.02 * np.array([[-1, -2, -1, 1, 2, 1], [-1, 0, 1, -1, 0, 1]]).T
PAYLOAD = Payload(mass=0.011, moment=0.8)
SIGNALS = np.array([-0.2, -0.1, 0.0, 0.1, 0.2])


def wells(places=PLACES, sign=1.0):
    """Coil k at r_k of places (n, 2), m: Bz = 0.1 z + 2 (z^2 - (r - r_k)^2 / 2) per ampere, which draws a moment m to
    r_k with 2 m per A."""
    potentials = []
    for x, y in places:
        g = np.zeros((3, 3))
        g[0, 0], g[1, 0], g[0, 1], g[2, 0], g[0, 2] = -(x**2) - y**2, 2 * x, 2 * y, -1.0, -1.0
        potentials.append(sign * lifting_above(g, 0.1))
    edge = np.array([0.03, 0.03, 0.04])
    return PolynomialField(potentials, -edge, edge)


def centroid(x, y, n):
    """The centroid of the currents of `LiftAndDirections`."""
    corner = {1: (1 - x) * (1 - y), 3: (1 - x) * (1 + y), 4: (1 + x) * (1 - y), 6: (1 + x) * (1 + y)}
    rest = 6.0 - sum(corner.values())
    shares = corner | {2: rest * (1 - n * x) / 2, 5: rest * (1 + n * x) / 2}
    return sum(shares[k] * PLACES[k - 1] for k in shares) / 6.0


@pytest.mark.parametrize("held", [True, False])
def test_the_magnet_rests_at_the_centroid_of_the_currents(held):
    signals, division = (SIGNALS, SIGNALS[1:]), LiftAndDirections(1.25)
    found = equilibrium_surface(wells(), PAYLOAD, *signals, 1.5, -0.01, division, held)
    expected = [[centroid(x, y, 1.25) for y in signals[1]] for x in signals[0]]
    np.testing.assert_allclose(found.positions[..., :2], expected, atol=1e-8)
    # The lift depends on the sum of the currents only, so the held level does not move.
    np.testing.assert_allclose(found.levels, 1.5, rtol=1e-6)
    np.testing.assert_allclose(found.positions[..., 2], -0.01)
    assert found.stable.all()
    lift = 0.8 * 6 * 1.5 * (0.1 - 0.04)
    assert found.field_scale == pytest.approx(0.011 * 9.80665 / lift if held else 1.0)
    assert found.assumptions[0].endswith("n = 1.25")
    assert ("follows" in found.assumptions[2]) is held


def test_a_map_for_a_division_is_asked_for_its_own_signals():
    """The field's own parametrisation counts, unless shares are given."""
    field = as_field(wells())
    field.parametrisation = LiftAndDirections(1.4)
    found = equilibrium_surface(field, PAYLOAD, [0.1, 0.0], [0.0, -0.2], 1.5, -0.01)
    expected = [[centroid(x, y, 1.4) for y in (0.0, -0.2)] for x in (0.1, 0.0)]
    np.testing.assert_allclose(found.positions[..., :2], expected, atol=1e-8)
    other = equilibrium_surface(field, PAYLOAD, [0.1], [0.0], 1.5, -0.01, shares=np.ones(6))
    assert "least power" in other.assumptions[0]


def test_beyond_the_map_there_is_no_place():
    division = LiftAndDirections(1.25)
    found = equilibrium_surface(wells(), PAYLOAD, [0.0, 0.9, 1.5], [0.0], 1.5, -0.01, division, False)
    assert np.isfinite(found.levels).ravel().tolist() == [True, True, False]
    assert centroid(1.5, 0.0, 1.25)[0] > 0.03 > centroid(0.9, 0.0, 1.25)[0]


RING = 0.02 * np.array([[np.cos(a), np.sin(a)] for a in 2 * np.pi * np.arange(7) / 7])
SQUARE = 0.02 * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])


@pytest.mark.parametrize("places", [SQUARE, RING], ids=["4 coils", "7 coils"])
def test_any_number_of_coils_pushes_with_least_power(places):
    """Coils about the axis: c_x is in proportion to their x, and the centroid of the currents moves along x only."""
    found = equilibrium_surface(wells(places), PAYLOAD, SIGNALS, SIGNALS, 1.5, -0.01)
    slope = (places**2).sum(axis=0) / np.abs(places).max(axis=0) / len(places)
    expected = slope * np.stack(np.meshgrid(SIGNALS, SIGNALS, indexing="ij"), axis=-1)
    np.testing.assert_allclose(found.positions[..., :2], expected, atol=1e-8)
    np.testing.assert_allclose(found.levels, 1.5, rtol=1e-6)
    lift = 0.8 * len(places) * 1.5 * (0.1 - 0.04)
    assert found.field_scale == pytest.approx(0.011 * 9.80665 / lift)
    # Coils of the other sense hold a magnet that points down, and push it the same way.
    below = replace(PAYLOAD, direction="down")
    turned = equilibrium_surface(wells(places, -1.0), below, SIGNALS, SIGNALS, 1.5, -0.01)
    np.testing.assert_allclose(turned.positions, found.positions, atol=1e-8)
    assert not any("n = " in words or "does nothing" in words for words in found.assumptions)


def test_shares_are_the_currents_at_signals_0():
    shares = np.array([1.0, 1.0, 2.0, 2.0])
    found = equilibrium_surface(wells(SQUARE), PAYLOAD, [0.0], [0.0], 1.0, -0.01, shares=shares)
    np.testing.assert_allclose(found.positions[0, 0, :2], shares @ SQUARE / shares.sum(), atol=1e-8)


def test_coils_in_a_row_do_not_push_across_it():
    """Coils on the x axis: y signals do nothing, and the magnet stays where it is in y."""
    found = equilibrium_surface(wells(SQUARE * [1, 0]), PAYLOAD, SIGNALS, SIGNALS, 1.5, -0.01)
    np.testing.assert_allclose(found.positions[:, :, 0], 0.02 * SIGNALS[:, None] * np.ones(5), atol=1e-8)
    np.testing.assert_allclose(found.positions[:, :, 1], 0.0, atol=1e-12)
    assert "do not push along y" in found.assumptions[0]


def test_what_does_not_fit():
    with refused(InputError, where="currents"):
        equilibrium_surface(wells(SQUARE), PAYLOAD, SIGNALS, SIGNALS, 1.5, -0.01, shares=[1.0, 2.0])
    with pytest.raises(NoEquilibrium):
        equilibrium_surface(wells(), PAYLOAD, [5.0], [0.0], 1.5, -0.01, LiftAndDirections(1.25))
