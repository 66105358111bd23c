"""The tricubic Hermite form in the C core against polynomials, harmonic functions and Taylor's theorem."""

import itertools

import numpy as np
import pytest

from fieldmap.core import CoreMap
from fieldmap.core.block import HERMITE
from fieldmap.interpolants.form import header
from fieldmap.interpolants.hermite import difference_weights, nodal_coefficients
from fieldmap.store import Grid

LOWER = np.array([-0.3, 0.2, 1.0])
SPACING = np.array([0.11, 0.07, 0.13])


def nodes(lower, spacing, shape):
    axes = [lower[a] + np.arange(shape[a]) * spacing[a] for a in range(3)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def sampled(function, shape, lower=LOWER, spacing=SPACING):
    """Coefficients of a one-channel function given as f(x, y, z, dx, dy, dz) with orders of derivative."""
    x, y, z = np.moveaxis(nodes(lower, spacing, shape), -1, 0)
    values = function(x, y, z, 0, 0, 0)[..., None]
    slopes = np.stack([function(x, y, z, *order) for order in np.eye(3, dtype=int)], axis=-1)[..., None, :]
    return nodal_coefficients(values, np.ascontiguousarray(slopes), spacing)


def evaluated(coefficients, points, lower=LOWER, spacing=SPACING):
    """Values (n, c), gradient (n, c, 3), second gradient (n, c, 3, 3) and the count of points outside: channels as the
    components of a field, and the first as a potential, too."""
    n, channels, shape = len(points), coefficients.shape[3], coefficients.shape[:3]
    start = header(HERMITE, Grid(lower, spacing, shape), 1, "nan")
    field = np.zeros((*shape, 3, 8))
    field[..., :channels, :] = coefficients
    of_field = CoreMap(np.concatenate([start, field.ravel()]))
    of_potential = CoreMap(np.concatenate([start, coefficients[..., 0, :].ravel()]), components=1)
    values, slopes = np.empty((n, 3)), np.empty((n, 3, 3))
    bends, potential = np.empty((n, 3, 3, 3)), np.empty(n)
    outside = of_field.fields(points, None, values, slopes)
    assert of_field.second_gradients(points, None, bends) == outside
    assert of_potential.potentials(points, None, potential) == outside
    np.testing.assert_allclose(-potential, values[:, 0], rtol=1e-12, atol=1e-12)
    return values[:, :channels], slopes[:, :channels], bends[:, :channels], outside


def random_points(n, shape, seed=0, lower=LOWER, spacing=SPACING):
    return lower + np.random.default_rng(seed).random((n, 3)) * (np.array(shape) - 1) * spacing


def polynomial(seed):
    """Random polynomial of degree 3 in each variable, with its derivatives."""
    coefficients = np.random.default_rng(seed).normal(size=(4, 4, 4))

    def function(x, y, z, dx, dy, dz):
        derived = coefficients
        for axis, order in enumerate((dx, dy, dz)):
            derived = np.polynomial.polynomial.polyder(derived, order, axis=axis) if order else derived
        return np.polynomial.polynomial.polyval3d(x, y, z, derived)

    return function


def harmonic(x, y, z, dx, dy, dz):
    """exp(2.5 z) sin(1.5 x + 0.3) cos(2 y), with its derivatives."""
    quarter = np.pi / 2
    return (
        2.5**dz
        * np.exp(2.5 * z)
        * 1.5**dx
        * np.sin(1.5 * x + 0.3 + dx * quarter)
        * 2.0**dy
        * np.cos(2 * y + dy * quarter)
    )


ORDERS = np.eye(3, dtype=int)


@pytest.mark.parametrize("n", [2, 3, 4, 5])
def test_difference_weights_are_exact_on_polynomials(n):
    weights = difference_weights(n)
    i = np.arange(n, dtype=float)
    for degree in range(n):
        exact = degree * i ** max(degree - 1, 0)
        np.testing.assert_allclose(weights @ i**degree, exact, atol=1e-12)
    assert not np.allclose(weights @ i**n, n * i ** (n - 1))


@pytest.mark.parametrize("shape", [(4, 5, 6), (7, 4, 5)])
def test_reproduces_cubics_everywhere(shape):
    function = polynomial(1)
    points = random_points(60, shape)
    x, y, z = points.T
    values, slopes, bends, outside = evaluated(sampled(function, shape), points)
    assert outside == 0
    np.testing.assert_allclose(values[:, 0], function(x, y, z, 0, 0, 0), rtol=0, atol=1e-11)
    for i in range(3):
        np.testing.assert_allclose(slopes[:, 0, i], function(x, y, z, *ORDERS[i]), rtol=0, atol=1e-9)
        for j in range(3):
            exact = function(x, y, z, *(ORDERS[i] + ORDERS[j]))
            np.testing.assert_allclose(bends[:, 0, i, j], exact, rtol=0, atol=1e-7)


def test_does_not_reproduce_quartics():
    values = evaluated(
        sampled(lambda x, y, z, dx, dy, dz: [x**4, 4 * x**3][dx] * (dy + dz == 0), (5, 5, 5)),
        points := random_points(20, (5, 5, 5)),
    )[0]
    assert np.abs(values[:, 0] - points[:, 0] ** 4).max() > 1e-8


def test_nodes_give_values_and_gradients_back():
    shape = (5, 6, 4)
    coefficients = sampled(harmonic, shape)
    points = nodes(LOWER, SPACING, shape).reshape(-1, 3)
    x, y, z = points.T
    values, slopes, _, outside = evaluated(coefficients, points)
    assert outside == 0
    np.testing.assert_allclose(values[:, 0], harmonic(x, y, z, 0, 0, 0), rtol=1e-11, atol=1e-9)
    for i in range(3):
        np.testing.assert_allclose(slopes[:, 0, i], harmonic(x, y, z, *ORDERS[i]), rtol=1e-9, atol=1e-7)


def errors_at(n):
    """Largest errors of value, gradient and second gradient on the unit-sized box with n cells an axis.

    Taken in the cells at corners, edges, faces and centre, at the places in a cell where each error peaks.
    """
    shape, lower, spacing = (n + 1,) * 3, np.array([-0.5, -0.5, -1.0]), np.full(3, 1.0 / n)
    cells = np.array(list(itertools.product((0, n // 2, n - 1), repeat=3)))
    places = np.array(list(itertools.product((0.01, 0.211, 0.5), repeat=3)))
    points = lower + (cells[:, None, :] + places).reshape(-1, 3) * spacing
    x, y, z = points.T
    values, slopes, bends, _ = evaluated(sampled(harmonic, shape, lower, spacing), points, lower, spacing)
    of_value = np.abs(values[:, 0] - harmonic(x, y, z, 0, 0, 0)).max()
    of_slope = max(np.abs(slopes[:, 0, i] - harmonic(x, y, z, *ORDERS[i])).max() for i in range(3))
    of_bend = max(
        np.abs(bends[:, 0, i, j] - harmonic(x, y, z, *(ORDERS[i] + ORDERS[j]))).max()
        for i in range(3)
        for j in range(3)
    )
    return np.array([of_value, of_slope, of_bend])


def test_converges_at_the_stated_orders():
    sizes = np.array([8, 12, 16])
    errors = np.array([errors_at(n) for n in sizes])
    slopes = -np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert np.all(slopes > [3.8, 2.8, 1.8])
    # Hermite's remainder on an interval: h^4/384, sqrt(3) h^3/216 and h^2/12 times the largest fourth derivative;
    # here that is 2.5^4 along z, 2^4 along y, 1.5^4 along x, and the three axes add up.
    fourth, h = 2.5**4 + 2**4 + 1.5**4, 1 / sizes[-1]
    bounds = fourth * np.array([h**4 / 384, np.sqrt(3) * h**3 / 216, h**2 / 12])
    assert np.all(errors[-1] < bounds)


def test_boundary_cells_are_as_good_as_the_inner_ones():
    # sin(x + y + z) has derivatives of the same size everywhere, so only the method could make a difference.
    def wave(x, y, z, dx, dy, dz):
        return 3.0 ** (dx + dy + dz) * np.sin(3 * (x + y + z) + (dx + dy + dz) * np.pi / 2)

    shape, lower, spacing = (10, 10, 10), np.zeros(3), np.full(3, 0.1)
    coefficients = sampled(wave, shape, lower, spacing)
    points = random_points(1500, shape, 5, lower, spacing)
    values, slopes, _, _ = evaluated(coefficients, points, lower, spacing)
    x, y, z = points.T
    error = np.abs(values[:, 0] - wave(x, y, z, 0, 0, 0))
    slope_error = np.abs(slopes[:, 0, 0] - wave(x, y, z, 1, 0, 0))
    inner = np.all((points > 0.1) & (points < 0.8), axis=1)
    assert error[~inner].max() < 1.1 * error[inner].max()
    assert slope_error[~inner].max() < 1.1 * slope_error[inner].max()


def test_gradient_is_the_derivative_of_the_value():
    # Taylor: the remainder of value(x + e d) - value(x) - e gradient.d falls as e^2, inside one cell.
    rng = np.random.default_rng(2)
    coefficients = rng.normal(size=(4, 4, 4, 2, 8))
    centres = LOWER + (rng.integers(0, 3, (30, 3)) + 0.5) * SPACING
    direction = rng.normal(size=(30, 3)) * SPACING / 4
    values, slopes, bends, _ = evaluated(coefficients, centres)
    steps = np.array([1e-1, 1e-2, 1e-3])
    first, second = [], []
    for step in steps:
        moved, moved_slopes, _, _ = evaluated(coefficients, centres + step * direction)
        predicted = values + step * np.einsum("nci,ni->nc", slopes, direction)
        first.append(np.abs(moved - predicted).max())
        predicted = slopes + step * np.einsum("ncij,nj->nci", bends, direction)
        second.append(np.abs(moved_slopes - predicted).max())
    for remainders in (first, second):
        assert np.polyfit(np.log(steps), np.log(remainders), 1)[0] == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_value_and_gradient_are_continuous_across_cell_faces(axis):
    rng = np.random.default_rng(4)
    coefficients = rng.normal(size=(4, 4, 4, 1, 8))
    points = random_points(50, (4, 4, 4), 6)
    points[:, axis] = LOWER[axis] + rng.integers(1, 3, 50) * SPACING[axis]
    step = np.zeros(3)
    step[axis] = 1e-9 * SPACING[axis]
    before, after = evaluated(coefficients, points - step), evaluated(coefficients, points + step)
    np.testing.assert_allclose(before[0], after[0], atol=1e-6)
    np.testing.assert_allclose(before[1], after[1], atol=1e-5)
    assert np.abs(before[2] - after[2]).max() > 1.0  # the second gradient jumps, as said


def test_outside_and_nan_give_nan_and_only_outside_is_counted():
    shape = (4, 4, 4)
    coefficients = sampled(polynomial(1), shape)
    inside = LOWER + SPACING
    points = np.tile(inside, (10, 1))
    top = LOWER + 3 * SPACING
    points[1, 0] = LOWER[0] - 1e-3
    points[2, 1] = top[1] + 1e-3
    points[3, 2] = np.inf
    points[4, 2] = -1e300
    points[5, 0] = np.nan
    points[6] = [np.nan, 1e9, 0.0]
    points[7] = top * (1 + 1e-15)
    points[8] = LOWER - 1e-13
    values, slopes, bends, outside = evaluated(coefficients, points)
    # Infinity lies nowhere.
    assert outside == 3
    bad = np.isnan(values[:, 0])
    assert bad.tolist() == [False, True, True, True, True, True, True, False, False, False]
    assert np.isnan(slopes[bad]).all()
    assert np.isnan(bends[bad]).all()
    assert np.isfinite(slopes[~bad]).all()
    assert np.isfinite(bends[~bad]).all()
