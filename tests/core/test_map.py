"""Maps in the C core, in all forms: no reads beyond a block, odd points, superposition, lanes, single points, and
refused input; every compiled library against the same polynomials in numpy."""

import pickle

import numpy as np
import pytest

from fieldmap.core import CoreMap
from fieldmap.core import block as map_block
from fieldmap.interpolants.form import Form, contract
from tests.core.map_cases import CURRENTS, GRID, KINDS, block_of
from tests.lookup.reference_evaluator import ReferenceEvaluator


def evaluated(block, points, currents=None):
    flux, slope = np.empty((len(points), 3)), np.empty((len(points), 3, 3))
    outside = CoreMap(block).fields(
        points, None if currents is None else np.atleast_2d(currents), flux, slope
    )
    return flux, slope, outside


def grid_points():
    """All nodes, points on faces, a point beyond the upper corner by rounding, and random points."""
    beyond = GRID.upper + 1e-12
    some = GRID.lower + np.random.default_rng(8).random((40, 3)) * (GRID.upper - GRID.lower)
    return np.concatenate([GRID.points(), GRID.points() * (1 - 1e-15), [beyond], [GRID.upper], some])


def expected_of(kind, block, points, weights):
    """By the evaluator in numpy."""
    flux, slope = np.empty((len(points), 3)), np.empty((len(points), 3, 3))
    second = np.empty((len(points), 3, 3, 3))
    reference = ReferenceEvaluator(Form(kind, block, block, None))
    reference.field_and_gradient(points, np.atleast_2d(weights), flux, slope)
    reference.second_gradient(points, np.atleast_2d(weights), second)
    return flux, slope, second


@pytest.mark.parametrize(
    ("kind", "degree"), [("hermite", 0), ("harmonic", 5), ("global", 5), ("global", 16), ("global", 3)]
)
def test_fields_are_those_of_numpy_with_weights_of_each_point_or_of_all(kind, degree):
    block, _ = block_of(kind, degree=degree)
    points = GRID.lower + np.random.default_rng(5).random((21, 3)) * (GRID.upper - GRID.lower)
    each = np.random.default_rng(6).normal(size=(21, 2))
    core, second = CoreMap(block), np.empty((21, 3, 3, 3))
    for weights in (CURRENTS, each):
        flux, slope, bend = expected_of(kind, block, points, weights)
        ours, our_slope, outside = evaluated(block, points, weights)
        assert outside == 0
        assert core.second_gradients(points, np.atleast_2d(weights), second) == 0
        for found, wanted in ((ours, flux), (our_slope, slope), (second, bend)):
            np.testing.assert_allclose(found, wanted, rtol=0, atol=2e-12 * np.abs(wanted).max())
    alone = np.empty((21, 3))
    assert core.fields(points, each, alone, None) == 0
    np.testing.assert_array_equal(alone, ours)


