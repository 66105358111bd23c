"""Modes, output fields and cubature against linear algebra."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import nnls

from fieldmap.currents import (
    CoilGroups,
    CurrentDomain,
    IndependentCurrents,
    LiftAndDirections,
    parametrisation_from_json,
)
from fieldmap.maps.training.cubature import Cubature, candidates, nonnegative_path
from fieldmap.maps.training.currents import (
    at_rest,
    climbed,
    corner_signals,
    drawn,
    edge_shares,
    extreme_signals,
    held_out,
    is_among,
    nearest_of,
    reaches,
    sequence,
    training_signals,
)
from fieldmap.maps.training.modes import enough, output_fields, pivots, proper_modes


@pytest.fixture
def states():
    random = np.random.default_rng(1)
    return random.standard_normal((60, 12)) * np.geomspace(1, 1e-6, 12)


@pytest.fixture
def energy():
    square = np.random.default_rng(2).standard_normal((60, 60))
    return square @ square.T + 60 * np.eye(60)


def test_modes_are_orthonormal_and_the_best_there_are(states, energy):
    modes = states @ proper_modes(states, energy @ states, 5)
    np.testing.assert_allclose(modes.T @ energy @ modes, np.eye(5), atol=1e-9)
    left = states - modes @ (modes.T @ energy @ states)
    error = np.einsum("ns,nm,ms->", left, energy, left)
    # Eckart and Young: nothing of rank 5 leaves less than the discarded singular values.
    singular = np.linalg.svd(np.linalg.cholesky(energy).T @ states, compute_uv=False)
    assert error == pytest.approx((singular[5:] ** 2).sum(), rel=1e-6)


def test_no_more_modes_than_the_tolerance_asks_for(states, energy):
    sizes = np.sqrt(np.einsum("ns,nm,ms->s", states, energy, states))
    states = states / sizes
    applied = energy @ states
    modes = states @ proper_modes(states, applied, 12)
    for tolerance in (0.5, 1e-2, 1e-4):
        count = enough(applied.T @ modes, tolerance)
        for some, within in ((modes[:, :count], True), (modes[:, : count - 1], False)):
            left = states - some @ (some.T @ applied)
            size = np.sqrt(np.einsum("ns,nm,ms->s", left, energy, left)).max()
            assert (size <= tolerance * (1 + 1e-6)) == within


def test_output_fields_leave_the_next_singular_value_and_are_as_few_as_the_tolerance_asks_for():
    random = np.random.default_rng(3)
    amplitudes = random.standard_normal((40, 10)) * np.geomspace(1, 1e-4, 10)
    fields = random.standard_normal((10, 200))
    truth = amplitudes @ fields
    singular = np.append(np.linalg.svd(truth, compute_uv=False)[:10], 0.0)

    def left(most, tolerance=0.0):
        combination, weights = output_fields(amplitudes, fields, most, tolerance)
        assert np.abs(amplitudes @ weights.T).max() == pytest.approx(1.0)
        return len(weights), (amplitudes @ weights.T) @ (combination @ fields) - truth

    for k in (3, 6, 10):
        assert np.linalg.norm(left(k)[1], 2) <= 1.001 * singular[k] + 2e-9 * singular[0]

    def worst(*asked):
        return (np.linalg.norm(left(*asked)[1], axis=1) / np.linalg.norm(truth, axis=1)).max()

    for tolerance in (0.1, 1e-3):
        count = left(10, tolerance)[0]
        assert worst(10, tolerance) <= tolerance < worst(count - 1)
        assert count < 10
    assert left(2, 1e-3)[0] == 2


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_there_are_no_more_output_fields_than_independent_ones(size):
    """Ten modes with fields that are combinations of three, of any size."""
    random = np.random.default_rng(13)
    amplitudes, fields = (
        random.standard_normal((20, 10)),
        random.standard_normal((10, 3)) @ random.standard_normal((3, 50)),
    )
    combination, weights = output_fields(amplitudes, size * fields, 8, 0.0)
    assert combination.shape == weights.shape == (3, 10)
    np.testing.assert_allclose(amplitudes @ weights.T @ combination @ fields, amplitudes @ fields, atol=1e-9)
    # A state without amplitudes has no field to miss.
    amplitudes[4] = 0.0
    assert len(output_fields(amplitudes, size * fields, 8, 1e-3)[0]) == 3


def corners(domain):
    """Their currents (m, c)."""
    return domain.parametrisation.currents(corner_signals(domain))


def add(cubature, parts):
    """States with these parts (p, r)."""
    cubature.add([part.__getitem__ for part in parts], [part.sum(axis=0) for part in parts])


def chosen(parts, most, tolerance):
    """Points and factors of a cubature of states with these parts (p, r)."""
    cubature = Cubature(len(parts[0]), np.arange(len(parts[0])))
    add(cubature, parts)
    factors, _ = cubature.factors(tolerance, most)
    points = np.flatnonzero(factors)
    return points, factors[points]


def test_cubature_integrates_what_it_was_made_for_with_few_positive_weights():
    x = (np.arange(3000) + 0.5) / 1500 - 1
    volume = np.full(x.size, 2 / 3000)
    # Two "states" of six "residuals" each, all polynomials of degree 9 at most.
    powers = np.array([x**k for k in range(10)]).T * volume[:, None]
    points, factors = chosen([powers[:, :6], powers[:, 4:]], 10, 1e-9)
    assert len(points) <= 10
    assert (factors > 0).all()
    for k in range(10):
        exact = (1 - (-1) ** (k + 1)) / (k + 1)
        assert factors @ powers[points, k] == pytest.approx(exact, abs=1e-6)


def test_fewer_points_serve_a_coarser_tolerance_and_what_they_leave_is_the_states_error():
    random = np.random.default_rng(7)
    volume = np.full(1500, 1 / 1500)
    # Fields of falling size: for a coarser tolerance fewer of them matter.
    shape = random.standard_normal((1500, 80)) * np.geomspace(1.0, 1e-6, 80)
    parts = [shape @ random.standard_normal((80, 40)) * volume[:, None] + volume[:, None] for _ in range(10)]
    numbers = []
    for tolerance in (3e-3, 3e-4, 3e-5):
        points, factors = chosen(parts, 200, tolerance)
        left = [part.sum(axis=0) - factors @ part[points] for part in parts]
        error = np.sqrt(np.mean([(off**2).sum() for off in left]))
        assert error <= 1.01 * tolerance
        assert factors.sum() == pytest.approx(1500, rel=0.01)
        numbers.append(len(points))
    assert numbers[0] + 4 < numbers[1] < numbers[2] - 4


def test_what_is_left_is_that_of_all_residuals_however_few_the_points():
    """Uncorrelated residuals, many more than points: a fit to fewer conditions would not show the error."""
    random = np.random.default_rng(8)
    parts = [1.0 + 0.02 * random.standard_normal((2000, 60)) for _ in range(20)]
    for tolerance in (20.0, 10.0):
        points, factors = chosen(parts, 600, tolerance)
        left = [part.sum(axis=0) - factors @ part[points] for part in parts]
        error = np.sqrt(np.mean([(off**2).sum() for off in left]))
        assert len(points) < 600
        assert 0.8 * tolerance < error <= tolerance


def test_states_that_are_added_are_met_by_the_next_choice_which_begins_with_the_points_of_the_last():
    random = np.random.default_rng(9)
    volume = np.full(800, 1 / 800)
    shape = random.standard_normal((800, 60)) * np.geomspace(1.0, 1e-5, 60)
    parts = [shape @ random.standard_normal((60, 20)) * volume[:, None] + volume[:, None] for _ in range(6)]
    together = Cubature(800, np.arange(800))
    add(together, parts)
    growing = Cubature(800, np.arange(800))
    add(growing, parts[:4])
    first, _ = growing.factors(1e-4, 300)
    add(growing, parts[4:])
    for factors, left in (together.factors(1e-4, 300), growing.factors(1e-4, 300)):
        error = [np.linalg.norm(part.sum(axis=0) - factors @ part) for part in parts]
        assert left <= 1.0
        assert np.sqrt(np.mean(np.square(error))) <= 1.01e-4
    without = [np.linalg.norm(part.sum(axis=0) - first @ part) for part in parts[4:]]
    assert min(without) > 1.5e-4


def test_tangents_are_met_where_residuals_ask_for_a_point_alone():
    """All states are alike: one point would give their residual, and a tangent of zero in all other directions."""
    random = np.random.default_rng(10)
    rows = random.standard_normal((500, 3, 60)) / np.sqrt(1500.0)
    whole = np.einsum("pij,pik->jk", rows, rows)
    part = np.full((500, 1), 1 / 500)
    found = {}
    for kind in ("residuals", "tangents"):
        cubature = Cubature(500, np.arange(500))
        add(cubature, [part])
        if kind == "tangents":
            cubature.add_tangent(whole, lambda points: rows[points])
        factors, left = cubature.factors(1e-4, 500)
        assert left <= 1.0
        assert factors @ part == pytest.approx(1.0, abs=1e-3)
        ratio = np.linalg.solve(whole, np.einsum("p,pij,pik->jk", factors, rows, rows))
        found[kind] = np.linalg.eigvals(ratio).real.min()
    assert found["residuals"] < 1e-6
    assert found["tangents"] > 0.5


def test_points_to_choose_from_are_drawn_by_what_they_add():
    importance = np.where(np.arange(1000) < 100, 1.0, 1e-3)
    drawn = candidates(importance, 200)
    assert len(drawn) == len(np.unique(drawn)) == 200
    assert (drawn < 100).sum() > 70
    np.testing.assert_array_equal(candidates(importance, 2000), np.arange(1000))


def test_extremes_are_single_coils_equal_and_opposite_currents_and_corners():
    box = CurrentDomain(IndependentCurrents(3), np.full(3, -2.0), np.full(3, 4.0))
    found = {tuple(row) for row in box.parametrisation.currents(extreme_signals(box)).round(9)}
    assert {(4.0, 0.0, 0.0), (0.0, -2.0, 0.0), (4.0, 4.0, 4.0), (-2.0, 0.0, 4.0), (2.0, 0.0, 0.0)} <= found
    assert {tuple(row) for row in corners(box)} <= found
    assert (0.0, 0.0, 0.0) not in found
    # The tip of a division is not a corner: the limit of u is higher where x and y are zero.
    domain = CurrentDomain(
        LiftAndDirections(1.25, limit=3.55), np.array([0.3, -0.4, -0.4]), np.array([3.55, 0.4, 0.4])
    )
    signals = extreme_signals(domain)
    assert (signals == [3.55, 0.0, 0.0]).all(axis=1).any()
    assert all(domain.holds(values) for values in domain.parametrisation.currents(signals))
    many = CurrentDomain(IndependentCurrents(20), np.full(20, -1.0), np.full(20, 1.0))
    # All signals at half of their ranges are zero currents, so this extreme is left out.
    assert len(extreme_signals(many)) == 20 * 6 + 2 + 128 + 256


UNEVEN = CurrentDomain(IndependentCurrents(2), np.array([-1.0, 2.0]), np.array([3.0, 4.0]))


def test_extremes_of_two_signals_one_by_one():
    """The first signal rests at 0; the second cannot be 0 and rests in its middle."""
    assert at_rest(UNEVEN).tolist() == [0.25, 0.5]
    edges = CurrentDomain(IndependentCurrents(3), np.array([0.0, -2.0, -2.0]), np.array([4.0, 0.0, -1.0]))
    assert at_rest(edges).tolist() == [0.0, 1.0, 0.5]
    found = extreme_signals(UNEVEN)
    alone = [[-1, 3], [3, 3], [-0.5, 3], [1.5, 3], [-0.02, 3], [0.06, 3]]
    alone += [[0, 2], [0, 4], [0, 2.5], [0, 3.5], [0, 2.98], [0, 3.02]]
    # A quarter of both ranges is already among the extremes of the second signal alone.
    np.testing.assert_allclose(found[:14], [*alone, [1, 3], [2, 3.5]], atol=1e-12)
    assert sorted(found[14:].tolist()) == [[-1, 2], [-1, 4], [3, 2], [3, 4]]


def test_steps_of_tangents_are_an_eighth_of_the_ranges():
    np.testing.assert_allclose(reaches(UNEVEN, np.array([0.0, 3.0])), [[0.5, 0.0], [0.0, 0.25]], atol=1e-15)
    np.testing.assert_array_equal(reaches(UNEVEN, np.zeros(2), True), reaches(UNEVEN, np.zeros(2)))
    groups = CurrentDomain(CoilGroups([[0, 2], [1]]), np.array([-1.0, 0.0]), np.array([3.0, 2.0]))
    wanted = [[0.5, 0.0, 0.375, 0.0, 0.0], [0.0, 0.25, 0.0, 0.25, 0.0], [0.5, 0.0, 0.0, 0.0, 0.375]]
    np.testing.assert_allclose(reaches(groups, np.zeros(2), True), wanted, atol=1e-15)


def test_states_of_the_sequence_are_denser_towards_the_faces():
    """By 0.5 - 0.5 cos(pi t) of a net in t: the same number in each quarter of t."""
    shares = (sequence(UNEVEN, 65) - UNEVEN.lower) / (UNEVEN.upper - UNEVEN.lower)
    for row in shares[1:].T:
        ends = [0.0, 0.5 - 0.5 * np.cos(0.25 * np.pi), 0.5, 0.5 - 0.5 * np.cos(0.75 * np.pi), 1.0]
        assert np.histogram(row, ends)[0].tolist() == [16, 16, 16, 16]
    np.testing.assert_array_equal(sequence(UNEVEN, 1), [UNEVEN.middle])


def test_every_second_drawn_state_is_nearer_to_rest():
    """Uniform draws alternate with draws scaled by 10^(-2 t), t uniform, with the mean (1 - 1/100) / (2 ln 10)."""
    shares = (drawn(UNEVEN, 200_000, np.random.default_rng(5)) - UNEVEN.lower) / (UNEVEN.upper - UNEVEN.lower)
    away = np.abs(shares - [0.25, 0.5])
    for row, half in zip((shares - [0.25, 0.5]).T, (0.75, 0.5), strict=True):
        assert np.abs(row).max() == pytest.approx(half, rel=1e-3)
    assert away[::2].mean(axis=0) == pytest.approx([(0.25**2 + 0.75**2) / 2, 0.25], rel=0.01)
    nearer = 0.99 / (2.0 * np.log(10.0))
    assert away[1::2].mean(axis=0) == pytest.approx(nearer * away[::2].mean(axis=0), rel=0.02)


def test_currents_are_the_same_within_a_billionth_of_the_largest():
    states = np.array([[1.0, -2.0], [0.0, 1.0], [1.0, -2.0 + 1.9e-9], [1.0 + 2.1e-9, -2.0]])
    assert is_among(np.array([1.0, -2.0]), states).tolist() == [True, False, True, False]
    assert [nearest_of(np.array(at), states[:2]) for at in ([0.9, -0.6], [0.9, -0.3])] == [0, 1]


def images_of(*matrices):
    return [SimpleNamespace(currents=matrix.__matmul__) for matrix in matrices]


def test_every_fourth_state_lies_half_way_to_an_image_in_turn():
    """Two mirrors, an image outside the box, the identity, and the reversal of all currents."""
    box = CurrentDomain(IndependentCurrents(3), np.full(3, -1.0), np.ones(3))
    first, second = np.diag([-1.0, 1.0, 1.0]), np.eye(3)[[0, 2, 1]]
    images = images_of(first, 2.0 * np.eye(3), np.eye(3), second, -np.eye(3))
    plain, signals = sequence(box, 17), training_signals(box, 17, images)
    moved = np.flatnonzero((plain != signals).any(axis=1))
    assert moved.tolist() == [3, 7, 11, 15]
    own = plain[moved]
    near = [
        np.linalg.norm(0.5 * (own + own @ of.T), axis=1) > 0.5 * np.linalg.norm(own, axis=1)
        for of in (first, second)
    ]
    assert near[1].all()
    for k, (row, both) in enumerate(zip(own, near[0], strict=True)):
        of = (first, second)[k % 2] if both else second
        np.testing.assert_allclose(signals[moved[k]], 0.5 * (row + of @ row), atol=1e-12)


@pytest.mark.parametrize(
    ("lower", "upper", "count", "second"),
    [(-1.0, 3.0, 2, True), (-1.0, 3.0, 1, False), (-1.0, 1.0, 2, False), (0.5, 3.0, 2, False)],
)
def test_the_second_state_is_without_currents_where_that_is_another_in_the_domain(
    lower, upper, count, second
):
    box = CurrentDomain(IndependentCurrents(2), np.full(2, lower), np.full(2, upper))
    signals = training_signals(box, count, (), off=True)
    assert signals[0].tolist() == box.middle.tolist()
    assert (signals[-1].tolist() == [0.0, 0.0]) == second
    np.testing.assert_array_equal(training_signals(box, count, ()), sequence(box, count))


def test_the_states_fill_the_box_and_the_held_out_ones_are_others():
    box = CurrentDomain(IndependentCurrents(3), np.array([0.0, -1.0, 2.0]), np.array([1.0, 1.0, 5.0]))
    training, tried = sequence(box, 40), held_out(box, 12)
    assert training.shape == (40, 3)
    assert (training[0] == box.middle).all()
    for states in (training, tried):
        assert (states >= box.lower).all()
        assert (states <= box.upper).all()
    assert np.ptp(training, axis=0) == pytest.approx(box.upper - box.lower, rel=0.01)
    for others in (tried, corners(box)):
        distance = np.linalg.norm(training[:, None] - others[None], axis=2)
        assert distance.min() > 1e-3
    assert len({tuple(corner) for corner in corners(box)}) == 8


def test_of_many_corners_some_are_taken():
    lower, upper = np.arange(10.0), 10.0 + np.arange(10.0)
    taken = corners(CurrentDomain(IndependentCurrents(10), lower, upper))
    assert ((taken == lower) | (taken == upper)).all()
    assert len(np.unique(taken, axis=0)) == len(taken) == 256
    assert len(corners(CurrentDomain(IndependentCurrents(8), lower[:8], upper[:8]))) == 256
    # Each coil is about equally often at either end.
    assert np.abs((taken == lower).mean(axis=0) - 0.5).max() < 0.2


def test_a_domain_holds_its_states_and_no_others():
    box = CurrentDomain(IndependentCurrents(2), np.array([0.0, -1.0]), np.array([1.0, 1.0]))
    lower, upper = np.array([1.0, -0.4, -0.3]), np.array([2.2, 0.4, 0.3])
    family = CurrentDomain(LiftAndDirections(1.25), lower, upper)
    limited = CurrentDomain(LiftAndDirections(1.25, 2.5), lower, upper)
    for domain in (box, family, limited):
        trained = domain.parametrisation.currents(sequence(domain, 5))
        for currents in (*corners(domain), *held_out(domain, 5), *trained):
            assert domain.holds(currents)
            assert not domain.holds(currents + 3.0)
        anywhere = domain.at(np.random.default_rng(3).random((500, len(domain.lower))))
        assert (np.abs(anywhere) <= domain.largest).all()
        assert (domain.largest >= np.abs(corners(domain)).max(axis=0) * (1 - 1e-12)).all()
    for domain in (box, family):
        assert domain.largest == pytest.approx(np.abs(corners(domain)).max(axis=0))
    # The mirror y = 0 exchanges coils 1, 3 and 4, 6 and the sign of y. A change of one coil leaves the division.
    off_axis = family.parametrisation.currents(np.array([1.5, 0.2, 0.1]))
    assert family.holds(off_axis[[2, 1, 0, 5, 4, 3]])
    assert not family.holds(off_axis + np.array([0.1, 0, 0, 0, 0, 0]))


def test_the_limit_of_the_currents_ends_the_domain():
    """The domain ends where a coil reaches the limit, in any direction; the shares of the domain fill the rest."""
    lower, upper = np.array([0.3, -0.4, -0.4]), np.array([3.55, 0.4, 0.4])
    domain = CurrentDomain(LiftAndDirections(1.25, 3.55), lower, upper)
    ends = domain.at(np.column_stack([np.ones(200), np.random.default_rng(1).random((200, 2))]))
    assert np.abs(ends).max(axis=1) == pytest.approx(np.full(200, 3.55), rel=1e-12)
    assert domain.at(np.array([1.0, 0.5, 0.5])) == pytest.approx(np.full(6, 3.55))
    assert domain.largest.max() == 3.55
    inside = domain.at(np.array([0.9, 0.1, 0.7]))
    assert domain.holds(inside)
    # Signals in the box, but one coil above the limit.
    beyond = domain.parametrisation.currents(np.array([3.0, 0.4, 0.4]))
    assert not domain.holds(beyond)
    assert domain.parametrisation.excess(np.array([3.0, 0.4, 0.4])) == pytest.approx(
        beyond.max() / 3.55 - 1.0
    )
    again = parametrisation_from_json(domain.parametrisation.to_json())
    assert again == domain.parametrisation


def sparse_nonnegative(matrix, wanted, tolerance):
    """The first point of the path that leaves at most this share, or the last point."""
    size = float(np.linalg.norm(wanted))
    path = list(nonnegative_path(matrix.T @ matrix, wanted @ matrix, size, len(matrix)))
    return next((x for x, left in path if left <= max(tolerance, 1e-7)), path[-1][0])


def test_sparse_least_squares_are_those_of_lawson_and_hanson():
    random = np.random.default_rng(5)
    points, waves = random.random((900, 3)), random.integers(0, 6, (60, 3))
    functions = np.cos(np.pi * (points @ waves.T) + random.random(60))
    matrix = np.linalg.qr(functions)[0].T
    wanted = matrix.sum(axis=1)
    theirs, left = nnls(matrix, wanted)
    assert left < 1e-10
    for tolerance in (1e-7, 1e-2):
        ours = sparse_nonnegative(matrix, wanted, tolerance)
        assert (ours >= 0).all()
        assert (ours > 0).sum() <= (theirs > 0).sum() == 60
        assert np.linalg.norm(matrix @ ours - wanted) <= tolerance * np.linalg.norm(wanted)
    # Without an exact solution: the same least error.
    random_matrix, target = random.standard_normal((40, 15)), random.standard_normal(40)
    _, least = nnls(random_matrix, target)
    ours = sparse_nonnegative(random_matrix, target, 0.0)
    assert np.linalg.norm(random_matrix @ ours - target) == pytest.approx(least, rel=1e-9)


def test_on_the_way_to_the_least_error_each_unknown_is_the_least_squares_of_those_that_are_there():
    """Against scipy's solution with the present columns; the remaining error against the matrix itself."""
    random = np.random.default_rng(8)
    matrix = random.random((80, 120))
    wanted = matrix @ random.random(120)
    size = float(np.linalg.norm(wanted))
    counts, lefts = [], []
    for x, left in nonnegative_path(matrix.T @ matrix, wanted @ matrix, size, 60):
        there = np.flatnonzero(x)
        counts.append(len(there))
        lefts.append(left)
        assert left == pytest.approx(np.linalg.norm(matrix @ x - wanted) / size, rel=1e-6)
        if len(there):
            theirs, _ = nnls(matrix[:, there], wanted)
            np.testing.assert_allclose(x[there], theirs, rtol=1e-6, atol=1e-9 * theirs.max())
    assert lefts[0] == pytest.approx(1.0)
    assert (np.diff(lefts) < 0.0).all()
    assert counts[0] == 0
    assert len(counts) > 5
    assert max(np.diff(counts)) <= 12
    assert 50 < counts[-1] <= 60


