"""Field, gradient and second gradient of an opened map against closed forms and magpylib."""

import magpylib
import numpy as np
import pytest

CURRENTS = np.array([1.5, -0.7, 2.0])


def magpylib_field(dipoles, currents, points):
    sources = [
        magpylib.misc.Dipole(moment=current * moment, position=source)
        for current, moment, source in zip(currents, dipoles.moments, dipoles.sources, strict=True)
    ]
    return magpylib.getB(sources, points, sumup=True)


def exact_gradient(dipoles, currents, points):
    parts = zip(currents, dipoles.moments, dipoles.sources, strict=True)
    return sum(current * dipoles.gradient(moment, source, points) for current, moment, source in parts)


def test_closed_forms_of_the_test_itself(dipoles):
    points = dipoles.points(20)
    expected = magpylib_field(dipoles, CURRENTS, points)
    parts = zip(CURRENTS, dipoles.moments, dipoles.sources, strict=True)
    ours = sum(current * dipoles.field(moment, source, points) for current, moment, source in parts)
    np.testing.assert_allclose(ours, expected, rtol=1e-9)
    step = 1e-6
    for j in range(3):
        shift = step * np.eye(3)[j]
        ahead, behind = (magpylib_field(dipoles, CURRENTS, points + s * shift) for s in (1, -1))
        difference = (ahead - behind) / (2 * step)
        ours = exact_gradient(dipoles, CURRENTS, points)[..., j]
        np.testing.assert_allclose(ours, difference, atol=1e-6 * np.abs(difference).max())


def test_field_agrees_with_magpylib(fine, dipoles):
    points = dipoles.points(300)
    expected = magpylib_field(dipoles, CURRENTS, points)
    error = np.abs(fine.field(points, CURRENTS) - expected).max()
    assert error < 2e-6 * np.abs(expected).max()


def test_gradient_agrees_with_the_closed_form(fine, dipoles):
    points = dipoles.points(300)
    expected = exact_gradient(dipoles, CURRENTS, points)
    error = np.abs(fine.gradient(points, CURRENTS) - expected).max()
    assert error < 5e-5 * np.abs(expected).max()


