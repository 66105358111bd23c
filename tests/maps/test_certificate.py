"""The certificate of a map is a tight bound: against exact coils at many points, near all its faces too."""

from dataclasses import replace

import numpy as np
import pytest

from fieldmap.device import read_device
from fieldmap.interpolants import cell_form, global_form
from fieldmap.interpolants.harmonic_matrix import field_matrix, gradient_matrix
from fieldmap.lookup import interpolate, open_map
from fieldmap.lookup.current_model import CurrentModel
from fieldmap.maps.error_bound import (
    FACE_DEGREE,
    FACE_POINTS,
    SOLVER_POINTS,
    SURFACE_DEGREE,
    SURFACE_POINTS,
    _BeyondFaces,
    between_samples,
    box_surface,
    certified_bounds,
    difference_of_polynomials,
    interpolation_error,
    sample_points,
)
from fieldmap.sources import unit_flux_densities
from fieldmap.store import Grid, MapData, read_map
from tests.lookup.conftest import dipole_field, dipole_gradient


def dense_points(opened, count=5_000):
    """Random points in the box, and the same number on its surface and on the faces of its cells."""
    draw = np.random.default_rng(5)
    points = opened.lower + draw.random((count, 3)) * (opened.upper - opened.lower)
    on_surface, on_cells = points.copy(), points.copy()
    axis = draw.integers(0, 3, count)
    ends = np.where(draw.random(count) < 0.5, opened.lower[axis], opened.upper[axis])
    on_surface[np.arange(count), axis] = ends
    grid = opened.info.grid
    steps = np.round((points - grid.lower) / grid.spacing)
    on_cells[np.arange(count), axis] = (grid.lower + steps * grid.spacing)[np.arange(count), axis]
    return np.clip(np.vstack([points, on_surface, on_cells]), opened.lower, opened.upper)


def largest_in_ball(coefficients, degree, radius):
    """Field and gradient, at many points of the sphere, where a harmonic function is largest, and at its poles."""
    places = np.random.default_rng(degree).standard_normal((4000, 3))
    places[0] = 0.0, 0.0, 1.0
    places *= radius / np.linalg.norm(places, axis=1, keepdims=True)
    field = field_matrix(degree, places) @ coefficients
    gradient = gradient_matrix(degree, places) @ coefficients
    return np.array([np.linalg.norm(field, axis=1).max(), np.linalg.norm(gradient, axis=(1, 2)).max()])


@pytest.mark.parametrize("degree", [10, 12])
def test_degrees_that_the_faces_do_not_see_are_bounded_in_the_ball_about_a_cell(degree):
    radius, known = 0.8, (FACE_DEGREE + 2) ** 2
    bounds = _BeyondFaces(degree, radius)
    coefficients = np.random.default_rng(degree).standard_normal((degree + 1) ** 2)
    coefficients[:known] = 0.0
    found = largest_in_ball(coefficients, degree, radius)
    stated = bounds.largest(coefficients[:, None, None], np.ones(1))
    assert (found <= stated).all()
    assert (found > 0.3 * stated).all()
    # Degrees that the faces see do not count, and fields add up by their scale.
    seen = coefficients.copy()
    seen[:known] = 1e3
    both = bounds.largest(np.stack([seen, -seen], axis=1)[:, None], np.array([1.0, 0.5]))
    np.testing.assert_allclose(both, 1.5 * stated, rtol=1e-9)


@pytest.mark.parametrize("degree", [10, 12])
def test_of_one_zonal_harmonic_that_bound_is_known(degree):
    """r^l P_l on the unit sphere: |B| is l at the pole, |B|^2 l on average. The square of a harmonic of degree k is at
    most 2 k + 1 times its average, by the addition theorem; B has the degree l - 1, its gradient l - 2."""
    zonal = np.zeros((degree + 1) ** 2)
    zonal[degree**2] = 1.0
    stated = _BeyondFaces(degree, 0.8).largest(zonal[:, None, None], np.ones(1))
    # At the pole the gradient is l (l - 1) diag(-1/2, -1/2, 1), and the average of its squares l (l - 1) (2 l - 1).
    field = np.sqrt((2 * degree - 1) / degree)
    gradient = np.sqrt((2 * degree - 1) * (2 * degree - 3) / (1.5 * degree * (degree - 1)))
    np.testing.assert_allclose(stated / largest_in_ball(zonal, degree, 0.8), [field, gradient], rtol=1e-9)


