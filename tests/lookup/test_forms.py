"""The forms of a map against closed forms, each other, Taylor's theorem and Maxwell's equations."""

import magpylib
import numpy as np
import pytest

from fieldmap.errors import InputError
from fieldmap.interpolants import INTERPOLANTS
from fieldmap.interpolants.global_polynomial import DEGREE, _degree
from fieldmap.lookup import interpolate
from fieldmap.lookup.evaluation import CompiledEvaluator
from fieldmap.store import Grid, MapData
from tests.core.harmonics_in_numpy import derivative_matrix, regular_table
from tests.lookup.reference_evaluator import ReferenceEvaluator

KINDS = list(INTERPOLANTS)
CURRENTS = np.array([1.0, -0.7, 0.4])


@pytest.fixture(scope="module", params=[CompiledEvaluator, ReferenceEvaluator], ids=["compiled", "numpy"])
def opened(dipoles, request):
    """A map in every form, evaluated by each implementation."""
    data = dipoles.map((12, 10, 12))
    return {kind: interpolate(data, kind, threads=1, evaluator=request.param) for kind in KINDS}


def exact(dipoles, points, currents=CURRENTS):
    parts = list(zip(currents, dipoles.moments, dipoles.sources, strict=True))
    flux = sum(i * dipoles.field(m, s, points) for i, m, s in parts)
    return flux, sum(i * dipoles.gradient(m, s, points) for i, m, s in parts)


def boundary_points(dipoles, n, spacing):
    """Random points in the outermost layer of cells."""
    points, size = dipoles.points(n, seed=4), dipoles.upper - dipoles.lower
    rng = np.random.default_rng(5)
    axis, side = rng.integers(0, 3, n), rng.integers(0, 2, n)
    depth = rng.random(n) * spacing[axis]
    low, high = dipoles.lower[axis] + depth, dipoles.upper[axis] - depth
    points[np.arange(n), axis] = np.where(side == 0, low, high)
    assert np.all(points >= dipoles.lower)
    assert np.all(points <= dipoles.lower + size)
    return points


@pytest.mark.parametrize(
    ("kind", "flux_bound", "slope_bound"),
    [("hermite", 3e-5, 4e-4), ("harmonic", 4e-6, 1e-4), ("global", 2e-6, 1e-4)],
)
def test_field_and_gradient_also_in_the_boundary_layer(opened, dipoles, kind, flux_bound, slope_bound):
    m = opened[kind]
    points = np.concatenate([dipoles.points(1500), boundary_points(dipoles, 1500, m.info.grid.spacing)])
    flux, slope = exact(dipoles, points)
    ours, our_slope = m.field_and_gradient(points, CURRENTS)
    assert np.abs(ours - flux).max() < flux_bound * np.abs(flux).max()
    assert np.abs(our_slope - slope).max() < slope_bound * np.abs(slope).max()


def test_closed_forms_of_the_test_itself(dipoles):
    points, step = dipoles.points(20), 1e-6
    sources = [
        magpylib.misc.Dipole(moment=i * moment, position=source)
        for i, moment, source in zip(CURRENTS, dipoles.moments, dipoles.sources, strict=True)
    ]
    flux, slope = exact(dipoles, points)
    np.testing.assert_allclose(flux, magpylib.getB(sources, points, sumup=True), rtol=1e-9)
    for j, shift in enumerate(step * np.eye(3)):
        ahead, behind = (magpylib.getB(sources, points + s * shift, sumup=True) for s in (1, -1))
        difference = (ahead - behind) / (2 * step)
        np.testing.assert_allclose(slope[..., j], difference, atol=1e-6 * np.abs(difference).max())


