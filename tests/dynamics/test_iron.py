"""What a compiled loop superposes for saturating iron, against the reduced model; the division against the device's."""

import numpy as np
import pytest

from fieldmap.device.current_division import divide_currents, undivide_currents
from fieldmap.dynamics import linearised, superposed, tabled
from fieldmap.errors import InputError
from fieldmap.kernels.lookup import evaluate_with
from fieldmap.kernels.motion.allocation import divide
from fieldmap.kernels.motion.weights import find_weights, undivide

POINTS = np.random.default_rng(0).uniform(-0.015, 0.015, (20, 3))


def test_division_and_its_inverse_are_those_of_the_device_room():
    rng = np.random.default_rng(1)
    out = np.empty(6)
    for _ in range(20):
        u, x, y = rng.uniform(0.5, 2), *rng.uniform(-0.4, 0.4, 2)
        n = rng.uniform(1.0, 1.5)
        divide(u, x, y, n, out)
        np.testing.assert_allclose(out, divide_currents(u, x, y, n), rtol=1e-13)
        np.testing.assert_allclose(undivide(out, n), [u, x, y], atol=1e-13)
        off = out + 0.01 * rng.normal(size=6)
        signals = undivide_currents(off, n)
        np.testing.assert_allclose(undivide(off, n), [signals.u, signals.x, signals.y], atol=1e-13)


def field(of, currents):
    """Field and gradient at POINTS as the loop would superpose them."""
    sets = int(of.block[2])
    weights = np.empty(sets)
    assert find_weights(*of.numbers, np.asarray(currents, float), np.empty(6), np.empty(6), weights)
    flux, slope = np.empty((len(POINTS), 3)), np.empty((len(POINTS), 3, 3))
    evaluate_with(of.block, weights[None], POINTS, flux, slope)
    return flux, slope


@pytest.mark.parametrize("form", ["harmonic", "hermite"])
def test_a_linearised_map_touches_the_map(saturating, form):
    """Equal at the currents themselves; next to them wrong by the square of the distance."""
    m = saturating(form)
    at = divide_currents(1.5, 0.05, -0.1, 1.25)
    of = linearised(m, at)
    np.testing.assert_allclose(field(of, at)[1], m.gradient(POINTS, at), rtol=1e-9, atol=1e-12)
    errors = []
    for size in (0.04, 0.02, 0.01):
        near = at + size * np.array([1, -1, 0.5, 0.3, 1, -0.2])
        errors.append(np.abs(field(of, near)[0] - m.field(POINTS, near)).max())
    np.testing.assert_allclose(np.log2(np.array(errors[:-1]) / errors[1:]), 2.0, atol=0.2)


def test_a_table_is_of_third_order_along_the_division_and_follows_beside_it(saturating):
    m = saturating("harmonic")
    rng = np.random.default_rng(5)
    signals = rng.uniform([1.0, -0.4, -0.3], [2.2, 0.4, 0.3], (20, 3))
    errors = []
    for nodes in ((5, 5, 5), (9, 9, 9), (17, 17, 17)):
        of = tabled(m, nodes)
        asked = divide_currents(*signals.T, 1.25)
        errors.append(max(np.abs(field(of, i)[0] - m.field(POINTS, i)).max() for i in asked))
    assert np.log2(errors[0] / errors[-1]) / 2 > 2.5
    beside = divide_currents(1.7, 0.1, 0.1, 1.25)
    aside = beside + 0.01 * np.array([1, -1, 1, -1, 1, -1])
    change = field(of, aside)[0] - field(of, beside)[0]
    exact = m.field(POINTS, aside) - m.field(POINTS, beside)
    np.testing.assert_allclose(change, exact, atol=0.02 * np.abs(exact).max())


def test_scale_is_a_named_calibration(axial):
    m = axial.map((0.02, -0.1, 0.3))
    twice = superposed(m, 2.0)
    np.testing.assert_allclose(field(twice, [1.5])[0], m.field(POINTS, [3.0]), rtol=1e-12)
    assert any("times 2" in words for words in twice.assumptions)
    assert not superposed(m).assumptions


def test_currents_beyond_a_table_are_noticed(saturating):
    of = tabled(saturating("harmonic"), (3, 3, 3))
    scratch = np.empty(6), np.empty(6), np.empty(int(of.block[2]))
    assert not find_weights(*of.numbers, np.full(6, 2.5), *scratch)


def test_tables_need_a_division(axial):
    with pytest.raises(InputError, match="over a division"):
        tabled(axial.map((0.02, -0.1, 0.3)))
