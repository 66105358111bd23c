"""Searched reachable sets against the exact set of linear fields, brute force, a duality bound, and scaling."""

from functools import cache
from itertools import product

import numpy as np
import pytest
import scipy.constants
from scipy.optimize import minimize
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import fieldmap as fm
from fieldmap.currents import divide_currents
from fieldmap.device.model import Arctangent
from fieldmap.device.payload import SoftSphere
from fieldmap.errors import InputError
from fieldmap.field import Field
from fieldmap.iron import NonlinearSolver
from fieldmap.levitation import SearchedSet, reachable
from fieldmap.levitation.reachable_set import even_directions, quantity_of, searched_set
from fieldmap.lookup import MagneticBody, magnetic_body
from tests.dynamics.conftest import saturating_map
from tests.iron.test_differential_inductance import device as core_beside_magnet

PLACE, MOMENT = np.array([0.002, -0.003, 0.004]), np.array([0.1, 0.2, 0.8])
UPRIGHT = np.eye(3)


@pytest.fixture(scope="module")
def linear():
    return fm.open_map("sample")


@pytest.fixture(scope="module")
def division():
    return saturating_map()


@pytest.fixture(scope="module")
def within(division):
    """within(limit): the set of the division, searched once."""
    return cache(lambda limit: reachable(division, PLACE, limit, MOMENT))


@pytest.mark.parametrize("moment", [None, MOMENT])
def test_the_exact_set_where_all_is_linear(linear, moment):
    at = np.array([0.002, -0.003, -0.1])
    exact = reachable(linear, at, np.linspace(1.0, 2.0, 6), moment)
    assert exact.exact
    found = searched_set(linear, at, exact.lower, exact.upper, moment, UPRIGHT)
    assert found.quantity == exact.quantity
    for direction, value in zip(found.directions, found.values, strict=True):
        assert value @ direction == pytest.approx(exact.largest_along(direction), rel=1e-6)
    # The set is the hull of 134 of the exact set's corners.
    assert 0.8 * exact.volume < found.volume <= exact.volume * (1 + 1e-9)


def test_the_force_on_a_turned_body_is_that_on_its_dipoles_where_they_are(linear):
    position, currents = np.array([0.002, -0.003, -0.1]), np.array([1.0, 1.5, 0.5, 2.0, 1.0, 0.7])
    turn = Rotation.from_rotvec([0.3, -0.8, 0.4]).as_matrix()
    points = np.array([[3e-3, 0.0, 0.0], [0.0, -2e-3, 4e-3]])
    moments = np.array([[0.1, 0.0, 0.5], [0.0, 0.2, 0.3]])
    force, slopes = quantity_of(linear, position, MagneticBody(points, moments), turn)(currents)
    each = zip(position + points @ turn.T, moments @ turn.T, strict=True)
    expected = sum(linear.wrench(at, moment, currents)[:3] for at, moment in each)
    np.testing.assert_allclose(force, expected, rtol=1e-9)
    np.testing.assert_allclose(slopes @ currents, expected, rtol=1e-9)


SPHERE, BEAD_AT = SoftSphere(4e-4, mu_r=50.0), np.array([0.004, -0.003, -0.1])


def reached(found):
    """The extent of the set along each of its directions."""
    return np.einsum("di,di->d", found.values, found.directions)


def forces_by_pairs(field):
    """Q (3, n, n) of F = I Q I, V (mu_r - 1) / (mu_r + 2) 3 / mu0 grad(B^2) / 2 (Jackson, section 5.11)."""
    flux, slope = field.unit_field(BEAD_AT[None])[0], field.unit_gradient(BEAD_AT[None])[0]
    part = np.pi * 4e-4**3 / 6 * 3 * 49.0 / 52.0 / scipy.constants.mu_0
    by_pairs = part * np.einsum("ai,bij->jab", flux, slope)
    return 0.5 * (by_pairs + by_pairs.swapaxes(1, 2))


def upper_bound(square, limit):
    """sum(d) limit^2 bounds I Q I for all currents within a limit, for every d >= 0 with diag(d) - Q positive (N. Z.
    Shor, Quadratic optimization problems, 1987); the least of these bounds is searched."""
    size = np.abs(square).max()

    def bound(d):
        return np.maximum(d + np.linalg.eigvalsh(square / size - np.diag(d))[-1], 0.0).sum()

    found = minimize(bound, np.zeros(len(square)), method="Powell", options={"xtol": 1e-6, "ftol": 1e-9})
    return bound(found.x) * size * limit**2


