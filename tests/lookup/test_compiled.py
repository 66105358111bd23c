"""A map inside the user's own compiled functions."""

import gc
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from numba import njit
from numba.core.errors import TypingError

from fieldmap.lookup import MagneticBody, compiled_wrench, interpolate, wrench_actuation

CURRENTS = np.array([0.9, -0.3, 0.5])


@pytest.fixture(scope="module")
def field_map(dipoles):
    return interpolate(dipoles.map((12, 10, 12)), "harmonic")


def test_currents_that_change_from_call_to_call(field_map, dipoles):
    evaluate, data = field_map.compiled()

    @njit
    def total(data, points, currents):
        result = np.zeros(3)
        for p in range(len(points)):
            flux, _ = evaluate(data, currents[p], points[p, 0], points[p, 1], points[p, 2])
            for i in range(3):
                result[i] += flux[i]
        return result

    points = dipoles.points(50)
    currents = np.random.default_rng(0).normal(size=(50, 3))
    expected = field_map.field(points, currents).sum(axis=0)
    np.testing.assert_allclose(total(data, points, currents), expected, rtol=1e-12)


def test_outside_is_nan_for_a_compiled_caller(field_map):
    evaluate, data = field_map.compiled(CURRENTS)
    flux, slope = evaluate(data, 1.0, 0.0, 0.0)
    assert np.isnan(flux).all()
    assert np.isnan(slope).all()


@njit
def along(evaluate, data, points, currents, out):
    for p in range(len(points)):
        flux, slope = evaluate(data, currents, points[p, 0], points[p, 1], points[p, 2])
        for i in range(3):
            out[p, i] = flux[i] + slope[i][i]


def test_currents_may_lie_anyhow(field_map, dipoles):
    evaluate, data = field_map.compiled()
    points, wide = dipoles.points(20), np.repeat(CURRENTS, 2).reshape(3, 2)
    flux, slope = field_map.field_and_gradient(points, CURRENTS)
    for currents in (CURRENTS, wide[:, 1], CURRENTS[::-1].copy()[::-1]):
        out = np.empty((20, 3))
        along(evaluate, data, points, currents, out)
        np.testing.assert_allclose(out, flux + np.einsum("nii->ni", slope), rtol=1e-12)


def test_other_numbers_of_currents_and_other_kinds_are_refused(field_map):
    evaluate, data = field_map.compiled()
    for wrong in (CURRENTS[:2], np.append(CURRENTS, 1.0)):
        with pytest.raises(ValueError, match="one current for each coil"):
            evaluate(data, wrong, 0.0, 0.0, 0.0)
    with pytest.raises(TypingError):
        evaluate(data, CURRENTS.astype(np.float32), 0.0, 0.0, 0.0)


def test_several_threads_share_a_map(field_map, dipoles):
    evaluate, data = field_map.compiled()
    points, rng = dipoles.points(5000), np.random.default_rng(4)
    drawn = rng.normal(size=(8, 3))

    @njit(nogil=True)
    def work(data, currents):
        out = np.empty((len(points), 3))
        along(evaluate, data, points, currents, out)
        return out

    alone = [work(data, currents) for currents in drawn]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda currents: work(data, currents), drawn))
    np.testing.assert_array_equal(together, alone)


def test_the_data_keeps_the_map_and_may_be_a_global(dipoles):
    m = interpolate(dipoles.map((12, 10, 12)), "harmonic")
    point = np.array([0.001, -0.002, 0.003])
    wanted = m.field(point, CURRENTS)[0]
    (free, data), (fixed, at_currents) = m.compiled(), m.compiled(CURRENTS)
    del m
    gc.collect()

    @njit
    def both(x, y, z):
        return free(data, CURRENTS, x, y, z)[0][0], fixed(at_currents, x, y, z)[0][0]

    assert both(*point) == pytest.approx((wanted, wanted), rel=1e-12)


def test_wrenches_take_arrays_that_lie_anyhow(field_map):
    """A body of two dipoles, with strided output rows and a rotation in column order."""
    body = MagneticBody(
        np.array([[0.0, 0.0, 1e-3], [1e-3, 0.0, 0.0]]), np.array([[0.0, 0.0, 0.3], [0.2, 0.1, 0.0]])
    )
    turn, place = (
        np.array([[0.8, 0.6, 0.0], [0.0, 0.0, -1.0], [-0.6, 0.8, 0.0]]),
        np.array([1e-3, -2e-3, 3e-3]),
    )
    evaluate, data = compiled_wrench(field_map, body)
    load, slopes = np.empty((6, 2)), np.empty((3, 6))
    assert evaluate(data, CURRENTS, np.repeat(place, 2)[::2], np.asfortranarray(turn), load[:, 1], slopes.T)
    np.testing.assert_allclose(load[:, 1], field_map.wrench(place, body, CURRENTS, turn), rtol=1e-11)
    matrix = wrench_actuation(field_map, place, body, CURRENTS, turn).matrix
    np.testing.assert_allclose(slopes.T, matrix, rtol=1e-10, atol=1e-14)
    with pytest.raises(ValueError, match="one current for each coil"):
        evaluate(data, CURRENTS, place, turn, load[:, 1], np.empty((6, 2)))


def test_a_function_from_a_cache_finds_a_map_of_another_process_gone(tmp_path):
    """There its data is a constant address that means nothing: the function gives NaN, and does not crash."""
    (tmp_path / "kept.py").write_text(
        """import numpy as np
from numba import njit
from fieldmap.lookup import interpolate
from fieldmap.store import Grid, MapData

grid = Grid([0, 0, 0], [0.01, 0.01, 0.01], (3, 3, 3))
flux, slope = np.tile([0, 0, 1e-3], (1, 3, 3, 3, 1)), np.zeros((1, 3, 3, 3, 3, 3))
evaluate, data = interpolate(MapData(grid, ("coil",), [1.0], flux_density=flux, gradient=slope)).compiled([2.0])

@njit(cache=True)
def given(data):
    return evaluate(data, 0.01, 0.01, 0.01)[0][2]

@njit(cache=True)
def constant():
    return evaluate(data, 0.01, 0.01, 0.01)[0][2]

print(f"{given(data):.4f} {constant():.4f}", sum(given.stats.cache_hits.values()))
"""
    )
    told = [
        subprocess.run(
            [sys.executable, "kept.py"], cwd=tmp_path, capture_output=True, text=True, check=True
        ).stdout
        for _ in range(2)
    ]
    assert told == ["0.0020 0.0020 0\n", "0.0020 nan 1\n"]
