"""Stationary points, branches and folds in fields whose horizontal force is a product of known factors.

With g(x, y) = B_z at z = 0 and a vertical moment D, F = D grad g: the roots of a polynomial are the points.
"""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from fieldmap.device.model import MagnetCylinder, Payload
from fieldmap.errors import InputError, NoEquilibrium, NotConverged
from fieldmap.field import as_field
from fieldmap.levitation import equilibrium_at, follow_equilibrium, magnet_balance, stationary_points
from fieldmap.levitation.balance import MODELS, RigidBalance, model_assumptions
from fieldmap.levitation.stationary import to_equilibrium
from tests.levitation.conftest import solid_harmonics
from tests.refusals import refused

PAYLOAD = Payload(mass=0.01119, moment=0.813)
WEIGHT = 0.01119 * 9.80665
ROOTS_X, ROOTS_Y = (-0.011, 0.002, 0.013), (-0.012, -0.001, 0.009)
STRENGTH = 4e4
"""T/m^4: forces of some mN."""


def potential_of(roots):
    """p with p' = -STRENGTH prod (x - root): its maxima are the outer roots of three."""
    return (-STRENGTH * Polynomial.fromroots(roots)).integ().coef


def lifting():
    """c2 (z^2 - r^2/2): at z = 0 it lifts by 2 c2 D."""
    return solid_harmonics(c2=WEIGHT / PAYLOAD.moment / 2)


@pytest.fixture
def nine_points(polynomial_field, vertical_part):
    g = np.zeros((5, 5))
    g[:, 0] += potential_of(ROOTS_X)
    g[0, :] += potential_of(ROOTS_Y)
    return polynomial_field([vertical_part(g), lifting()])


def test_all_nine_points_with_their_kinds(nine_points):
    found = stationary_points(nine_points, [1.0, 1.0], PAYLOAD, 0.0)
    assert (found.boundary_index, found.complete) == (1, True)
    # The count of turns does not depend on the points: it reveals a missing point.
    assert not replace(found, points=found.points[:-1]).complete
    assert [len(found.of(kind)) for kind in ("stable", "saddle", "unstable")] == [4, 4, 1]
    away = [np.hypot(*(p.position[:2] - 0.5 * (found.lower + found.upper)[:2])) for p in found.points]
    assert away == sorted(away)
    known = {(x, y): (x == ROOTS_X[1]) + (y == ROOTS_Y[1]) for x in ROOTS_X for y in ROOTS_Y}
    for point in found.points:
        nearest = min(known, key=lambda root: np.hypot(*(point.position[:2] - root)))
        np.testing.assert_allclose(point.position, (*nearest, 0.0), atol=1e-9)
        assert point.kind == ("stable", "saddle", "unstable")[known[nearest]]
        assert abs(point.trace) < 1e-9
        assert point.lift == pytest.approx(WEIGHT, rel=1e-9)
        np.testing.assert_allclose(point.horizontal, np.sort(np.diag(point.stiffness)[:2]), rtol=1e-9)


@pytest.mark.parametrize(
    ("window", "index", "kinds"),
    [(([-0.002, 0.005], [0.006, 0.012]), -1, ["saddle"]), (([0.003, 0.0], [0.012, 0.008]), 0, [])],
)
def test_a_window_with_one_saddle_turns_the_other_way(nine_points, window, index, kinds):
    found = stationary_points(nine_points, [1.0, 1.0], PAYLOAD, 0.0, window)
    assert (found.boundary_index, found.complete) == (index, True)
    assert [point.kind for point in found.points] == kinds