@pytest.mark.parametrize("second", [[0.5, 0.5], [0.75, -0.25], [1.0, 1.0]])
def test_an_unknown_that_stays_zero_leaves(second):
    """The unknown enters together with another one that gives the whole demand."""
    matrix = np.array([[1.0, 0.0], second]).T
    assert sparse_nonnegative(matrix, np.array([1.0, 0.0]), 0.0) == pytest.approx([1.0, 0.0], abs=1e-11)


def test_states_are_chosen_by_what_the_others_do_not_say():
    random = np.random.default_rng(6)
    modes = np.linalg.qr(random.standard_normal((50, 3)))[0]
    # Three corrections that span two directions, a small one in a third direction, and a zero one.
    corrections = np.column_stack(
        [9 * modes[:, 0], 8.9 * modes[:, 0], 5 * modes[:, 1], 0.1 * modes[:, 2], 0 * modes[:, 0]]
    )
    product = corrections.T @ corrections
    assert pivots(product, 3).tolist() == [0, 2, 3]
    assert set(pivots(product, 5).tolist()) <= {0, 1, 2, 3}
    assert pivots(product, 5, 4.9**2).tolist() == [0, 2]
    # The rest after k choices is the Schur complement: no other choice of one state leaves less of the largest.
    square = random.standard_normal((6, 6))
    product = square @ square.T
    first, second = pivots(product, 2)
    assert first == np.diag(product).argmax()
    rest = product - np.outer(product[first], product[first]) / product[first, first]
    assert second == np.diag(rest).argmax()