def test_soft_iron_in_linear_fields(linear):
    found = reachable(linear, BEAD_AT, 2.0, magnetic_body(SPHERE))
    assert isinstance(found, SearchedSet)
    squares = forces_by_pairs(linear)
    assert np.abs(found.currents).max() <= 2.0
    made = np.einsum("jab,da,db->dj", squares, found.currents, found.currents)
    np.testing.assert_allclose(found.values, made, atol=1e-4 * np.abs(made).max())
    for k in range(0, len(found.directions), 21):
        direction = found.directions[k]
        along = made[k] @ direction
        every = np.array(list(product((-2.0, 0.0, 2.0), repeat=6)))
        square = np.einsum("jab,j->ab", squares, direction)
        assert along > (1 - 1e-4) * np.einsum("da,ab,db->d", every, square, every).max()
        bound = upper_bound(square, 2.0)
        assert along < (1 + 1e-6) * bound
    doubled = reachable(linear, BEAD_AT, 4.0, magnetic_body(SPHERE))
    np.testing.assert_allclose(reached(doubled), 4.0 * reached(found), rtol=1e-4)


def test_what_one_direction_finds_is_known_to_all():
    """Eight coils in air and a bead, with many local optima of the force: no value of another direction reaches further
    along a direction than its own value."""
    coils = fm.read_device("eight_coils_bead").replace(bodies=(), materials={}, payload=None)
    found = reachable(fm.solve_linear(coils), (5e-3, -3e-3, 6e-3), 2.0, magnetic_body(SPHERE))
    own = reached(found)
    others = (found.values @ found.directions.T).max(axis=0)
    assert (others - own).max() < 1e-6 * own.max()


@pytest.mark.parametrize("limit", [1.6, 4.0])
def test_a_division_of_saturating_iron(division, within, limit):
    """Against a grid of its signals: no point of the grid reaches further, and no limit is passed."""
    found = within(limit)
    domain = division.info.reduced_model.domain
    lift, x, y = (np.linspace(*ends, 9) for ends in zip(domain.lower, domain.upper, strict=True))
    per_lift = divide_currents(1.0, *(axis.ravel() for axis in np.meshgrid(x, y)), 1.25)
    most = np.minimum(lift[-1], limit / np.abs(per_lift).max(axis=1))
    # Currents are proportional to the lift, which may rise to what the limits allow.
    lifts = np.linspace(lift[0], most[most > lift[0]], 7)
    grid = (lifts[..., None] * per_lift[most > lift[0]]).reshape(-1, 6)
    forces = division.wrench(np.tile(PLACE, (len(grid), 1)), MOMENT, grid)[:, :3]
    along = (forces @ found.directions.T).max(axis=0)
    size = np.ptp(forces, axis=0).max()
    assert len(grid) > 50
    assert (reached(found) > along - 1e-9 * size).all()
    # The search does not reach much further either: the grid is near everywhere.
    assert (reached(found) < along + 0.02 * size).all()
    assert np.abs(found.currents).max() <= limit * (1 + 1e-8)
    made = division.wrench(np.tile(PLACE, (len(found.currents), 1)), MOMENT, found.currents)[:, :3]
    np.testing.assert_allclose(made, found.values, rtol=1e-9, atol=1e-9 * size)
    up = division.wrench(PLACE, MOMENT, found.currents_along((0.0, 0.0, 2.0)))[2]
    assert found.largest_along((0.0, 0.0, 2.0)) == pytest.approx(up, rel=1e-9)
    assert up == pytest.approx(found.values[2, 2], rel=1e-6)


def test_free_currents_of_saturating_iron():
    """Against the corners of the box and random places in it."""
    field = saturating_map(free=True)
    found = reachable(field, PLACE, 2.0)
    some = np.random.default_rng(3).uniform(-2.0, 2.0, (200, 6))
    every = np.concatenate([2.0 * np.array(list(product((-1.0, 1.0), repeat=6))), some])
    flux = np.array([field.field(PLACE[None], row)[0] for row in every])
    size = np.ptp(flux, axis=0).max()
    assert (reached(found) > (flux @ found.directions.T).max(axis=0) - 1e-6 * size).all()
    # The map is not evaluated beyond its currents.
    assert np.abs(reachable(field, PLACE, 9.0).currents).max() == 3.0


@pytest.fixture(scope="module")
def solved():
    """A core that saturates and a magnet, with two coils; a place beside them; and states on a grid of currents."""
    solver = NonlinearSolver(core_beside_magnet(Arctangent("steel", 2000.0, 2.0)), 0.5)
    states: list = []
    for row in product(np.linspace(-60.0, 60.0, 5), np.linspace(-40.0, 40.0, 3)):
        states.append(solver.solve(row, start=states[-1] if states else None))
    return solver, np.array([0.003, -0.002, 0.042]), states


