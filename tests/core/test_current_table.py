"""Tables over a current division, against scipy's splines and the checked functions of fieldmap.currents."""

import pickle
from itertools import product

import numpy as np
import pytest
from scipy.interpolate import BSpline, RegularGridInterpolator

from fieldmap.core.current_table import BESIDE, BEYOND, FOUND, CoreTable, Table, signals_of
from fieldmap.currents import LiftAndDirections, divide_currents, undivide_currents
from fieldmap.lookup.current_table import spline_table

LOWER, UPPER, N = np.array([1.0, -0.4, -0.3]), np.array([2.2, 0.4, 0.3]), 1.25


def test_signals_of_currents_are_those_of_the_checked_function():
    rng = np.random.default_rng(1)
    for currents in (*divide_currents(*(LOWER + rng.random((20, 3)) * (UPPER - LOWER)).T, N), rng.random(6)):
        found = undivide_currents(currents, N)
        expected = (found.u, found.x, found.y, found.mismatch)
        np.testing.assert_allclose(signals_of(currents, N), expected, rtol=1e-12, atol=1e-14)
    assert signals_of(np.array([1.0, -1, 2, -2, 3, -3]), N) == (0.0, 0.0, 0.0, np.inf)


@pytest.fixture
def table():
    """Uneven knots, four at each end; uneven nodes; random numbers at both."""
    rng = np.random.default_rng(2)
    inner = (np.array([1.3, 1.4, 1.9]), np.array([-0.1, 0.0, 0.02]), np.array([0.1]))
    apart = (
        np.array([1.2, 1.4, 1.5, 1.7, 1.9]),
        np.array([-0.2, -0.1, 0.0, 0.02, 0.3]),
        np.array([-0.1, 0.1, 0.2]),
    )
    knots = tuple(
        np.concatenate([[low] * 4, between, [high] * 4])
        for low, between, high in zip(LOWER, inner, UPPER, strict=True)
    )
    nodes = tuple(
        np.concatenate([[low], between, [high]])
        for low, between, high in zip(LOWER, apart, UPPER, strict=True)
    )
    coefficients, slopes = rng.standard_normal((7, 7, 5, 3)), rng.standard_normal((7, 7, 5, 6, 3))
    return Table(N, np.inf, 1e-9, LOWER, UPPER, knots, nodes, coefficients, slopes)


def weights_of(table, currents):
    """Status and weights."""
    found = np.empty(6 + table.coefficients.shape[-1])
    return CoreTable(table).weights(currents, found), found


def test_the_weights_are_the_tensor_product_of_b_splines(table):
    rng = np.random.default_rng(3)
    # Rounding may put the signals of a corner just outside.
    wide = table._replace(lower=LOWER - 1e-9, upper=UPPER + 1e-9)
    corners = [(LOWER[0], LOWER[1], LOWER[2]), (UPPER[0], LOWER[1], UPPER[2]), (1.4, 0.0, 0.1)]
    for values in (*corners, *(LOWER + rng.random((20, 3)) * (UPPER - LOWER))):
        bases = [BSpline(t, np.eye(len(t) - 4), 3)(v) for t, v in zip(table.knots, values, strict=True)]
        expected = np.einsum("a,b,c,abck->k", *bases, table.coefficients)
        currents = divide_currents(*values, N)
        status, out = weights_of(wide, currents)
        assert status == FOUND
        np.testing.assert_array_equal(out[:6], currents)
        np.testing.assert_allclose(out[6:], expected, rtol=1e-6, atol=1e-6)


