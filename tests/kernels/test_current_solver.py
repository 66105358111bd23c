"""The compiled model of saturating iron against equations in numpy, and its derivative by Taylor's theorem."""

from functools import cache

import numpy as np
import pytest
from numba.core import config
from scipy.optimize import root

from fieldmap.kernels.map import current_solver as kernels
from fieldmap.kernels.map.current_solver import current_slopes, current_weights
from fieldmap.lookup import current_solver as expansion
from fieldmap.lookup.current_solver import compiled_model, expansion_terms, new_state
from tests.core.iron_cases import CASES, DRAWN, drawn, residual


@cache
def compiled_case(name):
    with pytest.MonkeyPatch.context() as patch:
        if config.DISABLE_JIT:
            # A full expansion is fitted to thousands of states.
            patch.setattr(expansion, "_MOST_OF_LOW_DEGREE", 100)
            patch.setattr(expansion, "_MOST_TERMS", 100)
        return compiled_model(CASES[name], checked=True)


@pytest.fixture(params=CASES)
def case(request):
    """A model, and what is compiled of it."""
    return CASES[request.param], compiled_case(request.param)


def weights_of(compiled, state, currents, tolerance=None):
    out = np.empty(len(state.weights))
    used = compiled if tolerance is None else compiled._replace(tolerance=tolerance)
    return current_weights(used, state, currents, out), out


def test_the_equation_holds(case):
    of, compiled = case
    state = new_state(compiled)
    for currents in drawn(of, DRAWN):
        status, out = weights_of(compiled, state, currents, 1e-13)
        assert status == kernels.FOUND
        found = state.amplitudes[-1]
        exact = root(lambda a, i=currents: residual(of, a, i), found, tol=1e-15).x
        assert np.abs(found - exact).max() < 1e-11 * np.abs(exact).max()
        expected = [*currents, *(of.output @ found), *([1.0] if of.fixed.size else [])]
        np.testing.assert_allclose(out, expected, rtol=1e-12, atol=1e-14 * np.abs(out).max())


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


def test_slopes_are_the_derivative_to_second_order(case):
    of, compiled = case
    exact = compiled._replace(tolerance=1e-12, domain=compiled.domain._replace(checked=False))
    (currents,), direction = drawn(of, 1, 8), np.random.default_rng(1).standard_normal(of.coil_count)
    state = new_state(exact)
    here, slopes = np.empty(len(state.weights)), np.empty((len(state.weights), of.coil_count))
    assert current_slopes(exact, state, currents, here, slopes) == kernels.FOUND
    steps = 0.02 * 0.5 ** np.arange(4)
    left = [
        np.linalg.norm(weights_of(exact, state, currents + t * direction)[1] - here - t * slopes @ direction)
        for t in steps
    ]
    orders = np.log2(np.array(left[:-1]) / left[1:])
    assert np.all(np.abs(orders - 2.0) < 0.25)


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
