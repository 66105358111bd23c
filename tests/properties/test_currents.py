"""Parametrisations of currents for random signals, against sums, matrices and differences."""

import itertools
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fieldmap.currents import (
    CoilGroups,
    CurrentDomain,
    IndependentCurrents,
    LiftAndDirections,
    parametrisation_from_json,
)

amperes = st.floats(-5.0, 5.0)
directions = st.floats(-0.45, 0.45)
lifts = st.floats(0.1, 3.0)
exponents = st.floats(0.5, 2.0)


@st.composite
def groups(draw):
    """Groups that contain every coil once, in any order."""
    count = draw(st.integers(1, 8))
    order = draw(st.permutations(range(count)))
    cuts = sorted(draw(st.sets(st.integers(1, count - 1), max_size=3))) if count > 1 else []
    edges = [0, *cuts, count]
    return tuple(tuple(order[a:b]) for a, b in itertools.pairwise(edges))


@given(lifts, directions, directions, exponents)
def test_lift_and_directions_is_the_division_of_the_thesis(u, x, y, n):
    """(6-2) and (6-3), coil by coil: three coils at x < 0 and three at x > 0, each in order of rising y."""
    left = 6 * u - u * sum((1 + s * x) * (1 + t * y) for s in (-1, 1) for t in (-1, 1))
    exact = []
    for s in (-1, 1):
        exact += [u * (1 + s * x) * (1 - y), left / 2 * (1 + n * s * x), u * (1 + s * x) * (1 + y)]
    found = LiftAndDirections(n).currents([u, x, y])
    assert found == pytest.approx(exact, rel=1e-12)
    assert found.sum() == pytest.approx(6 * u, rel=1e-12)
    assert LiftAndDirections(n).signals(found) == pytest.approx([u, x, y], rel=1e-9, abs=1e-12)


@given(lifts, directions, directions, exponents, st.integers(0, 5), st.floats(0.01, 0.5))
def test_currents_of_no_signals_are_told(u, x, y, n, coil, by):
    """With one coil off by a share of u, the mismatch is the distance to the nearest signals, and `signals` is nan."""
    of = LiftAndDirections(n)
    currents = of.currents([u, x, y])
    currents[coil] += by * u
    found = of.nearest(currents)
    off = np.abs(of.currents(found.values) - currents).max() / abs(currents.mean())
    assert found.mismatch == pytest.approx(off, rel=1e-9, abs=1e-12)
    assert np.isnan(of.signals(currents)).all() == (off > 1e-6)


@given(groups(), st.data())
def test_groups(of_coils, data):
    """A matrix of ones and zeros, written by hand."""
    count = sum(map(len, of_coils))
    signals = np.array(data.draw(st.lists(amperes, min_size=len(of_coils), max_size=len(of_coils))))
    matrix = np.zeros((count, len(of_coils)))
    for k, group in enumerate(of_coils):
        for coil in group:
            matrix[coil, k] = 1.0
    of = CoilGroups(of_coils)
    np.testing.assert_array_equal(of.currents(signals), matrix @ signals)
    np.testing.assert_array_equal(of.derivative(signals), matrix)
    # The nearest signals are the least-squares solution: the mean of each group.
    currents = np.array(data.draw(st.lists(amperes, min_size=count, max_size=count)))
    exact = np.linalg.lstsq(matrix, currents, rcond=None)[0]
    np.testing.assert_allclose(of.nearest(currents).values, exact, atol=1e-12)


@given(st.lists(st.tuples(amperes, amperes), min_size=1, max_size=5), st.data())
def test_a_domain_holds_what_lies_in_its_box(ranges, data):
    lower = np.array([min(pair) for pair in ranges])
    upper = np.array([max(pair) for pair in ranges]) + 0.5
    domain = CurrentDomain(IndependentCurrents(len(ranges)), lower, upper)
    shares = np.array(data.draw(st.lists(st.floats(0.0, 1.0), min_size=len(ranges), max_size=len(ranges))))
    inside = lower + shares * (upper - lower)
    assert domain.holds(inside)
    np.testing.assert_allclose(domain.at(shares), inside, atol=1e-12)
    coil = data.draw(st.integers(0, len(ranges) - 1))
    beyond = inside.copy()
    beyond[coil] = upper[coil] + 0.1
    assert not domain.holds(beyond)
    assert domain.outside(beyond) == coil


@given(
    st.one_of(st.builds(LiftAndDirections, exponents, st.one_of(st.none(), lifts)), groups().map(CoilGroups))
)
def test_there_and_back_as_json(of):
    text = of.to_json()
    again = parametrisation_from_json(text)
    assert again == of
    # The parameters as another program reads them.
    content = json.loads(text)
    if isinstance(of, LiftAndDirections):
        assert content["parameters"]["n"] == of.n
        assert content["parameters"].get("limit") == of.limit
    else:
        assert [sorted(group) for group in content["parameters"]["groups"]] == [sorted(g) for g in of.groups]