def test_a_division_gives_the_currents_of_the_thesis():
    # (6-2), (6-3) at u = 1.558 A, x = 0.2, y = 0: coils 1, 3 and 4, 6 by 1 -+ x, coils 2 and 5 by 1 -+ n x.
    family = CurrentDomain(LiftAndDirections(1.25), np.array([1.0, -0.4, -0.3]), np.array([2.2, 0.4, 0.3]))
    got = family.parametrisation.currents(np.array([1.558, 0.2, 0.0])) / 1.558
    np.testing.assert_allclose(got, [0.8, 0.75, 0.8, 1.2, 1.25, 1.2], rtol=1e-12)
    assert sequence(family, 9).shape == (9, 3)
    means = family.parametrisation.currents(sequence(family, 40)).mean(axis=1)
    assert (means >= 1.0).all()
    assert (means <= 2.2).all()
    assert len(corners(family)) == 8
    assert family.middle == pytest.approx(np.full(6, 1.6))


CUBE = CurrentDomain(IndependentCurrents(3), np.array([-1.0, 0.0, 2.0]), np.array([1.0, 4.0, 3.0]))


def test_edges_are_where_all_signals_but_one_are_at_their_ends():
    shares = edge_shares(CUBE, 400, np.random.default_rng(4))
    at_ends = (shares == 0.0) | (shares == 1.0)
    assert (at_ends.sum(axis=1) == 2).all()
    # All twelve edges of a cube, and places all along them.
    assert len({(*np.where(row, one, -1.0),) for row, one in zip(at_ends, shares, strict=True)}) == 12
    assert np.ptp(shares[~at_ends]) > 0.95