@pytest.mark.parametrize("kind", ["harmonic", "global"])
def test_nothing_is_further_off_than_the_bound(rig_map, kind):
    opened = open_map(rig_map, kind)
    points = dense_points(opened)
    # The coils of this device have no iron: their exact field is that of the sources alone.
    exact = unit_flux_densities(read_device(rig_map.with_name("pair.toml")).coils, points)
    error = np.linalg.norm(opened.unit_field(points).swapaxes(0, 1) - exact, axis=2).sum(axis=0).max()
    bound = opened.error_bound.flux_density
    assert error <= bound
    # Chebyshev points cost a factor of up to 6.8 and 4.
    assert bound < 12 * error


def test_gradient_is_bounded_by_differences_of_the_exact_field(rig_map):
    opened = open_map(rig_map)
    coils, step = read_device(rig_map.with_name("pair.toml")).coils, 1e-5
    points = np.clip(dense_points(opened, 300), opened.lower + step, opened.upper - step)
    ours = opened.unit_gradient(points).swapaxes(0, 1)
    slopes = [
        (unit_flux_densities(coils, points + s) - unit_flux_densities(coils, points - s)) / (2 * step)
        for s in step * np.eye(3)
    ]
    error = np.linalg.norm(ours - np.stack(slopes, axis=-1), axis=(2, 3)).sum(axis=0).max()
    assert error <= opened.error_bound.gradient < 30 * error


def test_a_map_that_is_wrong_everywhere_by_one_percent_is_caught(rig_map):
    """The certificate compares with the solver, not with the nodes."""
    data = read_map(rig_map)
    coils = read_device(rig_map.with_name("pair.toml")).coils

    def louder(points):
        flux = 1.01 * unit_flux_densities(coils, points)
        return flux, np.zeros((*flux.shape, 3))

    bounds = certified_bounds(data, louder, data.reference_current)
    largest = np.linalg.norm(data.flux_density, axis=-1).reshape(len(coils), -1).sum(axis=0).max()
    assert bounds["harmonic"].flux_density > 0.009 * largest


@pytest.mark.filterwarnings("ignore::fieldmap.errors.MapAccuracyWarning")
def test_of_saturating_iron_it_holds_for_all_currents_of_the_domain(few_states_map):
    """Against the weighted fields of the solver, at places other than the map's nodes."""
    points = dense_points(open_map(few_states_map.path), 500)
    flux, slope = few_states_map.fields(points)
    for kind in ("harmonic", "global"):
        opened = open_map(few_states_map.path, kind)
        model = CurrentModel(opened.info.reduced_model, opened.coil_names)
        largest = np.zeros(2)
        draw = np.random.default_rng(8).random((20, 2))
        for currents in (*([0.5, -1.0] + draw * [1.5, 3.0]), np.array([2.0, 2.0]), np.array([2.0, -1.0])):
            weights = model.weights(currents)
            off = opened.field(points, currents) - np.tensordot(weights, flux, 1)
            off_slope = opened.gradient(points, currents) - np.tensordot(weights, slope, 1)
            sizes = np.linalg.norm(off, axis=1).max(), np.linalg.norm(off_slope, axis=(1, 2)).max()
            largest = np.maximum(largest, sizes)
            stated = opened.info.provenance.solver_report["largest_weights"]
            assert (np.abs(weights) <= stated).all()
        bound = opened.error_bound
        # Chebyshev points cost a factor of up to 6.8 and 4; cancelling fields and smaller currents cost the rest.
        assert largest[0] <= bound.flux_density < 30 * largest[0]
        assert largest[1] <= bound.gradient < 30 * largest[1]


