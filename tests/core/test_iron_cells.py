"""Play cells in the C core: their law against its definition, the projected equation in numpy, and Madelung's rules."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from fieldmap.core.iron import FOUND, NOT_FINITE, CoreIron
from fieldmap.core.iron_numbers import core_numbers
from fieldmap.lookup.current_solver import compiled_model
from tests.core.iron_cases import CASES, MODES, POINTS

CELLS, EXACT = 4, 1e-12
# The first of the two laws has pinning, the second none: iron with hysteresis beside iron without it.
PINNING = np.array([np.linspace(0.0, 8e-4, CELLS), np.zeros(CELLS)])
SHARES = np.array([0.5, 1.0, 1.0, 0.5]) / 3.0
# b = 2000 h up to 1 mT, a parabola to slope 1.2 at 3 mT, then slope 1.2: saturated cells have a derivative
# only while J grows.
CURVE = np.array([[0.0, 0.0, 2000.0, 0.0], [0.0, -1998.8 / 4e-3, 2000.0, 2.0], [0.0, 0.0, 1.2, 4.0012]])
OF = replace(CASES["free"], law_coefficients=np.concatenate([CURVE, CURVE]))
COUNT = OF.coil_count + OF.field_count


def law(h):
    inner = np.where(h < 1e-3, 2000.0 * h, 2.0 + 2000.0 * (h - 1e-3) - 1998.8 / 4e-3 * (h - 1e-3) ** 2)
    return np.where(h < 3e-3, inner, 4.0012 + 1.2 * (h - 3e-3))


@cache
def without_cells():
    return compiled_model(OF, checked=False)


def core_of(pinning=PINNING, shares=SHARES, of=OF):
    return CoreIron(numbers_of(pinning, shares, of))


def numbers_of(pinning=PINNING, shares=SHARES, of=OF):
    model = without_cells() if of is OF else compiled_model(of, checked=False)
    nothing = {"terms": np.zeros((1, 3), np.int64), "expansion": np.zeros((1, MODES))}
    return core_numbers(model._replace(pinning=pinning, shares=shares, **nothing))


def led(state, way, tolerance=EXACT):
    """Weights (n, COUNT) along a path (n, c) of currents."""
    found = np.empty((len(way), COUNT))
    for currents, weights in zip(way, found, strict=True):
        assert state.step(np.array(currents), weights, tolerance=tolerance) == FOUND
    return found


def cells_of(state):
    """Reversible fields (p, k, 3) of the cells: the last numbers of the memory."""
    return state.remembered[-4 * POINTS * CELLS :].reshape(POINTS, CELLS, 4)[..., :3]


def polarisation(r):
    size = np.linalg.norm(r, axis=-1, keepdims=True)
    return np.where(size > 0.0, (law(size) - size) / np.maximum(size, 1e-300), 1999.0) * r


def field_at(state, currents):
    gradients = OF.gradients.astype(np.float32).astype(float)
    return (OF.source @ currents - gradients @ state.amplitudes).reshape(POINTS, 3)


WAY = np.random.default_rng(6).uniform(-1.0, 1.0, (8, 3)) + [0.0, 0.0, 1.0]


def test_each_step_is_the_least_of_energy_and_friction():
    """Equation (2) of docs/theory/hysteresis.md for every cell, and the residual of the projected equation."""
    state, before = core_of().state(), np.zeros((POINTS, CELLS, 3))
    gradients, pinned, moved = OF.gradients.astype(np.float32).astype(float), OF.law == 0, 0
    for currents in WAY:
        led(state, [currents])
        h, now = field_at(state, currents), cells_of(state)
        drag, kappa = h[:, None] - now, PINNING[0]
        assert np.all(np.linalg.norm(drag, axis=2)[pinned] <= kappa * (1.0 + 1e-9) + 1e-12)
        change = polarisation(now) - polarisation(before)
        moves = np.linalg.norm(change, axis=2) > 1e-9
        # Cells that move lie on their circle, and their polarisation moved along the drag.
        at = moves & pinned[:, None] & (kappa > 0.0)
        np.testing.assert_allclose(
            np.linalg.norm(drag, axis=2)[at], np.broadcast_to(kappa, at.shape)[at], rtol=1e-9
        )
        cosine = (
            np.sum(change * drag, axis=2)[at]
            / (np.linalg.norm(change, axis=2) * np.linalg.norm(drag, axis=2))[at]
        )
        np.testing.assert_allclose(cosine, 1.0, atol=1e-9)
        moved += at.sum()
        j = np.where(pinned[:, None], np.einsum("k,pkd->pd", SHARES, polarisation(now)), polarisation(h))
        left = (OF.weights[:, None] * j).ravel() @ gradients - OF.air @ state.amplitudes
        assert np.abs(left).max() < 1e-8 * np.abs(OF.air @ state.amplitudes).max()
        before = now
    assert moved > 100


def test_without_pinning_it_is_the_iron_without_hysteresis():
    plain, state = core_of(np.zeros((0, 0)), np.zeros(0)).state(), core_of(0.0 * PINNING).state()
    for currents, found in zip(WAY, led(state, WAY), strict=True):
        expected = np.empty(COUNT)
        assert plain.solve(np.array(currents), expected, tolerance=EXACT, fresh=True) == FOUND
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def along_x(rows):
    """The same rows without the parts along y and z."""
    return rows * np.tile([1.0, 0.0, 0.0], POINTS)[:, None]


def test_on_one_axis_loops_close_are_wiped_out_and_ways_divide():
    """Madelung's rules are exact where all fields lie on one axis and follow the currents."""
    of = replace(OF, source=along_x(np.abs(OF.source)), gradients=0.05 * along_x(OF.gradients))
    core = core_of(of=of)

    def way(*levels):
        return np.array(levels)[:, None] * np.ones(OF.coil_count)

    out = led(core.state(), way(0.3, 0.7, 1.0, 0.2))
    np.testing.assert_allclose(led(core.state(), way(1.0, 0.2)), out[2:], rtol=1e-8, atol=1e-10)
    inner = led(core.state(), way(1.0, 0.2, 0.6, 0.4, 0.6, 0.2, 1.0))
    size = np.abs(inner).max()
    # The inner loops close and leave nothing behind.
    for first, again in ((2, 4), (1, 5), (0, 6)):
        np.testing.assert_allclose(inner[again], inner[first], rtol=0.0, atol=1e-9 * size)
    branches = led(core.state(), way(0.6))[0], inner[2]
    assert np.abs(branches[1] - branches[0]).max() > 0.01 * size


