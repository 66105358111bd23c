"""Saturating iron in the C core against its equation in numpy, and its derivative against Taylor's theorem."""

import pickle
from functools import cache

import numpy as np
import pytest
from scipy.optimize import root

from fieldmap.core.iron import BEYOND, FOUND, NOT_FINITE, CoreIron
from fieldmap.core.iron_numbers import core_numbers
from fieldmap.currents import IndependentCurrents
from fieldmap.lookup.current_solver import compiled_model, degrees_of, expansion_terms
from tests.core.iron_cases import CASES, drawn, model, residual


@cache
def numbers_of(name):
    return core_numbers(compiled_model(CASES[name], checked=True))


@pytest.fixture(params=CASES)
def case(request, library):
    """A model, and the same model in the core."""
    return CASES[request.param], CoreIron(numbers_of(request.param))


def count_of(of):
    return of.coil_count + of.field_count + (of.fixed.size > 0)


def weights_of(of, state, currents, tolerance=1e-12, **how):
    weights = np.empty(count_of(of))
    status = state.solve(currents, weights, tolerance=tolerance, **how)
    return status, weights


def test_the_equation_holds(case):
    of, core = case
    state = core.state()
    for currents in drawn(of, 30):
        status, weights = weights_of(of, state, currents, 1e-13)
        assert status == FOUND
        found = state.amplitudes
        exact = root(lambda a, i=currents: residual(of, a, i), found, tol=1e-15).x
        assert np.abs(found - exact).max() < 1e-11 * np.abs(exact).max()
        expected = [*currents, *(of.output @ found), *([1.0] if of.fixed.size else [])]
        np.testing.assert_allclose(weights, expected, rtol=1e-12, atol=1e-14 * np.abs(weights).max())


@cache
def two_hundred_currents():
    """A model with 200 currents, and its numbers for the core."""
    of = model(IndependentCurrents(200), np.full(200, -0.1), np.full(200, 0.1))
    return of, core_numbers(compiled_model(of, checked=True))


def test_the_equation_holds_at_two_hundred_currents():
    of, numbers = two_hundred_currents()
    state = CoreIron(numbers).state()
    for currents in drawn(of, 3):
        status, weights = weights_of(of, state, currents, 1e-13)
        assert status == FOUND
        exact = root(lambda a, i=currents: residual(of, a, i), state.amplitudes, tol=1e-15).x
        np.testing.assert_allclose(weights[200:], of.output @ exact, atol=1e-11 * np.abs(weights).max())


def test_lookups_are_as_exact_as_their_tolerance_and_begin_from_nothing_where_asked(case):
    of, core = case
    used = core.state()
    for currents in drawn(of, 30, 5):
        cold, exact = (weights_of(of, core.state(), currents, tolerance)[1] for tolerance in (1e-4, 1e-12))
        assert np.abs(cold - exact).max() < 1e-3 * np.abs(exact).max()
        # With `fresh` the memory of a state changes nothing.
        np.testing.assert_array_equal(weights_of(of, used, currents, 1e-4, fresh=True)[1], cold)


def test_near_the_last_currents_fewer_steps_are_needed(case):
    of, core = case
    shares = 0.5 + 0.3 * np.sin(np.arange(60)[:, None] / 60 + np.arange(len(of.lower)))
    follower, cold, steps = core.state(), core.state(), []
    for currents in of.domain.at(shares):
        exact = weights_of(of, core.state(), currents, 1e-10)[1]
        found = weights_of(of, follower, currents, 1e-4)[1]
        assert np.abs(found - exact).max() < 1e-3 * np.abs(exact).max()
        weights_of(of, cold, currents, 1e-4, fresh=True)
        steps.append((follower.steps, cold.steps))
    followed, begun_anew = np.mean(steps[3:], axis=0)
    assert followed < 0.8 * begun_anew


