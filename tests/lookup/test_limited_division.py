"""The domain of a map's currents in lookups: errors beyond it, its form in the core, and polynomials over it."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.polynomial.chebyshev import Chebyshev

from fieldmap.currents import CoilGroups, CurrentDomain, IndependentCurrents, LiftAndDirections
from fieldmap.lookup import current_solver
from fieldmap.lookup.current_model import CurrentModel
from fieldmap.lookup.current_solver import compiled_domain, degrees_of, expansion_terms, products_of_terms

DIVISION = LiftAndDirections(n=1.25, limit=2.0)
DOMAIN = CurrentDomain(DIVISION, np.array([0.5, -0.4, -0.4]), np.array([2.0, 0.4, 0.4]))


def problem_of(signals, domain=DOMAIN):
    return problem_at(domain.parametrisation.currents(signals), domain)


def problem_at(currents, domain=DOMAIN):
    model = CurrentModel.__new__(CurrentModel)
    model.model, model._names = SimpleNamespace(domain=domain), tuple("123456")
    return model._outside_domain(np.array(currents, float))


def test_a_coil_within_the_limit_is_not_told():
    assert problem_of([1.0, 0.3, 0.3]) is None
    # 1.3 times 1.3 times this is the limit.
    assert problem_of([2.0 / 1.69, 0.3, 0.3]) is None


def test_a_coil_beyond_the_limit_is_named_with_the_limit():
    problem = problem_of([1.5, 0.3, 0.3])
    # The coil at positive x and y, the last of its row, has the largest current.
    assert problem.where == "current of coil 6"
    assert float(problem.received.split()[0]) == pytest.approx(1.5 * 1.3 * 1.3, rel=1e-5)
    assert " 2 A" in problem.must_hold


GROUPS = CurrentDomain(CoilGroups([[0, 2], [1]]), np.array([-1.0, 0.5]), np.array([3.0, 2.5]))
FREE = CurrentDomain(IndependentCurrents(2), np.array([-1.0, 0.5]), np.array([3.0, 2.5]))


@pytest.mark.parametrize(
    ("domain", "currents", "where", "must_hold", "received"),
    [
        (FREE, [3.5, 1.0], "current of coil 1", "currents of the map, -1 to 3 A", "3.5 A"),
        (FREE, [0.0, 0.25], "current of coil 2", "currents of the map, 0.5 to 2.5 A", "0.25 A"),
        (GROUPS, [0.0, 3.0, 0.0], "currents, their group 2", "0.5 to 2.5 A", "3 A"),
        (GROUPS, [0.0, 1.0, 0.1], "currents", "groups = [[0, 2], [1]]", "currents off it by"),
        (DOMAIN, DIVISION.currents([0.25, 0.0, 0.0]), "currents, their u", "0.5 to 2 A", "0.25 A"),
        (DOMAIN, DIVISION.currents([0.6, 0.0, -0.5]), "currents, their y", "-0.4 to 0.4", "-0.5"),
        (DOMAIN, [1.0, 1.0, 1.0, 1.0, 1.0, 2.0], "currents", "n = 1.25, limit = 2.0", "currents off it by"),
    ],
)
def test_what_is_beyond_the_domain_is_named_with_its_range(domain, currents, where, must_hold, received):
    problem = problem_at(currents, domain)
    assert problem.where.startswith(where.split(" group")[0])
    assert must_hold in problem.must_hold
    assert problem.received.startswith(received)
    assert 'outside_currents="evaluate"' in problem.remedy


def test_the_core_takes_the_domain_with_its_rounding():
    """The domain is widened by a billionth of the range at its ends, and of the limit."""
    for checked in (False, True):
        found = compiled_domain(FREE, checked)
        assert (found.checked, found.limit) == (checked, np.inf)
        np.testing.assert_allclose(found.lower - FREE.lower, [-4e-9, -2e-9], rtol=1e-6)
        np.testing.assert_allclose(found.upper - FREE.upper, [4e-9, 2e-9], rtol=1e-6)
    division = compiled_domain(DOMAIN, True)
    assert (division.division, division.exponent) == (True, 1.25)
    assert division.limit == pytest.approx(2.0 * (1.0 + 1e-9), rel=1e-12)
    grouped = compiled_domain(GROUPS, True)
    np.testing.assert_array_equal(grouped.matrix, [[1.0, 0.0], [0.0, 1.0], [1.0, 0.0]])
    np.testing.assert_allclose(grouped[3], [[0.5, 0.0, 0.5], [0.0, 1.0, 0.0]], atol=1e-12)


@pytest.mark.parametrize(
    ("signals", "degree", "count"),
    [(1, 30, 31), (2, 16, 153), (3, 12, 455), (4, 7, 330), (6, 4, 210), (7, 4, 330)],
)
def test_expansions_have_all_products_up_to_a_degree(signals, degree, count):
    """The highest degree with 170 products at most, or 460 up to degree twelve; numbers of products are binomials."""
    terms = expansion_terms(signals)
    assert terms.shape == (count, 3)
    degrees = degrees_of(terms)
    assert (degrees.min(), degrees.max()) == (0, degree)
    # At random signals each product of Chebyshev polynomials occurs once.
    domain = compiled_domain(
        CurrentDomain(IndependentCurrents(signals), np.full(signals, -2.0), np.arange(1.0, signals + 1.0)),
        False,
    )
    rows = np.random.default_rng(signals).uniform(domain.lower, domain.upper, (3, signals))
    found = products_of_terms(terms, rows, domain)
    scaled = 2.0 * (rows - domain.lower) / (domain.upper - domain.lower) - 1.0
    single = [[Chebyshev.basis(n)(column) for n in range(degree + 1)] for column in scaled.T]
    powers = (
        [p for p in itertools.product(range(degree + 1), repeat=signals) if sum(p) <= degree]
        if signals < 5
        else []
    )
    if powers:
        exact = np.array([np.prod([single[k][n] for k, n in enumerate(p)], axis=0) for p in powers]).T
        np.testing.assert_allclose(np.sort(found, axis=1), np.sort(exact, axis=1), atol=1e-12)
    # Beyond the domain the products keep their values at its end.
    np.testing.assert_allclose(products_of_terms(terms, np.array(domain.upper)[None] + 1.0, domain), 1.0)


@pytest.mark.parametrize("dimensions", [1, 2, 3, 6])
def test_states_of_an_expansion_are_those_of_the_generalised_golden_ratio(dimensions):
    """Multiples of the inverse powers of the root of x^(d + 1) = x + 1, by numpy's roots of polynomials."""
    polynomial = np.zeros(dimensions + 2)
    polynomial[[0, -2, -1]] = 1.0, -1.0, -1.0
    roots = np.roots(polynomial)
    x = roots[(np.abs(roots.imag) < 1e-12) & (roots.real > 1.0)].real.item()
    expected = [[k / x**j % 1.0 for j in range(1, dimensions + 1)] for k in range(1, 41)]
    np.testing.assert_allclose(current_solver._spread(40, dimensions), expected, atol=1e-9)


def test_a_range_of_no_width_counts_as_its_end():
    domain = compiled_domain(FREE, False)._replace(lower=np.array([1.0, 0.0]), upper=np.array([1.0, 0.5]))
    terms = np.array([[0, 0, 0], [0, 0, 1], [0, 1, 1]])
    np.testing.assert_allclose(products_of_terms(terms, np.array([[1.0, 0.125]]), domain), [[1.0, 0.0, -0.5]])