def test_in_space_the_way_back_differs_and_ways_divide_nearly():
    turn, inner = np.array([0.6, -0.4, 1.2]), np.array([0.2, 0.1, 0.5])
    whole = led(core_of().state(), [turn])[-1]
    size = np.abs(whole).max()
    # The drag follows the path.
    assert np.abs(led(core_of().state(), np.linspace(0.0, turn, 8)[1:])[-1] - whole).max() < 0.02 * size
    back = led(core_of().state(), [turn, inner])[1]
    assert np.abs(back - led(core_of().state(), [inner])[0]).max() > 0.02 * size


def test_trials_leave_no_trace():
    tried, straight = core_of().state(), core_of().state()
    led(tried, WAY[:3])
    led(straight, WAY[:3])
    before, weights = cells_of(tried), np.empty(COUNT)
    assert tried.solve(WAY[5], weights, tolerance=EXACT) == FOUND
    np.testing.assert_array_equal(cells_of(tried), before)
    np.testing.assert_allclose(led(tried, WAY[3:]), led(straight, WAY[3:]), rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("tolerance", [1e-4, EXACT])
def test_a_state_goes_on_from_what_it_remembered_to_the_last_bit(tolerance):
    core = core_of()
    state, other = core.state(), core.state()
    led(state, WAY[:4], tolerance)
    other.recall(state.remembered)
    np.testing.assert_array_equal(led(other, WAY[4:], tolerance), led(state, WAY[4:], tolerance))
    np.testing.assert_array_equal(other.remembered, state.remembered)
    with pytest.raises(TypeError):
        other.recall(state.remembered[:-1])


def test_what_is_recalled_has_its_field_at_the_last_currents():
    """A solve at these currents returns at once with the recalled field."""
    core = core_of()
    state, other = core.state(), core.state()
    led(state, WAY[:4], 1e-4)
    other.recall(state.remembered)
    slopes = np.empty((2, COUNT, OF.coil_count))
    for each, out in zip((state, other), slopes, strict=True):
        assert each.solve(WAY[3], np.empty(COUNT), out, tolerance=100.0 * EXACT) == FOUND
    np.testing.assert_array_equal(slopes[1], slopes[0])
    state, other = core.state(), core.state()
    led(state, WAY[:4])
    other.recall(state.remembered)
    led(other, WAY[3:4])
    np.testing.assert_allclose(cells_of(other), cells_of(state), rtol=1e-9, atol=1e-15)
    led(state, WAY[3:4])
    np.testing.assert_array_equal(other.remembered, state.remembered)


def test_slopes_are_the_derivative_with_the_cells_as_they_are():
    state, direction = core_of().state(), np.array([-0.3, 0.8, -0.5])
    led(state, WAY[:3])
    there, here, slopes = state.remembered, np.empty(COUNT), np.empty((COUNT, OF.coil_count))
    away = WAY[2] + 0.8 * direction
    assert state.solve(away, here, slopes, tolerance=EXACT) == FOUND
    left = []
    for t in 0.005 * 0.5 ** np.arange(4):
        state.recall(there)
        weights = np.empty(COUNT)
        assert state.solve(away + t * direction, weights, tolerance=EXACT) == FOUND
        left.append(np.linalg.norm(weights - here - t * slopes @ direction))
    orders = np.log2(np.array(left[:-1]) / left[1:])
    assert np.all(np.abs(orders - 2.0) < 0.25)


def test_currents_that_are_no_numbers_leave_the_cells():
    state, weights = core_of().state(), np.empty(COUNT)
    led(state, WAY[:2])
    before = cells_of(state)
    assert state.step(np.array([0.0, np.nan, 1.0]), weights, tolerance=EXACT) == NOT_FINITE
    assert np.isnan(weights).all()
    np.testing.assert_array_equal(cells_of(state), before)


def test_shares_and_pinning_must_fit():
    good = numbers_of()
    for count in (CELLS + 1, -1.0, 0.5, 1000.0):
        damaged = good.copy()
        damaged[17] = count
        with pytest.raises(ValueError, match="model"):
            CoreIron(damaged)