@pytest.mark.parametrize("inside", [(-0.5, 0.9), (0.9, -0.5), (0.0, 0.0)])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("beyond", [-1.2, None, 1.2])
def test_newton_ends_at_the_zero_in_the_window_and_nowhere_beside_it(inside, axis, beyond):
    zero = np.array([*inside, 0.0])
    if beyond is not None:
        zero[axis] = beyond
    stiffness = np.array([[2.0, 0.3, 0.0], [0.3, -1.0, 0.0], [0.0, 0.0, -1.0]])
    of = {"magnetic_force": lambda at: (zero - at) @ stiffness, "stiffness": lambda point: stiffness}
    found = to_equilibrium(
        SimpleNamespace(**of), np.array([0.1, -0.2, 0.0]), np.full(2, -1.0), np.full(2, 1.0)
    )
    if beyond is None:
        np.testing.assert_allclose(found, zero, atol=1e-12)
    else:
        assert found is None


def stepping(jump):
    """A balance with a force that steps over zero at x = 0, so that Newton's steps alternate by a jump, m."""
    stiffness = np.diag([2.0, 2.0, -4.0])

    def force(at):
        return -(at + np.sign(at) * [0.5 * jump, 0.0, 0.0]) @ stiffness

    return SimpleNamespace(magnetic_force=force, stiffness=lambda point: stiffness)


@pytest.mark.parametrize(("jump", "found"), [(0.9e-6, True), (1.1e-6, False)])
def test_a_force_that_steps_over_zero_is_taken_for_zero_where_the_step_is_below_a_micrometre(jump, found):
    end = to_equilibrium(stepping(jump), np.array([1e-3, 2e-3, 0.0]), np.full(2, -0.01), np.full(2, 0.01))
    if found:
        np.testing.assert_allclose(end, 0.0, atol=1e-6)
    else:
        assert end is None


@pytest.mark.parametrize(("samples", "complete"), [(8, True), (2, False)])
def test_a_grid_is_halved_twice_until_the_points_account_for_the_turns(
    polynomial_field, vertical_part, samples, complete
):
    """Nine points within 2 mm of a window of 40 mm: 8 squares a side, halved to 32, find all; 2 do not."""
    g = np.zeros((5, 5))
    g[:, 0] += potential_of((-0.003, -0.002, -0.001))
    g[0, :] += potential_of((0.01, 0.011, 0.012))
    source = polynomial_field([vertical_part(g), lifting()])
    found = stationary_points(source, [1.0, 1.0], PAYLOAD, 0.0, samples=samples)
    assert (len(found.points) == 9, found.complete) == (complete, complete)


@pytest.fixture
def pushed(polynomial_field, vertical_part):
    """Coil 0: double well in x, spring in y; coil 1: a uniform push D i along x; coil 2: lift."""
    g = np.zeros((5, 5))
    g[:, 0] += potential_of((-0.01, 0.0, 0.01))
    g[0, 2] -= 20.0
    push = np.zeros((2, 1, 2))
    push[1, 0, 1] = 1e-3
    return polynomial_field([vertical_part(g), push, lifting()])


def pushing(push, level):
    """Currents at a push, and the height."""
    return np.array([1.0, push, 1.0]), 0.0


FOLD_X = 0.01 / np.sqrt(3.0)
FOLD_PUSH = STRENGTH * 2.0 * 0.01**3 / (3.0 * np.sqrt(3.0)) / 1e-3
"""-x (x - a)(x + a) has its extrema 2 a^3 / (3 sqrt 3) at a / sqrt 3."""


def test_a_branch_is_followed_round_its_folds(pushed):
    """From the left well the push grows until the well vanishes at a fold; the branch turns back, passes the middle as
    a saddle and reaches the right well."""
    stops = np.linspace(0.0, 1.5 * FOLD_PUSH, 4)
    found = follow_equilibrium(pushed, PAYLOAD, pushing, [-0.01, 0.0], stops, level=1.0)
    assert [point.kind for point in found.at_stops] == ["stable", "stable"]
    assert found.folds[0].parameter == pytest.approx(FOLD_PUSH, rel=1e-6)
    np.testing.assert_allclose(found.folds[0].unknowns, [-FOLD_X, 0.0], atol=1e-6)
    assert found.ended == "edge"
    stop = 0.5 * FOLD_PUSH
    roots = np.roots([-STRENGTH, 0.0, STRENGTH * 0.01**2, 1e-3 * stop])
    np.testing.assert_allclose(found.at_stops[1].position[0], roots.real.min(), atol=1e-9)


