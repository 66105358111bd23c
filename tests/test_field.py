"""Fields: currents of every kind, completed fields, second gradients and wrenches by default."""

from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.errors import InputError
from fieldmap.field import Field, FieldAtCurrents, as_field, coil_currents

NAMES = ("left", "right")


class Quadratic(Field):
    """B = current[0] (x^2 - y^2, -2 x y, 0) + current[1] (0, 0, 1) exp(...) of degree two: harmonic, known exactly."""

    coil_names = NAMES

    def field(self, points, currents):
        i = coil_currents(currents, NAMES)
        x, y, z = np.atleast_2d(points).T
        first = np.stack([x**2 - y**2, -2 * x * y, 0 * z], axis=1)
        second = np.stack([2 * x * z, -2 * y * z, x**2 - y**2], axis=1)
        return i[0] * first + i[1] * second

    def gradient(self, points, currents):
        i = coil_currents(currents, NAMES)
        x, y, z = np.atleast_2d(points).T
        o = 0 * x
        first = np.array([[2 * x, -2 * y, o], [-2 * y, -2 * x, o], [o, o, o]])
        second = np.array([[2 * z, o, 2 * x], [o, -2 * z, -2 * y], [2 * x, -2 * y, o]])
        return np.moveaxis(i[0] * first + i[1] * second, 2, 0)


class Duck:
    """The least that a user has to write."""

    coil_names = NAMES

    def field(self, points, currents):
        return Quadratic().field(points, currents)

    def gradient(self, points, currents):
        return Quadratic().gradient(points, currents)


class Pair:
    """Field and gradient in one pass, as from a program that sums over dipoles."""

    coil_names = NAMES

    def field_and_gradient(self, points, currents):
        return Quadratic().field(points, currents), Quadratic().gradient(points, currents)


POINTS = np.random.default_rng(3).normal(size=(7, 3))


@pytest.mark.parametrize("given", [[2.0, 2.0], 2, 2.0, np.full(2, 2.0), {"right": 2, "left": 2}])
def test_currents_of_every_kind_are_the_same_currents(given):
    assert np.array_equal(coil_currents(given, NAMES), [2.0, 2.0])


@pytest.mark.parametrize(
    "given",
    [[1.0], [1.0, 2.0, 3.0], [1.0, np.nan], np.inf, {"left": None}, {"left": 1, "up": 2}, "two", None],
)
def test_what_is_no_set_of_currents_is_refused(given):
    with pytest.raises(InputError) as caught:
        coil_currents(given, NAMES)
    assert caught.value.problems[0].where == "currents"


def test_currents_by_name_follow_the_coils_not_the_alphabet_nor_the_mapping():
    assert coil_currents({"6": 2.0, "3": 3.0, "5": 1.0}, ("5", "6", "3")).tolist() == [1.0, 2.0, 3.0]


def test_currents_for_each_point_only_where_they_are_welcome():
    each = np.ones((7, 2))
    assert coil_currents(each, NAMES, points=7).shape == (7, 2)
    with pytest.raises(InputError):
        coil_currents(each, NAMES)


@pytest.mark.parametrize("make", [Quadratic, lambda: as_field(Duck()), lambda: as_field(Pair())])
def test_defaults_agree_with_the_closed_form(make):
    field = make()
    assert isinstance(field, Field)
    known = Quadratic()
    for found, wanted in zip(
        field.field_and_gradient(POINTS, [1.5, -0.5]),
        known.field_and_gradient(POINTS, [1.5, -0.5]),
        strict=True,
    ):
        assert np.array_equal(found, wanted)
    assert np.array_equal(field.field(POINTS, 2.0), known.field(POINTS, 2.0))
    assert np.array_equal(field.gradient(POINTS, 2.0), known.gradient(POINTS, 2.0))
    fixed = field.at({"left": 1.5, "right": -0.5})
    assert isinstance(fixed, FieldAtCurrents)
    second = fixed.second_gradient(POINTS)
    # d2B_x/dx2, d2B_y/dxdy, d2B_x/dxdz, d2B_y/dydz of the two polynomials
    expected = {(0, 0, 0): 3.0, (1, 0, 1): -3.0, (0, 0, 2): -1.0, (1, 1, 2): 1.0, (2, 2, 2): 0.0}
    for index, value in expected.items():
        assert second[:, *index] == pytest.approx(value, abs=1e-7)
    assert np.allclose(second, np.swapaxes(second, 2, 3), atol=1e-7)


def test_wrench_is_gradient_and_cross_product():
    field, moment = Quadratic(), np.array([0.3, -0.2, 0.9])
    wrench = field.wrench(POINTS, moment, 1.0)
    flux, slope = field.field(POINTS, 1.0), field.gradient(POINTS, 1.0)
    assert wrench[:, :3] == pytest.approx(np.array([g.T @ moment for g in slope]))
    assert wrench[:, 3:] == pytest.approx(np.cross(moment, flux))
    assert field.wrench(POINTS[0], moment, 1.0) == pytest.approx(wrench[0])


def test_a_box_is_asked_for_where_one_is_needed():
    with pytest.raises(InputError):
        _ = Quadratic().lower
    boxed = as_field(Duck(), (np.zeros(3), np.ones(3)))
    assert np.array_equal(boxed.upper, np.ones(3))


def test_an_object_that_is_no_field_is_refused():
    with pytest.raises(InputError):
        as_field(object())
    with pytest.raises(InputError):
        as_field(SimpleNamespace(coil_names=NAMES, field=Duck().field))
    with pytest.raises(InputError):
        as_field(SimpleNamespace(field_and_gradient=Pair().field_and_gradient))