def test_polynomials_of_cells_and_box_differ_by_no_more_than_the_bound(rig_map):
    """The bound is the factor times the largest difference of lookups at Chebyshev points on the faces of all cells,
    here found a little inside the faces. The degrees that the points cannot see add little."""
    data = read_map(rig_map)
    scale = np.array([2.0, 0.5])
    whole, cells = global_form(data, "raise"), cell_form(data, "raise")
    bound = difference_of_polynomials(cells, whole, data.grid, scale)
    spacing = np.array(data.grid.spacing)
    of_one = box_surface(Grid(np.full(3, 1e-7) * spacing, (1 - 1e-7) * spacing, (2, 2, 2)), FACE_POINTS)
    corners = np.stack(np.meshgrid(*(np.arange(n - 1) for n in data.grid.shape), indexing="ij"), axis=-1)
    points = (data.grid.lower + corners.reshape(-1, 1, 3) * spacing + of_one).reshape(-1, 3)
    opened = open_map(rig_map), open_map(rig_map, "global")
    off = opened[0].unit_field(points) - opened[1].unit_field(points)
    off_slope = opened[0].unit_gradient(points) - opened[1].unit_gradient(points)
    largest = (
        (np.linalg.norm(off, axis=2) @ scale).max(),
        (np.linalg.norm(off_slope, axis=(2, 3)) @ scale).max(),
    )
    expected = between_samples(FACE_POINTS, FACE_DEGREE) * np.array(largest)
    assert (bound >= expected * (1 - 1e-5)).all()
    assert bound == pytest.approx(expected, rel=1e-2)


@pytest.mark.parametrize(("count", "degree"), [(24, 18), (12, 8), (5, 4)])
def test_polynomials_stay_below_samples_times_the_factor(count, degree):
    """Ehlich and Zeller, in two variables: the worst of many random polynomials, and cos(degree arccos)."""
    draw, dense = np.random.default_rng(1), np.linspace(-1, 1, 201)
    nodes = np.cos((2 * np.arange(count) + 1) * np.pi / (2 * count))
    everywhere, there = (np.polynomial.chebyshev.chebvander(x, degree) for x in (dense, nodes))
    worst = 0.0
    for trial in range(200):
        c = (
            draw.normal(size=(degree + 1, degree + 1))
            if trial
            else np.eye(degree + 1)[-1:].T * np.eye(degree + 1)[-1:]
        )
        largest = np.abs(everywhere @ c @ everywhere.T).max()
        worst = max(worst, largest / np.abs(there @ c @ there.T).max())
    assert 1.0 < worst <= between_samples(count, degree) * (1 + 1e-12)


def test_samples_lie_on_all_six_faces():
    grid = Grid([0.0, 1.0, 2.0], [0.5, 0.25, 1.0], (3, 5, 2))
    points = box_surface(grid, 4)
    assert points.shape == (96, 3)
    for axis in range(3):
        for end in (grid.lower[axis], grid.upper[axis]):
            assert (points[:, axis] == end).sum() == 16
    # Chebyshev points of [0, 1] along each of the other two axes.
    unit = 0.5 + 0.5 * np.polynomial.chebyshev.chebpts1(4)
    shares = (points - grid.lower) / (grid.upper - grid.lower)
    for axis in range(3):
        face = shares[shares[:, axis] == 0.0]
        for other in {0, 1, 2} - {axis}:
            np.testing.assert_allclose(np.sort(face[:, other]), np.repeat(unit, 4), atol=1e-12)


