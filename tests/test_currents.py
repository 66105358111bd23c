"""Current parametrisations: (6-2), (6-3) as printed, the directions of Table 6-1, derivatives, inverses, and the
stored form."""

import numpy as np
import pytest

from fieldmap.control import divide_currents, division_slopes, undivide_currents
from fieldmap.core import current_table
from fieldmap.currents import (
    CoilGroups,
    CurrentDomain,
    CurrentParametrisation,
    IndependentCurrents,
    LiftAndDirections,
    parametrisation,
    parametrisation_from_json,
    register,
)
from fieldmap.errors import InputError

GROUPS = CoilGroups(((0, 2), (1, 3), (4,)))
ALL = [IndependentCurrents(4), GROUPS, LiftAndDirections(1.25)]


def printed(u, x, y, n):
    total = 6 * u
    u1 = total * (1 - x) * (1 - y) / 6
    u3 = total * (1 - x) * (1 + y) / 6
    u4 = total * (1 + x) * (1 - y) / 6
    u6 = total * (1 + x) * (1 + y) / 6
    left = total - u1 - u3 - u4 - u6
    return [u1, left * (1 - n * x) / 2, u3, u4, left * (1 + n * x) / 2, u6]


@pytest.mark.parametrize("n", [1.0, 1.25, 1.5])
def test_as_printed(n):
    rng = np.random.default_rng(1)
    for u, x, y in rng.uniform(-0.5, 0.5, (20, 3)) + [1.5, 0, 0]:
        np.testing.assert_allclose(divide_currents(u, x, y, n), printed(u, x, y, n), rtol=1e-13)


def test_sums_are_preserved():
    signals = np.random.default_rng(2).uniform(-0.5, 0.5, (3, 7))
    currents = divide_currents(1.558 + signals[0], signals[1], signals[2], n=1.25)
    assert currents.shape == (7, 6)
    np.testing.assert_allclose(currents.sum(axis=-1), 6 * (1.558 + signals[0]), rtol=1e-13)
    np.testing.assert_allclose(currents[:, [1, 4]].sum(axis=-1), 2 * (1.558 + signals[0]), rtol=1e-13)


@pytest.mark.parametrize(
    ("x", "y", "more", "less"),
    [
        (0.2, 0.0, {4, 5, 6}, {1, 2, 3}),
        (-0.2, 0.0, {1, 2, 3}, {4, 5, 6}),
        (0.0, 0.2, {3, 6}, {1, 4}),
        (0.0, -0.2, {1, 4}, {3, 6}),
    ],
)
def test_directions_of_table_6_1(x, y, more, less):
    change = divide_currents(1.0, x, y, n=1.25) - 1.0
    assert {k + 1 for k in range(6) if change[k] > 1e-12} == more
    assert {k + 1 for k in range(6) if change[k] < -1e-12} == less


@pytest.mark.parametrize("n", [1.0, 1.25, 1.5])
def test_inverse(n):
    signals = np.random.default_rng(3).uniform(-0.5, 0.5, (3, 4, 5))
    found = undivide_currents(divide_currents(1.5 + signals[0], signals[1], signals[2], n), n)
    np.testing.assert_allclose(found.u, 1.5 + signals[0], rtol=1e-13)
    np.testing.assert_allclose(found.x, signals[1], atol=1e-13)
    np.testing.assert_allclose(found.y, signals[2], atol=1e-13)
    assert found.mismatch.max() < 1e-13


@pytest.mark.parametrize("n", [1.0, 1.25])
def test_slopes_are_derivatives(n):
    """Taylor test: the remainder falls with the square of the step."""
    at, direction = np.array([1.5, 0.2, -0.1]), np.array([0.3, 0.5, -0.7])

    def rest(h):
        return np.abs(divide_currents(*(at + h * direction), n) - divide_currents(*at, n) - h * slopes).max()

    slopes = division_slopes(*at, n) @ direction
    assert 1.9 < np.log2(rest(0.1) / rest(0.05)) < 2.1
    assert rest(1e-4) < 1e-7


def test_currents_that_are_no_division_are_told():
    found = undivide_currents([1.0, 1.3, 1.0, 1.0, 1.3, 1.0])
    assert found.x == pytest.approx(0.0)
    assert found.mismatch == pytest.approx(0.2 / 1.1)


@pytest.mark.parametrize(
    "broken",
    [
        lambda: divide_currents(np.nan, 0.0, 0.0),
        lambda: divide_currents(1.0, 0.0, 0.0, n=0.0),
        lambda: undivide_currents([1.0, 2.0]),
        lambda: undivide_currents(np.zeros(6)),
        lambda: undivide_currents([1.0, 1.0, np.inf, 1.0, 1.0, 1.0]),
    ],
)
def test_bad_input(broken):
    with pytest.raises(InputError):
        broken()


def signals_of(of, *shape):
    values = np.random.default_rng(5).uniform(-0.5, 0.5, (*shape, of.signal_count))
    return values + 1.5 * (np.arange(of.signal_count) == 0)