@pytest.mark.parametrize(
    ("kind", "orders", "bounds"),
    [
        # The potential has degree 5, B degree 4: order 5 for B, 4 for the gradient, 3 for the second gradient.
        ("harmonic", [4.7, 3.7, 2.7, -np.inf], [1e-6, 2e-5, 1e-3, 1e-12]),
        ("hermite", [3.7, 2.7, 1.7, 2.7], [1e-5, 2e-4, 2e-2, 4e-4]),
    ],
)
def test_convergence(dipoles, kind, orders, bounds):
    """Field, gradient, second gradient, and divergence and curl, at places where the error peaks."""
    sizes, errors = np.array([12, 18, 27]), []
    places = np.stack(np.meshgrid(*[[0.03, 0.5]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    for n in sizes:
        m = interpolate(dipoles.map(n), kind)
        cells = np.array([[0, 0, 0], [n // 2, n // 2, n - 1], [n - 1, n - 1, n - 1]])
        points = dipoles.lower + (cells[:, None] + places).reshape(-1, 3) * m.info.grid.spacing
        flux, slope = exact(dipoles, points)
        ours, our_slope = m.field_and_gradient(points, CURRENTS)
        step = 1e-5
        shifted = [exact(dipoles, points + s * step * axis)[1] for axis in np.eye(3) for s in (1, -1)]
        bends = np.stack([(shifted[2 * k] - shifted[2 * k + 1]) / (2 * step) for k in range(3)], axis=-1)
        uneven = np.abs(our_slope - our_slope.transpose(0, 2, 1)).max()
        uneven += np.abs(np.trace(our_slope, axis1=1, axis2=2)).max()
        found = [ours - flux, our_slope - slope, m.second_gradient(points, CURRENTS) - bends, uneven]
        errors.append([np.abs(off).max() for off in found])
    assert np.all(-np.polyfit(np.log(sizes), np.log(errors), 1)[0] > orders)
    assert np.all(errors[-1] < bounds * np.array([np.abs(of).max() for of in (flux, slope, bends, slope)]))


def polynomial_map(degree):
    """A map of a random homogeneous harmonic polynomial, and the functions for its field and gradient."""
    c = np.zeros((degree + 1) ** 2)
    c[degree**2 :] = np.random.default_rng(degree).normal(size=2 * degree + 1)
    grid = Grid([-0.3, -0.2, -0.4], [0.12, 0.1, 0.16], (6, 5, 6))

    def field(points):
        table = regular_table(degree - 1, np.ascontiguousarray(points))
        return np.stack([table @ (derivative_matrix(degree, i) @ c) for i in range(3)], axis=1)

    def slope(points):
        table = regular_table(degree - 2, np.ascontiguousarray(points))
        rows = [
            table @ (derivative_matrix(degree - 1, j) @ (derivative_matrix(degree, i) @ c))
            for i in range(3)
            for j in range(3)
        ]
        return np.stack(rows, axis=1).reshape(-1, 3, 3)

    nodes, shape = grid.points(), grid.shape
    data = MapData(
        grid,
        ("a",),
        [1.0],
        flux_density=field(nodes).reshape(1, *shape, 3),
        gradient=slope(nodes).reshape(1, *shape, 3, 3),
    )
    return data, field, slope


@pytest.mark.parametrize(("kind", "highest"), [("harmonic", 5), ("global", 16)])
def test_exact_on_harmonic_polynomials_and_no_further(kind, highest):
    for degree in (2, highest, highest + 1):
        data, field, slope = polynomial_map(degree)
        if kind == "global":
            # 17^3 nodes for 288 unknowns: the fit takes 13^3 of them, and a smaller grid would lower the degree.
            grid = Grid(data.grid.lower, (data.grid.upper - data.grid.lower) / 16, (17, 17, 17))
            nodes = grid.points()
            flux, gradient = field(nodes).reshape(1, 17, 17, 17, 3), slope(nodes).reshape(1, 17, 17, 17, 3, 3)
            data = MapData(grid, ("a",), [1.0], flux_density=flux, gradient=gradient)
        if degree > highest and kind == "global":
            # The polynomial is homogeneous of degree 17: the fit has no part of it.
            with pytest.raises(InputError, match="misfit"):
                interpolate(data, kind)
            continue
        m = interpolate(data, kind)
        points = data.grid.lower + np.random.default_rng(0).random((300, 3)) * (
            data.grid.upper - data.grid.lower
        )
        ours, our_slope = m.field_and_gradient(points, [1.0])
        error = np.abs(ours - field(points)).max() / np.abs(field(points)).max()
        slope_error = np.abs(our_slope - slope(points)).max() / np.abs(slope(points)).max()
        if degree <= highest:
            assert error < 1e-11
            assert slope_error < 1e-10
        else:
            assert error > 1e-7


@pytest.mark.parametrize("kind", ["harmonic", "global"])
def test_curl_and_divergence_vanish(opened, dipoles, kind):
    slope = opened[kind].gradient(dipoles.points(500), CURRENTS)
    size = np.linalg.norm(slope, axis=(1, 2))
    assert np.all(np.abs(np.trace(slope, axis1=1, axis2=2)) < 1e-12 * size)
    assert np.all(np.abs(slope - slope.transpose(0, 2, 1)).max(axis=(1, 2)) < 1e-12 * size)


@pytest.mark.parametrize("kind", KINDS)
def test_every_derivative_by_taylor(opened, dipoles, kind):
    m = opened[kind]
    spacing = m.info.grid.spacing
    points = m.lower + (np.array([[2, 3, 4], [0, 0, 0], [11, 9, 11]]) + 0.5) * spacing
    direction = 0.3 * spacing * np.array([0.5, -0.8, 0.6])
    steps = np.array([1.0, 0.3, 0.1])
    value, slope = m.field_and_gradient(points, CURRENTS)
    bend = m.second_gradient(points, CURRENTS)
    energy = m.potential(points, CURRENTS)
    remainders = []
    for step in steps:
        there = points + step * direction
        flux, slope_there = m.field_and_gradient(there, CURRENTS)
        first = flux - value - step * slope @ direction
        second = slope_there - slope - step * bend @ direction
        row = [np.abs(first).max(), np.abs(second).max()]
        if kind != "hermite":  # its potential has an interpolant of its own
            row.append(np.abs(m.potential(there, CURRENTS) - energy + step * value @ direction).max())
        remainders.append(row)
    orders = np.polyfit(np.log(steps), np.log(remainders), 1)[0]
    np.testing.assert_allclose(orders, 2.0, atol=0.15)


@pytest.mark.parametrize(("kind", "tolerance"), [("hermite", 2e-5), ("harmonic", 4e-6), ("global", 2e-6)])
def test_potential_is_that_of_the_dipoles(opened, dipoles, kind, tolerance):
    # U = mu0/4pi m.r/r^3 up to a constant; differences of it over the box, in units of its range.
    points = dipoles.points(400)
    parts = zip(CURRENTS, dipoles.moments, dipoles.sources, strict=True)
    expected = sum(
        1e-7 * i * ((points - s) @ m) / np.linalg.norm(points - s, axis=1) ** 3 for i, m, s in parts
    )
    ours = opened[kind].potential(points, CURRENTS)
    difference = (ours - ours[0]) - (expected - expected[0])
    assert np.abs(difference).max() < tolerance * np.ptp(expected)


@pytest.mark.parametrize("kind", KINDS)
def test_all_doors_give_the_same(opened, dipoles, kind):
    m = opened[kind]
    points = dipoles.points(2000)
    fixed = m.at(CURRENTS)
    flux, slope = fixed.field_and_gradient(points)
    close = {"rtol": 0, "atol": 1e-12 * np.abs(slope).max()}
    few = m.field_and_gradient(points[:5], CURRENTS)
    rows = m.field_and_gradient(points, np.tile(CURRENTS, (2000, 1)))
    for other, n in ((few, 5), (rows, 2000), (m.field_and_gradient(points, CURRENTS), 2000)):
        np.testing.assert_allclose(other[0], flux[:n], **close)
        np.testing.assert_allclose(other[1], slope[:n], **close)
    np.testing.assert_allclose(m.field(points, CURRENTS), flux, **close)
    np.testing.assert_allclose(fixed.gradient(points), slope, **close)
    one, one_slope = m.field_and_gradient(points[7].copy(), CURRENTS)
    again, slope_again = fixed.field_and_gradient(points[7].copy())
    for ours, expected in ((one, flux[7]), (again, flux[7]), (one_slope, slope[7]), (slope_again, slope[7])):
        np.testing.assert_allclose(ours, expected, **close)
    np.testing.assert_allclose(np.einsum("nci,c->ni", m.unit_field(points), CURRENTS), flux, **close)
    units = np.einsum("ncij,c->nij", m.unit_gradient(points), CURRENTS)
    np.testing.assert_allclose(units, slope, rtol=0, atol=1e-11 * np.abs(slope).max())
    moment = [0.1, -0.2, 0.3]
    np.testing.assert_allclose(fixed.wrench(points, moment), m.wrench(points, moment, CURRENTS), **close)
    np.testing.assert_allclose(
        fixed.second_gradient(points[:9]), m.second_gradient(points[:9], CURRENTS), rtol=1e-9, atol=1e-9
    )
    np.testing.assert_allclose(
        fixed.potential(points), m.potential(points[:5000], CURRENTS), rtol=1e-10, atol=1e-16
    )


def test_jump_between_cells_is_measured_and_bounded(opened, dipoles):
    m = opened["harmonic"]
    jump, spacing = m.jump(), m.info.grid.spacing
    unit = m.at([1.0, 0, 0]), m.at([0, 1.0, 0]), m.at([0, 0, 1.0])
    rng = np.random.default_rng(2)
    seen = np.zeros(2)
    for axis in range(3):
        points = dipoles.points(3000, seed=axis)
        faces = rng.integers(1, m.info.grid.shape[axis] - 1, 3000)
        points[:, axis] = m.lower[axis] + faces * spacing[axis]
        sides = [points + s * 1e-9 * spacing[axis] * np.eye(3)[axis] for s in (1, -1)]
        both = [[of_coil.field_and_gradient(side) for side in sides] for of_coil in unit]
        flux = sum(np.linalg.norm(up[0] - down[0], axis=1) for up, down in both)
        slope = sum(np.linalg.norm(up[1] - down[1], axis=(1, 2)) for up, down in both)
        seen = np.maximum(seen, [flux.max(), slope.max()])
    assert 0.5 * jump.flux_density < seen[0] < jump.flux_density_bound
    assert 0.5 * jump.gradient < seen[1] < jump.gradient_bound
    largest = np.abs(m.at(np.ones(3)).field(dipoles.points(500))).max()
    assert jump.flux_density_bound < 1e-4 * largest
    assert opened["global"].jump().gradient_bound == 0


@pytest.mark.parametrize("cells", [(4, 3, 5), (3, 4, 2), (2, 2, 3), (2, 3, 2), (5, 2, 2)])
def test_jump_is_the_largest_at_chebyshev_points_of_the_faces(dipoles, cells):
    """Five by five points of every face between cells: the difference between both sides."""
    m = interpolate(dipoles.map(cells), "harmonic")
    spacing, shape = np.array(m.info.grid.spacing), np.array(m.info.grid.shape)
    at = np.polynomial.chebyshev.chebpts1(5)
    largest = np.zeros(2)
    for axis in range(3):
        along = [
            m.lower[a] + (np.arange(n)[:, None] + 0.5 + 0.5 * at).ravel() * spacing[a]
            for a, n in enumerate(shape - 1)
        ]
        along[axis] = m.lower[axis] + np.arange(1, shape[axis] - 1) * spacing[axis]
        points = np.stack(np.meshgrid(*along, indexing="ij"), axis=-1).reshape(-1, 3)
        beside = 1e-8 * spacing * np.eye(3)[axis]
        steps = np.zeros((2, len(points)))
        for unit in np.eye(3):
            above, below = (m.field_and_gradient(points + side * beside, unit) for side in (1, -1))
            steps += [
                np.linalg.norm((a - b).reshape(len(points), -1), axis=1)
                for a, b in zip(above, below, strict=True)
            ]
        largest = np.maximum(largest, steps.max(axis=1))
    found = m.jump()
    assert [found.flux_density, found.gradient] == pytest.approx(largest, rel=1e-3)


@pytest.mark.parametrize("kind", ["harmonic", "global"])
def test_stated_error_is_that_between_the_nodes(opened, dipoles, kind):
    m, points = opened[kind], np.concatenate([dipoles.points(3000), opened[kind].info.grid.points()])
    of_flux, of_slope = np.zeros(len(points)), np.zeros(len(points))
    for unit in np.eye(3):
        flux, slope = exact(dipoles, points, unit)
        ours, our_slope = m.field_and_gradient(points, unit)
        of_flux += np.linalg.norm(ours - flux, axis=1)
        of_slope += np.linalg.norm(our_slope - slope, axis=(1, 2))
    assert 0.5 * of_flux.max() < m.interpolation_error.flux_density < 3 * of_flux.max()
    assert 0.5 * of_slope.max() < m.interpolation_error.gradient < 3 * of_slope.max()


def test_misfit_is_the_error_at_the_nodes(opened, dipoles):
    m = opened["global"]
    nodes = m.info.grid.points()
    total = np.zeros(len(nodes))
    for c in range(3):
        flux, _ = exact(dipoles, nodes, np.eye(3)[c])
        total += np.linalg.norm(m.field(nodes, np.eye(3)[c]) - flux, axis=1)
    assert m.interpolation_error.flux_density == pytest.approx(total.max(), rel=1e-6)


def test_global_is_refused_where_sources_are_too_near(dipoles):
    near = np.array([0.0, 0.0, 0.012])
    grid = Grid(dipoles.lower, (dipoles.upper - dipoles.lower) / 10, (11, 11, 11))
    nodes = grid.points()
    data = MapData(
        grid,
        ("a",),
        [1.0],
        flux_density=dipoles.field(dipoles.moments[0], near, nodes).reshape(1, 11, 11, 11, 3),
        gradient=dipoles.gradient(dipoles.moments[0], near, nodes).reshape(1, 11, 11, 11, 3, 3),
    )
    with pytest.raises(InputError, match="global"):
        interpolate(data, "global")


@pytest.mark.parametrize("n_nodes", range(2, 400, 7))
def test_the_degree_is_the_highest_that_half_of_the_nodes_numbers_determine(n_nodes):
    """(d + 1)^2 - 1 coefficients of a harmonic polynomial, eight numbers at each node."""
    degree = _degree(n_nodes)
    assert 3 <= degree <= DEGREE
    assert degree == 3 or 2 * ((degree + 1) ** 2 - 1) <= 8 * n_nodes
    assert degree == DEGREE or 2 * ((degree + 2) ** 2 - 1) > 8 * n_nodes


@pytest.mark.parametrize(("kind", "places"), [("hermite", 5 * 4 * 6), ("harmonic", 4 * 3 * 5)])
def test_a_form_knows_how_many_nodes_or_cells_it_has(dipoles, kind, places):
    for coils in (1, 3):
        form = INTERPOLANTS[kind].form(dipoles.map((4, 3, 5), coils), "raise")
        assert (form.n_coils, form.places) == (coils, places)


def test_size(opened):
    assert opened["global"].nbytes < 3 * 8 * 17**2 + 1000
    assert opened["harmonic"].nbytes == pytest.approx(12 * 10 * 12 * 3 * 36 * 8, rel=0.01)


def test_changed_currents_are_not_served_from_the_last_ones(opened, dipoles):
    m, points = opened["harmonic"], dipoles.points(opened["harmonic"].info.grid.size)
    first = m.field(points, CURRENTS)
    np.testing.assert_allclose(m.field(points, 2 * CURRENTS), 2 * first, rtol=1e-12)
    np.testing.assert_array_equal(m.field(points, CURRENTS), first)


def test_every_point_may_have_its_own_currents(opened, dipoles):
    points, currents = dipoles.points(6), np.random.default_rng(1).normal(size=(6, 3))
    for m in opened.values():
        apart = [m.field(point, row) for point, row in zip(points, currents, strict=True)]
        np.testing.assert_allclose(m.field(points, currents), apart, rtol=1e-12)


@pytest.mark.parametrize("n_points", [3, 1000])
def test_a_single_coil(dipoles, n_points):
    points = dipoles.points(n_points)
    expected = 3.0 * dipoles.field(dipoles.moments[0], dipoles.sources[0], points)
    error = np.abs(interpolate(dipoles.map((6, 5, 6), n_coils=1)).field(points, [3.0]) - expected).max()
    assert error < 1e-3 * np.abs(expected).max()


def test_a_point_without_a_row_gives_results_without_one(opened, dipoles):
    m, point = opened["harmonic"], dipoles.points(1)[0]
    shapes = [of(point, CURRENTS).shape for of in (m.field, m.gradient, m.second_gradient)]
    assert shapes == [(3,), (3, 3), (3, 3, 3)]
    assert m.wrench(point, [0, 0, 1], CURRENTS).shape == (6,)
    assert (m.unit_field(point).shape, m.unit_gradient(point).shape) == ((3, 3), (3, 3, 3))
    np.testing.assert_allclose(m.field(point, CURRENTS), m.field([point], CURRENTS)[0], rtol=1e-12)