def test_the_search_climbs_towards_a_peak_on_an_edge():
    """For a peak a fifth of the ranges wide, the starting currents see less than half of it, on average."""
    peak, width = np.array([1.0, 0.37, 0.0]), 0.2
    asked = []

    def looks(currents):
        shares = (currents - CUBE.lower) / (CUBE.upper - CUBE.lower)
        assert ((shares > -1e-12) & (shares < 1.0 + 1e-12)).all()
        asked.append(len(shares))
        return 1.0 / (1.0 + ((shares - peak) ** 2).sum(axis=1) / width**2)

    begun, ended = [], []
    for seed in range(12):
        random = np.random.default_rng(seed)
        begin = random.random((64, 3))
        begun.append(looks(CUBE.at(begin)).max())
        asked.clear()
        shares, looked_at = climbed(looks, CUBE, begin, random)
        assert looked_at == sum(asked)
        found = looks(CUBE.at(shares))
        assert (np.diff(found) <= 1e-12).all()
        assert found[0] >= begun[-1]
        ended.append(found[0])
    assert np.mean(begun) < 0.5
    assert np.mean(ended) > 0.75


def test_the_search_goes_on_from_the_ten_best_places_with_three_neighbours_of_each():
    """In the given random directions, by 15 % and 5 % of a range where the signals are farthest from rest."""
    box = CurrentDomain(IndependentCurrents(1), np.array([-1.0]), np.array([3.0]))
    asked, told = [], []

    def looks(currents):
        asked.append((currents[:, 0] + 1.0) / 4.0)
        return currents[:, 0]

    steps = iter([np.tile([[-1.0], [1.0], [0.5]], (10, 1)), np.tile([[0.2], [-2.0], [1.0]], (10, 1))])
    random = SimpleNamespace(standard_normal=lambda shape: next(steps).reshape(shape))
    begin = np.array([0.0, 0.1, *np.arange(0.15, 0.5, 0.04), 0.9])
    shares, looked_at = climbed(looks, box, begin[:, None], random, told.append)
    assert looked_at == 12 + 30 + 30
    assert told == pytest.approx([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0])
    np.testing.assert_allclose(asked[0], begin)
    # Rest is at a quarter, and 0.75 of the range away from its farther end.
    best = begin[:1:-1]
    first = best[:, None] + 0.15 * np.abs(best - 0.25)[:, None] / 0.75 * np.array([-1.0, 1.0, 0.5])
    first = np.clip(first, 0.0, 1.0)
    np.testing.assert_allclose(asked[1], first.ravel())
    best = first[:, 1]
    second = best[:, None] + 0.05 * np.abs(best - 0.25)[:, None] / 0.75 * np.array([0.2, -2.0, 1.0])
    second = np.clip(second, 0.0, 1.0)
    np.testing.assert_allclose(asked[2], second.ravel())
    np.testing.assert_allclose(shares[:, 0], np.sort(second[:, 2])[::-1])