def test_lookups_are_tried_all_over_the_box_and_in_its_outer_cells():
    """At 200 random places, the same on every run, and at the centres of the 26 cells at corners, edges and faces."""
    grid = Grid([0.0, 1.0, 2.0], [0.5, 0.25, 1.0], (6, 5, 8))
    points = sample_points(grid)
    assert len(points) == 226
    np.testing.assert_array_equal(sample_points(grid), points)
    shares = (points[:200] - grid.lower) / (grid.upper - grid.lower)
    assert ((shares >= 0.0) & (shares <= 1.0)).all()
    assert np.abs(shares.mean(axis=0) - 0.5).max() < 0.07
    assert np.ptp(shares, axis=0).min() > 0.97
    cells = {tuple(cell) for cell in ((points[200:] - grid.lower) / grid.spacing).round(9)}
    ends = [(0.5, 2.5, 4.5), (0.5, 2.5, 3.5), (0.5, 3.5, 6.5)]
    middle = tuple(end[1] for end in ends)
    assert cells == {(x, y, z) for x in ends[0] for y in ends[1] for z in ends[2]} - {middle}


@pytest.fixture(scope="module")
def uneven():
    """A map of two dipoles with unequal reference currents, and their exact fields."""
    grid = Grid([-0.01, -0.012, -0.02], [3e-3, 4e-3, 3.5e-3], (7, 6, 8))
    sources = np.array([[0.0, 0.01, 0.05], [0.03, -0.05, -0.01]])
    moments = np.array([[0.0, 1.0, 2.0], [1.0, 0.5, -1.0]])

    def exact(points, scale=(1.0, 1.0)):
        parts = [
            (dipole_field(*one, points), dipole_gradient(*one, points))
            for one in zip(moments, sources, strict=True)
        ]
        return tuple(np.array([s * part[j] for s, part in zip(scale, parts, strict=True)]) for j in (0, 1))

    flux, slope = (values.reshape(2, *grid.shape, *values.shape[2:]) for values in exact(grid.points()))
    data = MapData(grid, ("a", "b"), [2.0, 0.5], flux_density=flux, gradient=slope)
    return data, exact


def summed(opened, exact, points, scale):
    """Largest sums over the fields of scale times the norm of the difference: of B, then of the gradient."""
    ours = opened.unit_field(points), opened.unit_gradient(points)
    rows = [
        sum(
            s * np.linalg.norm((mine[:, k] - theirs[k]).reshape(len(points), -1), axis=1)
            for k, s in enumerate(scale)
        )
        for mine, theirs in zip(ours, exact(points), strict=True)
    ]
    return [row.max() for row in rows]


def test_the_measured_error_is_that_of_hermite_lookups_each_field_at_its_reference_current(uneven):
    data, exact = uneven
    found = interpolation_error(data, exact)
    wanted = summed(interpolate(data, "hermite"), exact, sample_points(data.grid), (2.0, 0.5))
    assert [found.flux_density, found.gradient] == pytest.approx(wanted, rel=1e-6)


def test_the_bound_is_that_of_the_surface_and_of_the_cells(uneven):
    """Largest error of the box's polynomial at Chebyshev points of the surface, times their factor, plus the difference
    between the cells' polynomials and the box's."""
    data, exact = uneven
    scale = np.array([3.0, 0.25])
    asked = []
    bounds = certified_bounds(data, lambda points: asked.append(points) or exact(points), scale)
    (points,) = asked
    assert len(points) == SOLVER_POINTS
    np.testing.assert_array_equal(points, box_surface(data.grid, SURFACE_POINTS))
    wanted = between_samples(SURFACE_POINTS, SURFACE_DEGREE) * np.array(
        summed(interpolate(data, "global"), exact, points, scale)
    )
    whole, cells = global_form(data, "raise"), cell_form(data, "raise")
    inner = difference_of_polynomials(cells, whole, data.grid, scale)
    for name, expected in (("global", wanted), ("harmonic", wanted + inner)):
        assert [bounds[name].flux_density, bounds[name].gradient] == pytest.approx(expected, rel=1e-6)
    # Where no polynomial fits the whole box, nothing is certified.
    flux = data.flux_density + np.random.default_rng(3).standard_normal(data.flux_density.shape)
    assert certified_bounds(replace(data, flux_density=flux), exact, scale) == {}
