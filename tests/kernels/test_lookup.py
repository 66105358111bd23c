"""The kernels of a lookup in all forms: no read outside the block, odd points, superposition.

Small, because these tests run without compilation as well: there an index out of range raises.
"""

import math

import numpy as np
import pytest

from fieldmap.interpolants.form import contract, header
from fieldmap.kernels.map import cell_harmonics, dipole_wrench, global_harmonics, hermite, lookup, map_block
from fieldmap.store import Grid

GRID = Grid([-0.3, 0.2, 1.0], [0.11, 0.07, 0.13], (3, 2, 4))
KINDS = {
    "hermite": hermite.KERNELS,
    "harmonic": cell_harmonics.KERNELS,
    "global": global_harmonics.KERNELS,
}
CURRENTS = np.array([0.7, -1.3])


def block_of(kind, outside="nan"):
    """A block of random coefficients with two sets, and the size of a set."""
    box = Grid(GRID.lower, GRID.upper - GRID.lower, (2, 2, 2)) if kind == "global" else GRID
    degree = 0 if kind == "hermite" else 5
    start = header(KINDS[kind], box, 2, outside, degree, 1.0 if kind == "hermite" else 0.2)
    size = hermite.NODE if kind == "hermite" else 36
    places = math.prod(box.shape) if kind == "hermite" else math.prod(n - 1 for n in box.shape)
    return np.concatenate([start, np.random.default_rng(3).normal(size=places * 2 * size)]), size


def evaluated(block, points, currents=None):
    flux, slope = np.empty((len(points), 3)), np.empty((len(points), 3, 3))
    if currents is None:
        outside = lookup.evaluate(block, points, flux, slope)
    else:
        outside = lookup.evaluate_with(block, currents[None], points, flux, slope)
    return flux, slope, outside


def grid_points():
    """All nodes, points on faces and a rounding beyond the upper corner."""
    beyond = GRID.upper + 1e-12
    return np.concatenate([GRID.points(), GRID.points() * (1 - 1e-15), [beyond], [GRID.upper]])