@pytest.mark.parametrize("way", [-1.0, 1.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_branch_ends_at_each_edge_of_the_box(polynomial_field, vertical_part, axis, way):
    """A spring in the plane, and a push that grows: the branch leaves the box where the spring balances the push."""
    spring, push = np.zeros((3, 3)), np.zeros((2, 2, 2))
    spring[2, 0] = spring[0, 2] = -20.0
    push[(1, 0)[axis], (0, 1)[axis], 1] = way * 1e-3
    springy = polynomial_field([vertical_part(spring), push, lifting()])
    edge = 0.02 * 2.0 * 20.0 / 1e-3
    stops = [0.0, 0.5 * edge, 2.0 * edge]
    found = follow_equilibrium(springy, PAYLOAD, pushing, [0.0, 0.0], stops, level=1.0)
    assert (found.ended, len(found.at_stops)) == ("edge", 2)
    middle = np.zeros(2)
    middle[axis] = way * 0.01
    np.testing.assert_allclose(found.at_stops[1].position[:2], middle, atol=1e-9)


def test_behind_a_fold_there_is_one_point_left(pushed):
    before, behind = (
        stationary_points(pushed, [1.0, factor * FOLD_PUSH, 1.0], PAYLOAD, 0.0) for factor in (0.98, 1.02)
    )
    assert [(len(found.points), found.complete) for found in (before, behind)] == [(3, True), (1, True)]


@pytest.mark.parametrize("scale", [1.0, 1.25])
def test_the_level_follows_where_the_height_is_held(pushed, scale):
    """All currents scale together, so the place stays; the lift sets the level: 1 / field_scale."""

    def scaled(push, level):
        return level * np.array([1.0, push, 1.0]), 0.0

    stops = [0.0, 0.3, 0.6]
    found = follow_equilibrium(pushed, PAYLOAD, scaled, [0.01, 0.0], stops, 0.7, True, scale)
    np.testing.assert_allclose(found.levels_at_stops, 1.0 / scale, rtol=1e-9)
    roots = [np.roots([-STRENGTH, 0.0, STRENGTH * 1e-4, 1e-3 * p]).real.max() for p in stops]
    np.testing.assert_allclose(found.positions_at_stops[:, 0], roots, atol=1e-8)
    np.testing.assert_allclose(found.levels, 1.0 / scale, rtol=1e-6)
    of_push = [np.roots([-STRENGTH, 0.0, STRENGTH * 1e-4, 1e-3 * p]).real.max() for p in found.parameters]
    expected = np.column_stack([of_push, np.zeros(len(of_push)), np.zeros(len(of_push))])
    np.testing.assert_allclose(found.positions, expected, atol=1e-8)


def test_a_branch_has_the_heights_and_levels_of_its_path(polynomial_field, vertical_part):
    """A spring in the plane; the path rises with the parameter, and with the level."""
    spring = np.zeros((3, 3))
    spring[2, 0] = spring[0, 2] = -20.0
    field = polynomial_field([vertical_part(spring)])
    found = follow_equilibrium(
        field, PAYLOAD, lambda p, u: (np.ones(1), 1e-3 * p + 2e-3 * u), [1e-3, 0.0], [1.0, 2.0, 3.0], 1.5
    )
    np.testing.assert_allclose(found.positions[:, 2], 1e-3 * found.parameters + 3e-3, rtol=1e-12)
    np.testing.assert_allclose(found.positions_at_stops[:, 2], [4e-3, 5e-3, 6e-3], rtol=1e-9)
    assert set(found.levels) | set(found.levels_at_stops) == {1.5}
    assert found.ended == "last stop"
    # A step is at most 0.05 of the range of the stops.
    assert np.diff(found.parameters).max() <= 0.1 * (1 + 1e-9)
    assert np.diff(found.parameters).max() > 0.09


def test_where_no_place_is_near_the_search_tells_where_it_ended(polynomial_field, vertical_part):
    """B_z = 2 x - 20 x^2 - 20 y^2 has no push at x = 50 mm, and the box ends at 20; B_z = x pushes alike everywhere."""
    springy, uniform = np.zeros((3, 3)), np.zeros((2, 1))
    springy[1, 0], springy[2, 0], springy[0, 2], uniform[1, 0] = 2.0, -20.0, -20.0, 1.0
    about = PAYLOAD, lambda u: (np.ones(1), 0.0), [0.003, 0.0], 1.25
    for g, received in (
        (springy, "a last step of 30 mm at [20.  0.] mm after 40 steps"),
        (uniform, "a last step of inf mm at [3. 0.] mm after 1 steps"),
    ):
        with pytest.raises(NoEquilibrium) as caught:
            equilibrium_at(polynomial_field([vertical_part(g)]), *about)
        (told,) = caught.value.problems
        assert (told.where, told.received) == ("equilibrium_at, from [3. 0.] mm at 1.25 A", received)


@pytest.mark.parametrize(("begin", "least", "most"), [(1.0, 0.8, 1.0), (0.2, 1.0, 1.25)])
def test_a_level_that_is_sought_moves_by_a_quarter_at_most_in_a_step(pushed, begin, least, most):
    """From 1 A down to 0.4, and from 0.2 up to it: the weight is carried at 1 / 2.5."""
    asked = []

    def path(level):
        asked.append(level)
        return level * np.array([1.0, 0.0, 1.0]), 0.0

    point, level = equilibrium_at(pushed, PAYLOAD, path, [0.0101, 0.0], begin, True, 2.5)
    assert level == pytest.approx(0.4, rel=1e-8)
    assert point.position[:2] == pytest.approx([0.01, 0.0], abs=1e-9)
    # Each round, without the differences of a thousandth.
    ratios = [b / a for a, b in pairwise(asked) if abs(b / a - 1.0) > 3e-3]
    assert least - 2e-3 < min(ratios)
    assert max(ratios) < most + 2e-3


@pytest.mark.parametrize(
    ("start", "stops", "error", "must_hold"),
    [
        ([0.0, 0.0], [0.0, 1.0, 0.5], InputError, "rising"),
        ([-0.019, 0.0], [9.0 * FOLD_PUSH, 9.1 * FOLD_PUSH], NotConverged, "near a solution"),
    ],
)
def test_bad_stops_and_a_start_far_from_any_solution(pushed, start, stops, error, must_hold):
    with refused(error, must_hold=must_hold):
        follow_equilibrium(pushed, PAYLOAD, pushing, start, stops, level=1.0)


MAGNET = MagnetCylinder(diameter=0.01, height=0.01, remanence=1.3)
WITH_MAGNET = Payload(mass=0.01119, moment=1.3 * np.pi / 4 * 1e-6 / (4e-7 * np.pi), magnet=MAGNET)


def tilted(polynomial_field):
    """A field linear in place, with a uniform sideways part."""
    t = lifting()
    t[1, 0, 0] += 0.004
    t[0, 0, 1] += 0.02
    return polynomial_field([t])


def test_a_rigid_magnet_in_a_linear_field_is_an_aligned_dipole(polynomial_field):
    """The volume means of B and of (grad B)^T M are their values at the centre: exact."""
    source, places = tilted(polynomial_field), np.array([[0.003, -0.002, 0.004], [0.0, 0.005, -0.006]])
    about = (source, np.ones(1), WITH_MAGNET, places[0])
    rigid, aligned = (magnet_balance(*about, moment) for moment in ("rigid", "aligned"))
    np.testing.assert_allclose(rigid.magnetic_force(places), aligned.magnetic_force(places), rtol=1e-6)
    np.testing.assert_allclose(rigid.stiffness(places[0]), aligned.stiffness(places[0]), rtol=2e-3, atol=1e-4)


def test_a_rigid_upright_magnet_feels_its_size(polynomial_field, vertical_part):
    """B_z = x^4 + ... harmonic: the mean of d B_z/dx over the cylinder by a fine sum, against the volume rule."""
    g = np.zeros((5, 1))
    g[4, 0] = 1e3
    source = as_field(polynomial_field([vertical_part(g), lifting()]))
    place = np.array([[0.004, 0.0, 0.0]])
    upright = magnet_balance(source, np.ones(2), WITH_MAGNET, place[0], "rigid upright")
    t = (np.arange(40) + 0.5) / 40
    z, r, angle = np.meshgrid(0.01 * (t - 0.5), 0.005 * np.sqrt(t), 2 * np.pi * t, indexing="ij")
    inside = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=-1).reshape(-1, 3)
    force = WITH_MAGNET.moment * source.gradient(place + inside, np.ones(2))[:, 2].mean(axis=0)
    np.testing.assert_allclose(upright.magnetic_force(place)[0], force, rtol=3e-3, atol=1e-9)


def test_a_low_centre_of_mass_uprights_the_magnet(polynomial_field):
    """The axis n is parallel to m B + w l e_z."""
    source, place, lever = tilted(polynomial_field), np.zeros((1, 3)), 0.05
    balance = magnet_balance(source, np.ones(1), WITH_MAGNET, place[0], "rigid", lever)
    expected = WITH_MAGNET.moment * source.field(place, np.ones(1))[0] + [0.0, 0.0, WEIGHT * lever]
    np.testing.assert_allclose(balance.axes(place)[0], expected / np.linalg.norm(expected), atol=1e-7)


def test_a_rigid_magnet_is_turned_by_rotations_and_reaches_as_far_as_its_farthest_point(polynomial_field):
    """For axes of any direction, up and down; forces are differenced over 0.2 mm beyond the farthest point."""
    given, points = [], np.array([[0.001, 0.0, 0.0], [0.0, 0.003, 0.004], [0.0, 0.002, 0.0]])

    def wrench(source, places, currents, frames):
        given.append(frames)
        return np.zeros((len(places), 6))

    axes = np.array([[0.6, 0.0, 0.8], [0.0, -0.8, -0.6], [0.36, 0.48, 0.8], [-0.48, 0.36, -0.8], [0, 0, -1]])
    magnet = SimpleNamespace(points=points, wrench=wrench, moment=1.0)
    balance = RigidBalance(as_field(tilted(polynomial_field)), np.ones(1), 0.01, 1.0, magnet)
    balance._wrench(np.zeros((5, 3)), axes)
    np.testing.assert_allclose(given[0][:, :, 2], axes, atol=1e-12)
    np.testing.assert_allclose(given[0] @ given[0].swapaxes(1, 2), [np.eye(3)] * 5, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(given[0]), 1.0)
    np.testing.assert_allclose(balance.arms, [[-0.0052] * 3, [0.0052] * 3])
    assert balance.evaluations == 5


@pytest.mark.parametrize(("model", "words"), [("loose", "loose"), ("rigid", "a magnet")])
def test_models_by_name(polynomial_field, model, words):
    with pytest.raises(InputError, match=words):
        stationary_points(tilted(polynomial_field), np.ones(1), PAYLOAD, 0.0, moment=model)


def test_a_lever_is_an_assumption_only_of_what_turns():
    told = {model: len(model_assumptions(model, 2e-3)) for model in MODELS}
    assert told == {"fixed": 1, "aligned": 1, "rigid": 2, "rigid upright": 1}
    assert " 2 mm below" in model_assumptions("rigid", 2e-3)[1]
