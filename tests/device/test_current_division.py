"""The current division against (6-2), (6-3) as printed, the directions of Table 6-1, and its inverse."""

import numpy as np
import pytest

from fieldmap.control import divide_currents, division_slopes, undivide_currents
from fieldmap.errors import InputError


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
    """Taylor test: what is left falls with the square of the step."""
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