@pytest.mark.parametrize("moment", [None, MOMENT])
def test_a_solved_device_of_saturating_iron(solved, moment):
    """Against a grid of solved states; the solver keeps no state that the search solved."""
    solver, place, states = solved
    told = []
    found = reachable(solver, place, [60.0, 40.0], moment, progress=lambda _, share: told.append(share))
    assert not found.exact
    assert solver.states == ()
    assert told[-1] == 1.0
    assert found.directions.shape == (26, 3)

    def made_by(state):
        return state.field(place) if moment is None else moment @ state.gradient(place)

    values = np.array([made_by(state) for state in states])
    size = np.ptp(values, axis=0).max()
    assert (reached(found) > (values @ found.directions.T).max(axis=0) - 1e-3 * size).all()
    assert (np.abs(found.currents) <= [60.0, 40.0]).all()
    # Saturating iron gives less than its slopes at zero current predict.
    none = solver.by_currents(place, [0.0, 0.0])
    slopes = none[2][:, 2] if moment is None else none[3][:, :, 2] @ moment
    start = none[0][2] if moment is None else moment @ none[1][:, 2]
    assert found.largest_along([0, 0, 1]) < 0.95 * (start + np.abs(slopes) @ [60.0, 40.0])
    best = solver.solve(found.currents_along([0, 0, 1]))
    assert found.largest_along([0, 0, 1]) == pytest.approx(made_by(best)[2], abs=1e-4 * size)


class Squares(Field):
    """B = (i Q1 i, i Q2 i, i Q3 i) everywhere, with its derivatives by the currents."""

    coil_names = ()

    def __init__(self, count, seed):
        squares = np.random.default_rng(seed).normal(size=(3, count, count))
        self.squares = squares + squares.swapaxes(1, 2)
        # Each square is convex in each single current.
        self.squares[:, range(count), range(count)] = np.abs(self.squares[:, range(count), range(count)])
        self.coil_names = tuple("abcdefgh"[:count])

    def values(self, currents):
        return np.einsum("jab,da,db->dj", self.squares, currents, currents)

    def field(self, points, currents):
        return np.tile(self.values(currents[None]), (len(points), 1))

    def gradient(self, points, currents):
        return np.zeros((len(points), 3, 3))

    def by_currents(self, points, currents):
        slopes = 2.0 * np.einsum("jab,b->aj", self.squares, currents)[None]
        return self.field(points, currents), np.zeros((1, 3, 3)), slopes, np.zeros((1, len(currents), 3, 3))


@pytest.mark.parametrize(("count", "seed"), [(5, 2), (6, 1)])
def test_no_currents_on_a_grid_reach_further(count, seed):
    """Squares of the currents have many local optima; with other numbers a search may end at one."""
    field, limits = Squares(count, seed), np.array([[-1.0] * count, [1.0] * count])
    found = reachable(field, np.zeros(3), limits)
    grid = np.array(list(product(np.linspace(-1.0, 1.0, 5), repeat=count)))
    best = (field.values(grid) @ found.directions.T).max(axis=0)
    assert (reached(found) > best - 1e-9 * best.max()).all()
    assert np.abs(found.currents).max() == 1.0
    np.testing.assert_allclose(found.values, field.values(found.currents), rtol=1e-9, atol=1e-12)
    hull = ConvexHull(found.values)
    assert found.volume == pytest.approx(hull.volume, rel=1e-6)
    outward = np.cross(
        *(found.vertices[found.triangles[:, k]] - found.vertices[found.triangles[:, 0]] for k in (1, 2))
    )
    middle = found.vertices[found.triangles].mean(axis=1) - found.values.mean(axis=0)
    assert (np.einsum("ti,ti->t", outward, middle) > 0.0).all()


def test_what_neither_superposes_nor_has_derivatives_is_refused():
    class Squared(Field):
        coil_names = ("a",)

        def field(self, points, currents):
            return np.zeros((len(np.atleast_2d(points)), 3))

        def gradient(self, points, currents):
            return np.zeros((len(np.atleast_2d(points)), 3, 3))

    with pytest.raises(InputError, match="fieldmap map"):
        reachable(Squared(), PLACE, 1.0)


def test_limits_that_leave_nothing(division):
    for field, limits in ((division, 0.1), (saturating_map(free=True), [np.full(6, 3.5), np.full(6, 4.0)])):
        with pytest.raises(InputError, match="limits"):
            reachable(field, PLACE, limits, MOMENT)


@pytest.mark.parametrize("count", [26, 128])
def test_directions_are_unit_vectors_that_cover_the_sphere_evenly(count):
    """The mean of n n^T over a sphere is a third; each direction has a cap of 4 pi / count in area."""
    directions = even_directions(count)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, rtol=1e-12)
    np.testing.assert_array_equal(directions[:6], np.concatenate([np.eye(3), -np.eye(3)]))
    spiral = directions[6:]
    np.testing.assert_allclose(spiral.T @ spiral / count, np.eye(3) / 3, atol=0.3 / count)
    nearest = np.sort(spiral @ spiral.T, axis=1)[:, -2]
    assert np.arccos(nearest).min() > 0.7 * np.sqrt(4 * np.pi / count)