@pytest.mark.parametrize("of", ALL)
def test_signals_are_found_again(of):
    signals = signals_of(of, 3, 5)
    currents = of.currents(signals)
    assert currents.shape == (3, 5, of.coil_count)
    assert len(of.signal_names) == len(of.signal_units) == of.signal_count
    np.testing.assert_allclose(of.signals(currents), signals, atol=1e-13)
    assert of.nearest(currents).mismatch == pytest.approx(np.zeros((3, 5)), abs=1e-13)


@pytest.mark.parametrize("of", ALL)
def test_derivatives_by_the_signals(of):
    """Taylor test: the remainder falls with the square of the step, or is rounding if currents are linear."""
    at, direction = signals_of(of, 7), 0.5 * signals_of(of, 7)

    def left(h):
        change = np.einsum("scd,sd->sc", of.derivative(at), h * direction)
        return np.abs(of.currents(at + h * direction) - of.currents(at) - change).max()

    assert left(0.1) < 1e-14 or 1.9 < np.log2(left(0.1) / left(0.05)) < 2.1
    assert left(1e-5) < 1e-9


@pytest.mark.parametrize("of", ALL)
def test_name_and_parameters_make_it_again(of):
    assert parametrisation_from_json(of.to_json()) == of
    assert parametrisation(of.name, of.parameters) == of


@pytest.mark.parametrize("of", ALL)
def test_the_core_takes_the_same_currents(of):
    kernel, signals = of.kernel(), signals_of(of)
    if kernel.division:
        *found, mismatch = current_table.signals_of(of.currents(signals), kernel.exponent)
        np.testing.assert_allclose(found, signals, rtol=1e-13)
        assert mismatch < 1e-14
    else:
        np.testing.assert_allclose(kernel.matrix @ signals, of.currents(signals), rtol=1e-13)


def test_currents_without_signals_give_nan_and_say_by_how_much():
    of = LiftAndDirections(1.25)
    currents = np.array([of.currents([1.5, 0.1, 0.2]), [1.0, 1.3, 1.0, 1.0, 1.3, 1.0], np.zeros(6)])
    assert np.isnan(of.signals(currents)).tolist() == [[False] * 3, [True] * 3, [True] * 3]
    assert of.nearest(currents).mismatch[1:].tolist() == [pytest.approx(0.2 / 1.1), np.inf]
    found = GROUPS.nearest([1.0, 2.0, 1.5, 2.0, 4.0])
    assert found.values.tolist() == [1.25, 2.0, 4.0]
    assert found.mismatch == pytest.approx(0.25 / 4.0)
    assert np.isnan(GROUPS.signals([1.0, 2.0, 1.5, 2.0, 4.0])).all()


@pytest.mark.parametrize("of", ALL)
def test_largest_currents_of_a_domain(of):
    lower, upper = signals_of(of) - 0.7, signals_of(of) + 0.4
    domain = CurrentDomain(of, lower, upper)
    inside = domain.at(np.random.default_rng(6).random((400, of.signal_count)))
    assert (np.abs(inside) <= domain.largest + 1e-15).all()
    assert (np.abs(inside).max(axis=0) > 0.8 * domain.largest).all()
    assert domain.holds(domain.middle)
    assert domain.holds(inside[0])
    assert not domain.holds(of.currents(upper + 0.1))
    assert domain.outside(upper + 0.1 * (np.arange(of.signal_count) == 1)) == 1


@pytest.mark.parametrize(
    "broken",
    [
        lambda: parametrisation("unknown", {}),
        lambda: parametrisation("groups", {"n": 1.0}),
        lambda: CoilGroups(((0, 1), (1, 2))),
        lambda: CoilGroups(((0, 2),)),
        lambda: CoilGroups(()),
        lambda: IndependentCurrents(0),
        lambda: LiftAndDirections(-1.0),
        lambda: GROUPS.currents([1.0, 2.0]),
        lambda: IndependentCurrents(3).signals([1.0, 2.0, np.nan]),
    ],
)
def test_what_is_no_parametrisation(broken):
    with pytest.raises(InputError):
        broken()


def test_a_name_is_taken_once():
    class Another(CurrentParametrisation):
        name = "groups"

    with pytest.raises(ValueError, match="groups"):
        register(Another)


@pytest.mark.parametrize(
    ("kind", "lower", "upper", "largest"),
    [
        # At most u = 2 A with all coils equal, although single coils carry more with x and y.
        (LiftAndDirections(1.25), (1.0, -0.4, -0.4), (2.0, 0.4, 0.4), 2.0),
        (LiftAndDirections(1.25, 1.8), (1.0, -0.4, -0.4), (2.0, 0.4, 0.4), 1.8),
        (LiftAndDirections(1.25), (1.0, 0.1, -0.4), (2.0, 0.4, 0.4), None),
        (IndependentCurrents(2), (0.5, -1.0), (2.0, 3.0), 2.0),
        (IndependentCurrents(2), (0.0, 5.0), (1.0, 6.0), None),
        (CoilGroups([[0, 2], [1]]), (-10.0, -4.0), (10.0, 4.0), 4.0),
    ],
)
def test_the_largest_current_that_all_coils_may_carry(kind, lower, upper, largest):
    found = CurrentDomain(kind, np.array(lower), np.array(upper)).largest_equal_current()
    assert found == (None if largest is None else pytest.approx(largest, rel=1e-8))