@pytest.mark.parametrize("kind", list(KINDS))
def test_every_place_of_the_box_can_be_read(kind):
    block, size = block_of(kind)
    points = np.clip(grid_points(), GRID.lower - 1e-12, GRID.upper + 1e-12)
    flux, slope, outside = evaluated(contract(block, CURRENTS, size), points)
    assert outside == 0
    assert np.isfinite(flux).all()
    assert np.isfinite(slope).all()
    again, slope_again, _ = evaluated(block, points, CURRENTS)
    np.testing.assert_allclose(again, flux, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(slope_again, slope, rtol=1e-12, atol=1e-10)


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
    flux, slope, outside = evaluated(contract(block, CURRENTS, size), ODD)
    assert outside == 3
    assert np.isnan(flux[:6]).all()
    assert np.isnan(slope[:6]).all()
    assert np.isfinite(flux[6]).all()
    second, values = np.empty((7, 3, 3, 3)), np.empty(7)
    assert lookup.second_gradient(block, CURRENTS[None], ODD, second) == 3
    assert np.isnan(second[:6]).all()
    assert np.isfinite(second[6]).all()
    if kind != "hermite":
        assert lookup.potential(block, CURRENTS[None], ODD, values) == 3
        assert np.isnan(values[:6]).all()
        assert np.isfinite(values[6])


@pytest.mark.parametrize("kind", list(KINDS))
def test_clamped_points(kind):
    block, size = block_of(kind, "clamp")
    flux, _, outside = evaluated(contract(block, CURRENTS, size), ODD)
    assert outside == 0
    assert np.isnan(flux[:3]).all()
    nearest = np.clip(ODD[3:6], GRID.lower, GRID.upper)
    expected, _, _ = evaluated(contract(block, CURRENTS, size), nearest)
    np.testing.assert_allclose(flux[3:6], expected, rtol=1e-9)


@pytest.mark.parametrize("kind", list(KINDS))
def test_sets_by_themselves_and_superposed(kind):
    block, size = block_of(kind)
    points = GRID.lower + np.random.default_rng(5).random((4, 3)) * (GRID.upper - GRID.lower)
    flux, slope = np.empty((4, 2, 3)), np.empty((4, 2, 3, 3))
    assert lookup.evaluate_units(block, points, flux, slope) == 0
    total, total_slope, _ = evaluated(contract(block, CURRENTS, size), points)
    np.testing.assert_allclose(np.einsum("nci,c->ni", flux, CURRENTS), total, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(np.einsum("ncij,c->nij", slope, CURRENTS), total_slope, rtol=1e-10, atol=1e-9)


def test_contraction_is_the_weighted_sum():
    block, size = block_of("harmonic")
    out = contract(block, CURRENTS, size)
    sets = block[map_block.HEADER :].reshape(-1, 2, size)
    np.testing.assert_allclose(
        out[map_block.HEADER :].reshape(-1, size),
        np.einsum("psm,s->pm", sets, CURRENTS),
        rtol=1e-13,
        atol=1e-15,
    )
    assert out[map_block.SETS] == 1


def test_a_single_point_of_the_wrong_length_is_refused():
    block, size = block_of("harmonic")
    flux, slope = np.empty(3), np.empty((3, 3))
    fixed = contract(block, CURRENTS, size)
    assert lookup.evaluate_one(fixed, np.zeros(2), flux, slope) == map_block.WRONG_SHAPE
    assert lookup.evaluate_one_with(block, np.zeros(3), ODD[6], flux, slope) == map_block.WRONG_SHAPE
    assert lookup.evaluate_one_with(block, CURRENTS, ODD[6], flux, slope) == map_block.INSIDE


def test_wrench_at_a_point_whose_weights_are_known_or_follow_the_currents():
    block, size = block_of("harmonic")
    moment, load, place = np.array([0.3, -0.7, 1.1]), np.empty(6), ODD[6]
    flux, slope, _ = evaluated(block, place[None], CURRENTS)
    wanted = np.concatenate([moment @ slope[0], np.cross(moment, flux[0])])
    nothing, last = np.empty(0), np.array([CURRENTS[1]])
    known = np.array([0.1, 0.2, 0.3, *CURRENTS])
    fixed = contract(block, CURRENTS, size)
    for call, *given in (
        (dipole_wrench.sum_wrench_at, fixed),
        (dipole_wrench.wrench_at, block, nothing, CURRENTS),
        (dipole_wrench.wrench_at, block, last, CURRENTS[:1]),
        (dipole_wrench.wrench_at, block, known, known[:3]),
    ):
        load[:] = np.nan
        assert call(*given, place, moment, load) == map_block.INSIDE
        np.testing.assert_allclose(load, wanted, rtol=1e-11, atol=1e-13)
        for wrong in ((place[:2], moment, load), (place, moment[:2], load), (place, moment, load[:5])):
            assert call(*given, *wrong) == map_block.WRONG_SHAPE
    for memory, currents in (
        (nothing, known[:3]),
        (last, CURRENTS),
        (known, np.array([0.1, 0.2, 0.4])),
        (known, known[:2].copy()),
        (known, np.array([0.1, 0.2, 0.3, *CURRENTS])),
        (np.full(2, np.nan), CURRENTS),
        (np.full(2, np.nan), CURRENTS[:1]),
    ):
        status = dipole_wrench.wrench_at(block, memory, currents, place, moment, load)
        assert status == map_block.WRONG_SHAPE


@pytest.mark.parametrize("kind", list(KINDS))
def test_door_for_compiled_callers(kind):
    block, size = block_of(kind)
    expected, expected_slope, _ = evaluated(block, ODD[6:], CURRENTS)
    for flux, slope in (
        lookup.at(contract(block, CURRENTS, size), *ODD[6]),
        lookup.at_currents(block, CURRENTS, *ODD[6]),
    ):
        np.testing.assert_allclose(flux, expected[0], rtol=1e-12)
        np.testing.assert_allclose(slope, expected_slope[0], rtol=1e-11)
