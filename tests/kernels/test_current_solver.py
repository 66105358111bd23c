"""The compiled model of saturating iron against the C core."""

from functools import cache

import numpy as np
import pytest

from fieldmap.core.iron import CoreIron
from fieldmap.kernels.map import current_solver as kernels
from fieldmap.kernels.map.current_solver import current_slopes, current_weights
from fieldmap.lookup.current_solver import compiled_model, core_numbers, expansion_terms, new_state
from tests.core.iron_cases import CASES, DRAWN, drawn


@cache
def compiled_case(name):
    return compiled_model(CASES[name], checked=True)


@pytest.fixture(params=CASES)
def case(request):
    """A model, and what is compiled of it."""
    return CASES[request.param], compiled_case(request.param)


def weights_of(compiled, state, currents, tolerance=None):
    out = np.empty(len(state.weights))
    used = compiled if tolerance is None else compiled._replace(tolerance=tolerance)
    return current_weights(used, state, currents, out), out


def test_weights_and_slopes_are_those_of_the_core(case):
    """Which meets the equation and Taylor's theorem: tests/core/test_iron.py."""
    of, compiled = case
    exact, state = compiled._replace(tolerance=1e-13), new_state(compiled)
    core = CoreIron(core_numbers(compiled)).state()
    shape = len(state.weights), of.coil_count
    (ours, core_slopes), (weights, slopes) = ((np.empty(shape[0]), np.empty(shape)) for _ in range(2))
    for currents in drawn(of, DRAWN):
        assert core.solve(currents, ours, core_slopes, tolerance=1e-13) == kernels.FOUND
        assert current_slopes(exact, state, currents, weights, slopes) == kernels.FOUND
        np.testing.assert_allclose(weights, ours, rtol=1e-11, atol=1e-12 * np.abs(ours).max())
        np.testing.assert_allclose(slopes, core_slopes, rtol=1e-9, atol=1e-10 * np.abs(slopes).max())
        assert (
            np.abs(weights_of(exact, new_state(compiled), currents)[1] - ours).max()
            < 1e-11 * np.abs(ours).max()
        )


def test_lookups_are_as_exact_as_their_tolerance(case):
    of, compiled = case
    for currents in drawn(of, 30, 5):
        (_, cold), (_, exact) = (
            weights_of(compiled, new_state(compiled), currents, t) for t in (None, 1e-12)
        )
        assert np.abs(cold - exact).max() < 1e-3 * np.abs(exact).max()
        assert np.array_equal(cold, weights_of(compiled, new_state(compiled), currents)[1])


def test_near_the_last_currents_fewer_steps_are_needed(case):
    of, compiled = case
    shares = 0.5 + 0.3 * np.sin(np.arange(60)[:, None] / 60 + np.arange(len(of.lower)))
    follower, steps = new_state(compiled), []
    for currents in of.domain.at(shares):
        cold = new_state(compiled)
        _, exact = weights_of(compiled, cold, currents, 1e-10)
        _, found = weights_of(compiled, follower, currents)
        assert np.abs(found - exact).max() < 1e-3 * np.abs(exact).max()
        weights_of(compiled, cold := new_state(compiled), currents)
        steps.append((follower.numbers[kernels.STEPS], cold.numbers[kernels.STEPS]))
    followed, begun = np.mean(steps[3:], axis=0)
    assert followed < 0.8 * begun


def test_what_has_no_solution_says_so(case):
    of, compiled = case
    state, middle = new_state(compiled), np.array(of.domain.middle)
    beyond = 5.0 * of.domain.largest
    assert weights_of(compiled, state, middle)[0] == kernels.FOUND
    for wrong, reason in ((beyond, kernels.BEYOND), (np.nan * middle, kernels.NOT_FINITE)):
        status, out = weights_of(compiled, state, wrong)
        assert status == reason
        assert np.isnan(out).all()
    open_ended = compiled._replace(domain=compiled.domain._replace(checked=False))
    assert weights_of(open_ended, state, beyond)[0] == kernels.FOUND


def test_currents_off_the_parametrisation_are_beyond_it():
    for name in ("groups", "division"):
        compiled = compiled_case(name)
        off = np.array(CASES[name].domain.middle)
        off[0] += 0.01
        assert weights_of(compiled, new_state(compiled), off)[0] == kernels.BEYOND


def test_terms_are_products_of_terms_before_them():
    terms = expansion_terms(4)
    assert (terms[1:, 0] < np.arange(1, len(terms))).all()
    powers = np.zeros((len(terms), 4), int)
    for k, (parent, signal, degree) in enumerate(terms[1:], 1):
        powers[k] = powers[parent]
        powers[k, signal] += degree
    assert len(np.unique(powers, axis=0)) == len(terms)
    assert np.bincount(powers.sum(axis=1)).tolist() == [1, 4, 10, 20, 35, 56, 84, 120]
    # As many as a solve may evaluate in a microsecond or two, and no degree so high that few signals overfit.
    counts = {signals: len(expansion_terms(signals)) for signals in (1, 2, 3, 6, 8)}
    assert counts == {1: 31, 2: 153, 3: 455, 6: 210, 8: 165}
