"""Quadrature rules integrate monomials exactly: int x^a y^b (z^c) over the unit simplex is a ratio of factorials."""

from itertools import product
from math import factorial

import pytest

from fieldmap.kernels.simplex_rules import tetrahedron_rule, triangle_rule


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5, 6, 8, 14])
def test_triangle(degree):
    points, weights = triangle_rule(degree)
    assert points.sum(axis=1) == pytest.approx(1.0)
    for a, b in product(range(degree + 1), repeat=2):
        if a + b <= degree:
            exact = 2 * factorial(a) * factorial(b) / factorial(a + b + 2)
            assert weights @ (points[:, 1] ** a * points[:, 2] ** b) == pytest.approx(exact, rel=1e-12)


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5, 7])
def test_tetrahedron(degree):
    points, weights = tetrahedron_rule(degree)
    for a, b, c in product(range(degree + 1), repeat=3):
        if a + b + c <= degree:
            exact = 6 * factorial(a) * factorial(b) * factorial(c) / factorial(a + b + c + 3)
            value = weights @ (points[:, 1] ** a * points[:, 2] ** b * points[:, 3] ** c)
            assert value == pytest.approx(exact, rel=1e-12)


def test_a_rule_of_too_low_degree_is_not_exact():
    points, weights = triangle_rule(2)
    assert weights @ points[:, 1] ** 4 != pytest.approx(2 * 24 / 720, rel=1e-3)