@pytest.mark.parametrize("modes", [6, 3])
def test_the_error_that_a_choice_leaves_is_that_of_states_volume_and_tangents(modes):
    """Each over its own allowance: the tolerance; a thousandth of the volume; and for a tangent a quarter of the number
    of modes, at least of four, by Wigner's semicircle, times a half squared."""
    random = np.random.default_rng(12)
    parts = [random.standard_normal((40, modes)) for _ in range(3)]
    rows, wholes = random.standard_normal((2, 40, 3, modes)), random.standard_normal((2, modes, modes))
    wholes += np.swapaxes(wholes, 1, 2)
    cubature, tolerance = Cubature(40, np.arange(40)), 0.3
    add(cubature, parts)
    for kinds in (0, 2):
        for of, whole in zip(rows[:kinds], wholes, strict=False):
            cubature.add_tangent(whole, lambda points, of=of: of[points])
        factors, left = cubature.factors(tolerance, 5)
        assert np.count_nonzero(factors) == 5
        off = [np.linalg.norm(part.sum(axis=0) - factors @ part) for part in parts]
        total = np.sum(np.square(off)) / tolerance**2 / 3 + ((factors.sum() - 40) / (1e-3 * 40)) ** 2
        for of, whole in zip(rows[:kinds], wholes, strict=False):
            missed = ((whole - np.einsum("p,pij,pik->jk", factors, of, of)) ** 2).sum()
            total += missed / (kinds * 0.25 * max(modes, 4) / 4)
        assert left == pytest.approx(np.sqrt(total), rel=1e-6)


def test_candidates_are_drawn_by_importance_and_a_tenth_of_its_mean():
    importance = np.repeat([1.0, 0.0], [10, 90])
    counts = np.bincount([candidates(importance, 1, seed)[0] for seed in range(4000)], minlength=100)
    # The probabilities are 1 + 0.01 for each of ten, and 0.01 for each of ninety.
    assert counts[:10].sum() / 4000 == pytest.approx(10.1 / 11.0, abs=0.015)
    assert counts[10:].any()
    assert [len(candidates(importance, count)) for count in (99, 100, 101)] == [99, 100, 100]