def test_convergence_of_field_and_gradient(dipoles):
    from fieldmap.lookup import interpolate

    sizes = np.array([14, 20, 28])
    errors = []
    for n in sizes:
        opened = interpolate(dipoles.map(n), kind="hermite")
        # The same places in the cells nearest to and farthest from the dipoles, where the error peaks.
        places = np.stack(np.meshgrid(*[[0.2, 0.5]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        cells = np.array([[0, 0, 0], [n // 2, n // 2, n - 1], [n - 1, n - 1, n - 1]])
        points = dipoles.lower + (cells[:, None] + places).reshape(-1, 3) * opened.info.grid.spacing
        of_field = np.abs(opened.field(points, CURRENTS) - magpylib_field(dipoles, CURRENTS, points)).max()
        exact = exact_gradient(dipoles, CURRENTS, points)
        slope = opened.gradient(points, CURRENTS)
        of_harmonicity = np.abs(np.trace(slope, axis1=1, axis2=2)).max()
        of_harmonicity += np.abs(slope - slope.transpose(0, 2, 1)).max()
        errors.append([of_field, np.abs(slope - exact).max(), of_harmonicity])
    orders = -np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert np.all(orders > [3.7, 2.7, 2.7])
    scale = np.abs(exact).max()
    assert errors[-1][1] < 2e-4 * scale
    assert errors[-1][2] < 4e-4 * scale


def test_gradient_is_the_exact_derivative_of_field(coarse, dipoles):
    points = coarse.lower + 0.5 * coarse.info.grid.spacing + np.array([[0, 0, 0], [0.01, 0.014, 0.02]])
    direction = np.array([0.3e-3, -0.5e-3, 0.7e-3])
    steps = np.array([1.0, 1e-1, 1e-2])
    value, slope = coarse.field_and_gradient(points, CURRENTS)
    bend = coarse.second_gradient(points, CURRENTS)
    remainders = []
    for step in steps:
        moved, moved_slope = coarse.field_and_gradient(points + step * direction, CURRENTS)
        first = moved - value - step * slope @ direction
        second = moved_slope - slope - step * bend @ direction
        remainders.append([np.abs(first).max(), np.abs(second).max()])
    orders = np.polyfit(np.log(steps), np.log(remainders), 1)[0]
    np.testing.assert_allclose(orders, 2.0, atol=0.1)


def test_second_gradient_agrees_with_differences_of_the_closed_form(fine, dipoles):
    points = dipoles.points(50) * 0.9
    step = 1e-6
    for k in range(3):
        shift = step * np.eye(3)[k]
        ahead, behind = (exact_gradient(dipoles, CURRENTS, points + s * shift) for s in (1, -1))
        expected = (ahead - behind) / (2 * step)
        error = np.abs(fine.second_gradient(points, CURRENTS)[..., k] - expected).max()
        assert error < 1e-2 * np.abs(expected).max()


def test_few_and_many_points_give_the_same(coarse, dipoles):
    # Few points are evaluated coil by coil, many on the superposed grid: two paths, one answer.
    points = dipoles.points(coarse.info.grid.size)
    for ask in (coarse.field, coarse.gradient, coarse.second_gradient):
        many = ask(points, CURRENTS)
        few = ask(points[:20], CURRENTS)
        np.testing.assert_allclose(few, many[:20], rtol=0, atol=1e-13 * np.abs(many).max())
        rows = ask(points, np.tile(CURRENTS, (len(points), 1)))
        np.testing.assert_allclose(rows, many, rtol=0, atol=1e-13 * np.abs(many).max())


def test_changed_currents_are_not_served_from_the_last_ones(coarse, dipoles):
    points = dipoles.points(coarse.info.grid.size)
    first = coarse.field(points, CURRENTS)
    np.testing.assert_allclose(coarse.field(points, 2 * CURRENTS), 2 * first, rtol=1e-12)
    np.testing.assert_array_equal(coarse.field(points, CURRENTS), first)


def test_every_point_may_have_its_own_currents(coarse, dipoles):
    points = dipoles.points(6)
    currents = np.random.default_rng(1).normal(size=(6, 3))
    together = coarse.field(points, currents)
    apart = [coarse.field(point, row) for point, row in zip(points, currents, strict=True)]
    np.testing.assert_allclose(together, apart, rtol=1e-13)


def test_unit_fields_superpose(coarse, dipoles):
    points = dipoles.points(5)
    flux = np.einsum("nci,c->ni", coarse.unit_field(points), CURRENTS)
    slope = np.einsum("ncij,c->nij", coarse.unit_gradient(points), CURRENTS)
    np.testing.assert_allclose(flux, coarse.field(points, CURRENTS), rtol=1e-12)
    np.testing.assert_allclose(slope, coarse.gradient(points, CURRENTS), rtol=1e-12)
    assert coarse.unit_field(points[0]).shape == (3, 3)


@pytest.mark.parametrize("n_points", [3, 1000])
def test_a_single_coil(dipoles, n_points):
    from fieldmap.lookup import interpolate

    opened = interpolate(dipoles.map((6, 5, 6), n_coils=1))
    points = dipoles.points(n_points)
    expected = 3.0 * dipoles.field(dipoles.moments[0], dipoles.sources[0], points)
    error = np.abs(opened.field(points, [3.0]) - expected).max()
    assert error < 1e-3 * np.abs(expected).max()


def test_a_point_without_a_row_gives_results_without_one(coarse, dipoles):
    point = dipoles.points(1)[0]
    assert coarse.field(point, CURRENTS).shape == (3,)
    assert coarse.gradient(point, CURRENTS).shape == (3, 3)
    assert coarse.second_gradient(point, CURRENTS).shape == (3, 3, 3)
    assert coarse.wrench(point, [0, 0, 1], CURRENTS).shape == (6,)
    np.testing.assert_array_equal(coarse.field(point, CURRENTS), coarse.field([point], CURRENTS)[0])
