"""The superposition weights of saturating iron in a compiled loop, against the reduced model."""

import numpy as np
import pytest

from fieldmap.core import CoreMap
from fieldmap.currents import divide_currents
from fieldmap.dynamics import linearised, superposed, tabled
from fieldmap.errors import InputError
from fieldmap.lookup import iron_weights
from tests.dynamics.machines import machine_in

POINTS = np.random.default_rng(0).uniform(-0.015, 0.015, (20, 3))


def field(of, currents):
    """Field and gradient at POINTS as superposed in the loop."""
    core = machine_in(of, len(currents))
    assert core.follow(np.asarray(currents, float))
    weights = core.weights
    flux, slope = np.empty((len(POINTS), 3)), np.empty((len(POINTS), 3, 3))
    CoreMap(of.block).fields(POINTS, weights[None], flux, slope)
    return flux, slope


@pytest.mark.parametrize("form", ["harmonic", "hermite"])
def test_a_linearised_map_touches_the_map(saturating, form):
    """Equal at the currents of the linearisation; the error grows with the square of the distance."""
    m = saturating(form)
    at = divide_currents(1.5, 0.05, -0.1, 1.25)
    of = linearised(m, at)
    np.testing.assert_allclose(field(of, at)[1], m.gradient(POINTS, at), rtol=1e-9, atol=1e-12)
    errors = []
    for size in (0.04, 0.02, 0.01):
        near = at + size * np.array([1, -1, 0.5, 0.3, 1, -0.2])
        errors.append(np.abs(field(of, near)[0] - m.field(POINTS, near)).max())
    np.testing.assert_allclose(np.log2(np.array(errors[:-1]) / errors[1:]), 2.0, atol=0.2)


def test_a_table_of_more_nodes_is_nearer_along_the_division_and_follows_beside_it(saturating):
    m = saturating("harmonic")
    rng = np.random.default_rng(5)
    signals = rng.uniform([1.0, -0.4, -0.3], [2.2, 0.4, 0.3], (20, 3))
    errors = []
    for nodes in ((4, 5, 5), (7, 9, 9), (13, 17, 17)):
        of = tabled(m, nodes)
        asked = divide_currents(*signals.T, 1.25)
        errors.append(max(np.abs(field(of, i)[0] - m.field(POINTS, i)).max() for i in asked))
    assert np.log2(errors[0] / errors[-1]) / 2 > 2.7
    at = divide_currents(1.7, 0.1, 0.1, 1.25)
    for size, share in ((0.002, 0.01), (0.02, 0.04)):
        aside = at + size * np.array([1, -1, 1, -1, 1, -1])
        change = field(of, aside)[0] - field(of, at)[0]
        exact = m.field(POINTS, aside) - m.field(POINTS, at)
        np.testing.assert_allclose(change, exact, atol=share * np.abs(exact).max())


def test_scale_is_a_named_calibration(axial):
    m = axial.map((0.02, -0.1, 0.3))
    twice = superposed(m, 2.0)
    np.testing.assert_allclose(field(twice, [1.5])[0], m.field(POINTS, [3.0]), rtol=1e-12)
    assert any("times 2" in words for words in twice.assumptions)
    assert not superposed(m).assumptions


def test_beyond_a_table_its_slopes_go_on(saturating):
    """`follow` reports it; the weights are continuous at the edge, and finite at any currents."""
    m = saturating("harmonic")
    core = machine_in(tabled(m, (4, 5, 5)), 6)
    ends = []
    for u in (2.2, 2.2 + 1e-6, 2.25):
        assert core.follow(divide_currents(u, 0.1, 0.1, 1.25)) == (u == 2.2)
        ends.append(core.weights)
    slope = (ends[1] - ends[0]) / 1e-6
    np.testing.assert_allclose(ends[2] - ends[0], 0.05 * slope, rtol=1e-4)
    exact = iron_weights(m, divide_currents(2.25, 0.1, 0.1, 1.25))[0][0]
    np.testing.assert_allclose(ends[2][6:], exact, atol=0.02 * np.abs(exact).max())
    for currents in (np.zeros(6), np.array([1.0, -1, 1, -1, 1, -1]), -np.ones(6)):
        assert not core.follow(currents)
        assert np.isfinite(core.weights).all()


def test_tables_need_a_division_and_nodes(axial, saturating):
    with pytest.raises(InputError, match="lift_and_directions"):
        tabled(axial.map((0.02, -0.1, 0.3)))
    with pytest.raises(InputError, match="at least 4"):
        tabled(saturating("harmonic"), (3, 5, 5))
