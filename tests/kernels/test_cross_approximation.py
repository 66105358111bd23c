"""Far blocks of low rank and products of blocks, against the sums written out."""

import numpy as np
import pytest

from fieldmap.kernels.iron.block_product import add_far_product, add_near_product
from fieldmap.kernels.iron.cross_approximation import approximate_far_blocks, cross, pack_factors, recompress
from fieldmap.kernels.iron.sparse_inverse import farthest_first, solve_for_last


def far_sets(rows=9, columns=11, distance=4.0):
    """Points (3, n) of a rule on two groups of small triangles, and the matrix between the groups."""
    rng = np.random.default_rng(0)
    centre = np.concatenate([rng.random((rows, 3)), rng.random((columns, 3)) + [distance, 0, 0]])
    points = centre[None] + 0.05 * rng.random((3, rows + columns, 3))
    x, y, z = (np.ascontiguousarray(points[:, :, k]) for k in range(3))
    gap = np.linalg.norm(points[:, None, :rows, None] - points[None, :, None, rows:], axis=-1)
    return (x, y, z), (1 / gap).mean(axis=(0, 1)) / (4 * np.pi)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-6])
def test_cross_approximation_keeps_its_tolerance(tolerance):
    points, exact = far_sets()
    left, right = np.zeros((9, 9)), np.zeros((9, 11))
    rank = cross(np.array([0, 9, 9, 20]), *points, tolerance, left, right)
    assert 0 < rank <= 9
    error = np.linalg.norm(left[:rank].T @ right[:rank] - exact)
    assert error < 3 * tolerance * np.linalg.norm(exact)
    lower = recompress(left, right, rank, 10 * tolerance)
    assert lower <= rank
    assert np.linalg.norm(left[:lower].T @ right[:lower] - exact) < 15 * tolerance * np.linalg.norm(exact)


def test_recompression_finds_the_rank_and_loses_nothing():
    rng = np.random.default_rng(1)
    left, right = rng.random((6, 8)), rng.random((6, 7))
    left[3:] = rng.random((3, 3)) @ left[:3]
    exact = left.T @ right
    assert recompress(left, right, 6, 1e-10) == 3
    assert left[:3].T @ right[:3] == pytest.approx(exact, rel=1e-9)


def test_too_low_a_limit_is_reported():
    points, _ = far_sets(distance=1.5)
    block, ranks = np.array([[0, 9, 9, 20]]), np.zeros(1, np.int64)
    approximate_far_blocks(0, 1, block, np.array([0]), 2, *points, 1e-9, 1, np.empty(2 * 20), ranks)
    assert ranks[0] == -1


def test_products_of_blocks():
    points, exact = far_sets()
    block, place = np.array([[9, 20, 0, 9]]), np.array([0])
    scratch, ranks = np.empty(9 * 20), np.zeros(1, np.int64)
    approximate_far_blocks(0, 1, block, place, 9, *points, 1e-7, 1, scratch, ranks)
    data = np.empty(ranks[0] * 20, np.float32)
    pack_factors(0, 1, block, place, 9, ranks, np.array([0, data.size]), scratch, data)
    rng = np.random.default_rng(2)
    charge, own = rng.random((2, 20, 4)), rng.random((9, 9)).astype(np.float32)
    own = own + own.T
    sums = np.zeros((2, 2, 20, 4))
    add_far_product(0, 2, block, ranks, np.array([0, data.size]), data, charge, sums)
    add_near_product(0, 2, np.array([[0, 9, 0, 9]]), np.array([0, 81]), own.ravel(), charge, sums)
    whole = np.zeros((20, 20))
    whole[:9, :9], whole[:9, 9:], whole[9:, :9] = own, exact, exact.T
    assert sums.sum(axis=0) == pytest.approx(whole @ charge, rel=1e-5)


def test_row_of_the_sparse_inverse():
    rng = np.random.default_rng(3)
    root = rng.random((6, 6))
    matrix = root @ root.T + np.eye(6)
    work = np.zeros((7, 6))
    work[:6] = matrix
    solve_for_last(work, 6)
    column = np.linalg.inv(matrix)[:, 5]
    assert work[6] == pytest.approx(column / np.sqrt(column[5]), rel=1e-10)


def test_farthest_first():
    x = np.array([0.0, 0.1, 1.0, 0.45, 0.2], np.float32)
    order = farthest_first(x, *np.zeros((2, 5), np.float32))
    assert list(order[:3]) == [0, 2, 3]