@pytest.mark.parametrize("kind", list(KINDS))
def test_every_place_of_the_box_can_be_read_and_nothing_beyond(kind):
    block, size = block_of(kind)
    points = np.clip(grid_points(), GRID.lower - 1e-12, GRID.upper + 1e-12)
    fixed = contract(block, CURRENTS, size)
    flux, slope, outside = evaluated(fixed, points)
    assert outside == 0
    assert np.isfinite(flux).all()
    assert np.isfinite(slope).all()
    again, slope_again, _ = evaluated(block, points, CURRENTS)
    np.testing.assert_allclose(again, flux, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(slope_again, slope, rtol=1e-12, atol=1e-10)
    core = CoreMap(fixed)
    for point, one_flux, one_slope in zip(points, flux, slope, strict=True):
        found = core.field_at(point, None)
        np.testing.assert_allclose(found[0], one_flux, rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(found[1], one_slope, rtol=1e-12, atol=1e-11)


ODD = np.array(
    [
        [np.nan, 0.25, 1.1],
        [-0.2, np.inf, 1.1],
        [-0.2, 0.25, -np.inf],
        [1e300, 0.25, 1.1],
        [-0.2, -1e300, 1.1],
        [-0.2, 0.25, 2.0],
        [-0.2, 0.25, 1.1],
    ]
)


@pytest.mark.parametrize("kind", list(KINDS))
def test_odd_points(kind):
    block, size = block_of(kind)
    fixed = contract(block, CURRENTS, size)
    flux, slope, outside = evaluated(fixed, ODD)
    assert outside == 3
    second, values = np.empty((7, 3, 3, 3)), np.empty(7)
    units, unit_slopes = np.empty((7, 2, 3)), np.empty((7, 2, 3, 3))
    core = CoreMap(block)
    assert core.second_gradients(ODD, CURRENTS[None], second) == 3
    assert core.each_field(ODD, units, unit_slopes) == 3
    found = [flux, slope, second, units, unit_slopes]
    if kind != "hermite":
        assert core.potentials(ODD, CURRENTS[None], values) == 3
        found.append(values)
    for result in found:
        assert np.isnan(result[:6]).all()
        assert np.isfinite(result[6]).all()
    assert [CoreMap(fixed).field_at(point, None) is None for point in ODD] == [True] * 6 + [False]


@pytest.mark.parametrize("kind", list(KINDS))
def test_clamped_points(kind):
    block, size = block_of(kind, "clamp")
    fixed = contract(block, CURRENTS, size)
    flux, _, outside = evaluated(fixed, ODD)
    assert outside == 0
    assert np.isnan(flux[:3]).all()
    nearest = np.clip(ODD[3:6], GRID.lower, GRID.upper)
    expected, _, _ = evaluated(fixed, nearest)
    np.testing.assert_allclose(flux[3:6], expected, rtol=1e-9)
    np.testing.assert_allclose(CoreMap(fixed).field_at(ODD[3], None)[0], expected[0], rtol=1e-9)


@pytest.mark.parametrize("kind", list(KINDS))
def test_sets_by_themselves_and_superposed(kind):
    block, size = block_of(kind)
    points = GRID.lower + np.random.default_rng(5).random((4, 3)) * (GRID.upper - GRID.lower)
    flux, slope = np.empty((4, 2, 3)), np.empty((4, 2, 3, 3))
    assert CoreMap(block).each_field(points, flux, slope) == 0
    total, total_slope, _ = evaluated(contract(block, CURRENTS, size), points)
    np.testing.assert_allclose(np.einsum("nci,c->ni", flux, CURRENTS), total, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(np.einsum("ncij,c->nij", slope, CURRENTS), total_slope, rtol=1e-10, atol=1e-9)


def test_contraction_is_the_weighted_sum():
    block, size = block_of("harmonic")
    out = contract(block, CURRENTS, size)
    sets = block[map_block.HEADER :].reshape(-1, 2, size)
    expected = np.einsum("psm,s->pm", sets, CURRENTS)
    np.testing.assert_allclose(out[map_block.HEADER :].reshape(-1, size), expected, rtol=1e-13, atol=1e-15)
    assert out[map_block.SETS] == 1


@pytest.mark.parametrize("kind", list(KINDS))
def test_one_point_answers_what_fits_and_nothing_else(kind):
    """Random numbers at the nodes of the Hermite form, so that rows and columns of the gradient differ."""
    block, _ = block_of(kind)
    core, place, moment = CoreMap(block), ODD[6], np.array([0.3, -0.7, 1.1])
    flux, slope, _ = evaluated(block, place[None], CURRENTS)
    wanted = np.concatenate([moment @ slope[0], np.cross(moment, flux[0])])
    np.testing.assert_allclose(core.dipole_wrench_at(place, moment, CURRENTS), wanted, rtol=1e-12, atol=1e-13)
    good = (place, CURRENTS)
    wrong = {
        0: [place.tolist(), place[:2], place[None], place.astype(np.float32), np.repeat(place, 2)[::2], None],
        1: [CURRENTS.tolist(), CURRENTS[:1], CURRENTS[None], CURRENTS.astype(complex), 1.0, None],
    }
    assert core.field_at(*good) is not None
    for position, given in wrong.items():
        for one in given:
            asked = [one if k == position else each for k, each in enumerate(good)]
            assert core.field_at(*asked) is None
            assert core.dipole_wrench_at(asked[0], moment, asked[1]) is None
    assert core.dipole_wrench_at(place, moment[:2], CURRENTS) is None
    beside = CoreMap(block, constant=True)
    found, wanted = beside.field_at(place, CURRENTS[:1]), core.field_at(place, np.array([CURRENTS[0], 1.0]))
    np.testing.assert_array_equal(found[0], wanted[0])
    assert beside.field_at(place, CURRENTS) is None


def test_arrays_that_do_not_fit_are_refused_before_anything_is_written():
    block, _ = block_of("harmonic")
    core, points = CoreMap(block), GRID.points()
    flux, slope = np.full((len(points), 3), 7.0), np.full((len(points), 3, 3), 7.0)
    read_only = flux.copy()
    read_only.flags.writeable = False
    one = CURRENTS[None]
    for given in (
        (points[:, :2], one, flux, slope),
        (points.T.copy().T, one, flux, slope),
        (points.astype(np.float32), one, flux, slope),
        (points, CURRENTS, flux, slope),
        (points, one[:, :1], flux, slope),
        (points, np.tile(CURRENTS, (3, 1)), flux, slope),
        (points, None, flux, slope),
        (points, one, flux[1:], slope),
        (points, one, flux.astype(np.float32), slope),
        (points, one, read_only, slope),
        (points, one, flux, slope[::-1]),
    ):
        with pytest.raises(TypeError):
            core.fields(*given)
    assert (flux == 7.0).all()
    assert (slope == 7.0).all()


def test_a_block_that_promises_other_numbers_is_refused():
    block, _ = block_of("harmonic")
    for place, value in (
        (map_block.KIND, 3.0),
        (map_block.KIND, np.nan),
        (map_block.SETS, 3.0),
        (map_block.SETS, 0.0),
        (map_block.DEGREE, 4.0),
        (map_block.DEGREE, 5.5),
        (map_block.CELLS, 3.0),
        (map_block.CELLS + 2, -1.0),
        (map_block.LOWER, np.inf),
        (map_block.INVERSE, 0.0),
        (map_block.LOCAL, -1.0),
        (map_block.RULE, 2.0),
    ):
        damaged = block.copy()
        damaged[place] = value
        with pytest.raises(ValueError, match="block"):
            CoreMap(damaged)
    for cut in (block[:-1].copy(), block[:10].copy()):
        with pytest.raises(ValueError, match="block"):
            CoreMap(cut)
    with pytest.raises(TypeError):
        CoreMap(block.astype(np.float32))


def test_a_map_can_be_pickled_and_outlives_the_name_of_its_block():
    core = CoreMap(block_of("harmonic")[0])
    again = pickle.loads(pickle.dumps(core))
    np.testing.assert_array_equal(again.field_at(ODD[6], CURRENTS)[1], core.field_at(ODD[6], CURRENTS)[1])


@pytest.mark.parametrize("kind", KINDS)
def test_of_a_field_that_no_current_drives_alone_no_weight_is_read(kind):
    block, size = block_of(kind)
    core, point = CoreMap(contract(block, CURRENTS, size), constant=True), np.array([-0.2, 0.25, 1.1])
    flux, slope = core.field_at(point, np.full(1, np.nan)[:0])
    wanted = CoreMap(block).field_at(point, CURRENTS)
    np.testing.assert_allclose(flux, wanted[0], rtol=1e-12)
    np.testing.assert_allclose(slope, wanted[1], rtol=1e-11)