def test_beside_and_beyond_it_the_slopes_go_on_from_the_nearest_division(table):
    wide = table._replace(mismatch=1.0, lower=LOWER - 1e-9, upper=UPPER + 1e-9)
    still = table._replace(slopes=np.zeros((0, 0, 0, 0, 0)))
    aside = 0.01 * np.array([1, -1, 1, -1, 1, -1])
    for signal, to, expected in (
        ((1.63, 0.117, -0.212), aside, BESIDE),
        ((2.3, 0.05, 0.05), 0.0, BEYOND),
        ((1.5, -0.41, 0.25), aside, BEYOND),
    ):
        currents = divide_currents(*signal, N) + to
        found = undivide_currents(currents, N)
        place = np.clip([found.u, found.x, found.y], LOWER, UPPER)
        division = divide_currents(*place, N)
        (found_near, near), (status, out) = weights_of(wide, division), weights_of(table, currents)
        assert (found_near, status) == (FOUND, expected)
        slope = RegularGridInterpolator(table.nodes, table.slopes)(place)[0]
        np.testing.assert_allclose(out[6:], near[6:] + (currents - division) @ slope, rtol=1e-7, atol=1e-9)
        status, without = weights_of(still, currents)
        assert status == expected
        np.testing.assert_allclose(without[6:], near[6:], rtol=1e-6, atol=1e-7)
        np.testing.assert_array_equal(out[:6], currents)


def test_corners_of_the_table_belong_to_it():
    """Their signals follow from currents with rounding; a millionth of the range further is outside."""
    axes = [np.linspace(low, high, 5) for low, high in zip(LOWER, UPPER, strict=True)]
    nothing = np.zeros((5, 5, 5, 3)), np.zeros((5, 5, 5, 6, 3))
    made = spline_table(axes, LiftAndDirections(N), *nothing)
    for shares in product((0.0, 1.0), repeat=3):
        corner = LOWER + shares * (UPPER - LOWER)
        assert weights_of(made, divide_currents(*corner, N))[0] == FOUND
        for beyond in corner + 1e-6 * np.diag((2 * np.array(shares) - 1) * (UPPER - LOWER)):
            assert weights_of(made, divide_currents(*beyond, N))[0] == BEYOND


def test_the_limit_of_a_division_is_that_of_its_table():
    axes = [np.linspace(low, high, 5) for low, high in zip(LOWER, UPPER, strict=True)]
    currents = divide_currents(1.63, 0.117, -0.212, N)
    nothing = np.zeros((5, 5, 5, 3)), np.zeros((5, 5, 5, 6, 3))
    for share, status in ((1.0001, FOUND), (0.9999, BEYOND)):
        divided = LiftAndDirections(N, limit=share * currents.max())
        assert weights_of(spline_table(axes, divided, *nothing), currents)[0] == status


def test_a_coil_above_the_limit_is_beyond_the_table(table):
    currents = divide_currents(1.63, 0.117, -0.212, N)
    found, out = weights_of(table, currents)
    assert found == FOUND
    for limit, expected in ((1.0001, FOUND), (0.9999, BEYOND)):
        status, limited = weights_of(table._replace(limit=limit * currents.max()), currents)
        assert status == expected
        np.testing.assert_allclose(limited, out, rtol=1e-9)


@pytest.mark.parametrize("slopes", [True, False])
def test_no_currents_and_not_a_number_do_no_harm(table, slopes):
    given = table if slopes else table._replace(slopes=np.zeros((0, 0, 0, 0, 0)))
    status, out = weights_of(given, np.zeros(6))
    assert status == BEYOND
    assert np.isfinite(out).all()
    for currents in (np.full(6, np.nan), np.array([np.nan, 1.0, 1.0, 1.0, 1.0, 1.0])):
        status, out = weights_of(given, currents)
        assert status == BEYOND
        assert np.isnan(out[6:]).all()


def test_arrays_that_do_not_fit_are_refused(table):
    for wrong in (
        {"knots": table.knots[::-1]},
        {"nodes": table.knots},
        {"knots": list(table.knots)},
        {"coefficients": table.coefficients[:3]},
        {"coefficients": table.coefficients.astype(np.float32)},
        {"slopes": table.slopes[:, :, :, :5].copy()},
        {"lower": np.zeros(2)},
        {"limit": "none"},
    ):
        with pytest.raises(TypeError):
            CoreTable(table._replace(**wrong))
    with pytest.raises(TypeError):
        CoreTable(table).weights(np.ones(5), np.empty(9))
    with pytest.raises(TypeError):
        CoreTable(table).weights(np.ones(6), np.empty(8))


def test_a_table_is_pickled(table):
    currents = divide_currents(1.63, 0.117, -0.212, N)
    again = pickle.loads(pickle.dumps(CoreTable(table)))
    np.testing.assert_array_equal(weights_of(again.numbers, currents)[1], weights_of(table, currents)[1])