def test_terms_are_products_of_terms_before_them():
    terms = expansion_terms(4)
    assert (terms[1:, 0] < np.arange(1, len(terms))).all()
    powers = np.zeros((len(terms), 4), int)
    for k, (parent, signal, degree) in enumerate(terms[1:], 1):
        powers[k] = powers[parent]
        powers[k, signal] += degree
    assert len(np.unique(powers, axis=0)) == len(terms)
    assert np.bincount(powers.sum(axis=1)).tolist() == [1, 4, 10, 20, 35, 56, 84, 120]
    np.testing.assert_array_equal(degrees_of(terms), powers.sum(axis=1))
    # As many terms as a solve evaluates in a microsecond or two, without a degree at which few signals overfit.
    counts = {signals: len(expansion_terms(signals)) for signals in (1, 2, 3, 6, 8)}
    assert counts == {1: 31, 2: 153, 3: 455, 6: 210, 8: 165}


def test_slopes_are_the_derivative_to_second_order(case):
    of, core = case
    (currents,), direction = drawn(of, 1, 8), np.random.default_rng(1).standard_normal(of.coil_count)
    state, here, slopes = core.state(), np.empty(count_of(of)), np.empty((count_of(of), of.coil_count))
    assert state.solve(currents, here, slopes, tolerance=1e-12) == FOUND
    steps = 0.02 * 0.5 ** np.arange(4)
    left = [
        np.linalg.norm(weights_of(of, state, currents + t * direction)[1] - here - t * slopes @ direction)
        for t in steps
    ]
    orders = np.log2(np.array(left[:-1]) / left[1:])
    assert np.all(np.abs(orders - 2.0) < 0.25)


def test_what_has_no_solution_says_so(case):
    of, core = case
    state, middle = core.state(), np.array(of.domain.middle)
    beyond, slopes = 5.0 * of.domain.largest, np.empty((count_of(of), of.coil_count))
    assert weights_of(of, state, middle, checked=True)[0] == FOUND
    for wrong, reason in ((beyond, BEYOND), (np.nan * middle, NOT_FINITE)):
        status, weights = weights_of(of, state, wrong, checked=True)
        assert status == reason
        assert np.isnan(weights).all()
        assert state.solve(wrong, weights, slopes, tolerance=1e-6, checked=True) == reason
        assert np.isnan(slopes).all()
    assert weights_of(of, state, beyond)[0] == FOUND


def test_currents_off_the_parametrisation_are_beyond_it():
    for name in ("groups", "division"):
        state, off = CoreIron(numbers_of(name)).state(), np.array(CASES[name].domain.middle)
        off[0] += 0.01
        assert weights_of(CASES[name], state, off, checked=True)[0] == BEYOND


def test_arrays_that_do_not_fit_are_refused(case):
    of, core = case
    state, middle = core.state(), np.array(of.domain.middle)
    weights, slopes = np.empty(count_of(of)), np.empty((count_of(of), of.coil_count))
    for currents, filled, of_slopes in (
        (middle[:-1], weights, None),
        (middle.tolist(), weights, None),
        (middle, weights[:-1], None),
        (middle, weights.astype(np.float32), None),
        (middle, weights, slopes[:, :-1]),
        (middle, weights, slopes.T),
    ):
        with pytest.raises(TypeError):
            state.solve(currents, filled, of_slopes, tolerance=1e-6)


def test_numbers_that_are_no_model_are_refused():
    good = numbers_of("free")
    # Points, modes, width of a row, coils, knots, terms, signals, all fields, tolerance.
    for place in (0, 1, 2, 3, 7, 8, 9, 12):
        for value in (good[place] + 1.0, -1.0, 0.5, np.nan):
            damaged = good.copy()
            damaged[place] = value
            with pytest.raises(ValueError, match="model"):
                CoreIron(damaged)
    damaged = good.copy()
    damaged[16] = 0.0
    for numbers in (damaged, good[:-1].copy(), good[:10].copy()):
        with pytest.raises(ValueError, match="model"):
            CoreIron(numbers)


def test_a_model_can_be_pickled(case):
    of, core = case
    again = pickle.loads(pickle.dumps(core))
    middle = np.array(of.domain.middle)
    np.testing.assert_array_equal(
        weights_of(of, again.state(), middle)[1], weights_of(of, core.state(), middle)[1]
    )
