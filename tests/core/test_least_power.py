"""Least-power currents against scipy's linear programs and its non-negative least squares."""

import numpy as np
import pytest
from scipy.optimize import linprog, nnls

from fieldmap.core import least_power as core


def test_non_negative_least_squares_is_scipys():
    rng = np.random.default_rng(6)
    for _ in range(60):
        rows, n = int(rng.integers(1, 7)), int(rng.integers(1, 12))
        columns = rng.normal(size=(rows, n))
        columns /= np.linalg.norm(columns, axis=0)
        target, ours = rng.normal(size=rows), np.empty(n)
        assert core.non_negative_least_squares(np.ascontiguousarray(columns.T), target, ours)
        _, residual = nnls(columns, target)
        assert np.all(ours >= 0)
        assert np.linalg.norm(columns @ ours - target) == pytest.approx(residual, rel=1e-9, abs=1e-11)


def random_case(rng):
    """Matrix, limits, weights; some rows dependent, some limits one-sided or absent."""
    n = int(rng.integers(1, 10))
    matrix = rng.normal(size=(int(rng.integers(1, 7)), n))
    if len(matrix) > 1 and rng.random() < 0.3:
        matrix[-1] = matrix[0] - 2 * matrix[len(matrix) // 2]
    low, high = -2 * rng.random(n), 2 * rng.random(n)
    low[rng.random(n) < 0.2], high[rng.random(n) < 0.2] = 0.0, np.inf
    return matrix, low, high, 0.2 + rng.random(n)


def test_linear_programs_agree_on_what_is_feasible_and_what_is_least():
    rng = np.random.default_rng(11)
    counts = {True: 0, False: 0}
    for _ in range(160):
        matrix, low, high, weight = random_case(rng)
        n = len(weight)
        inner = low + rng.random(n) * (np.minimum(high, 2.0) - low)
        demand = matrix @ inner * rng.choice([1.0, 1.5, 3.0])
        currents, active = np.empty(n), np.empty(n, np.int64)
        status = core.least_power(matrix, demand, low, high, weight, currents, active)
        bounds = np.stack([low, high], axis=1)
        judge = linprog(2 * weight * currents, A_eq=matrix, b_eq=demand, bounds=bounds)
        possible = judge.status == 0 or judge.status == 3
        assert (status == core.FOUND) == possible
        counts[possible] += 1
        if not possible:
            continue
        np.testing.assert_allclose(matrix @ currents, demand, rtol=0, atol=1e-10 * (1 + np.abs(demand).max()))
        assert np.all((currents >= low) & (currents <= high))
        # Convex: the point is optimal if the linear program with the power's gradient finds nothing less.
        here = 2 * weight @ currents**2
        assert judge.status == 0
        assert judge.fun == pytest.approx(here, rel=1e-7, abs=1e-9)
    assert min(counts.values()) > 50


def test_demands_on_the_edge_of_what_is_possible():
    # Only one set of currents reaches the support function: just inside it is found, just outside it is refused.
    rng = np.random.default_rng(2)
    for _ in range(80):
        matrix, n = rng.normal(size=(3, 6)), 6
        corner = np.sign(rng.normal(size=3) @ matrix)
        demand, currents, active = matrix @ corner, np.empty(n), np.empty(n, np.int64)
        ones = np.ones(n)
        inside = core.least_power(matrix, demand * (1 - 1e-8), -ones, ones, ones, currents, active)
        assert inside == core.FOUND
        np.testing.assert_allclose(matrix @ currents, demand * (1 - 1e-8), rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(currents, corner, atol=1e-5)
        outside = core.least_power(matrix, demand * (1 + 1e-8), -ones, ones, ones, currents, active)
        assert outside == core.BEYOND_LIMITS


def test_rows_of_rounding_do_not_command():
    # On an axis of symmetry two rows are noise: a demand of zero for them must not cost anything.
    matrix = np.array([[1e-18, -2e-18, 1e-18], [0.0, 1e-19, 1e-18], [0.3, 0.3, 0.4]])
    currents, active, limit = np.empty(3), np.empty(3, np.int64), np.full(3, 9.0)
    demand = np.array([0.0, 0.0, 1.0])
    assert core.least_power(matrix, demand, -limit, limit, np.ones(3), currents, active) == core.FOUND
    np.testing.assert_allclose(currents, matrix[2] / (matrix[2] @ matrix[2]), rtol=1e-9)


def test_many_coils_take_more_room():
    """As many rows as coils, or more: the shortest solution."""
    rng = np.random.default_rng(4)
    for rows, coils in ((3, 40), (12, 12), (30, 12)):
        matrix, known = rng.normal(size=(rows, coils)), rng.normal(size=coils)
        free, currents, active = np.full(coils, np.inf), np.empty(coils), np.empty(coils, np.int64)
        demand = matrix @ known
        assert core.least_power(matrix, demand, -free, free, np.ones(coils), currents, active) == core.FOUND
        np.testing.assert_allclose(currents, np.linalg.lstsq(matrix, demand, rcond=None)[0], atol=1e-9)
        assert not active.any()
        limit = np.full(coils, 0.9 * np.abs(currents).max())
        status = core.least_power(matrix, demand, -limit, limit, np.ones(coils), currents, active)
        assert status == (core.FOUND if rows < coils else core.BEYOND_LIMITS)
        assert active.any()
        off = matrix @ (known + 1.0) + rng.normal(size=rows)
        status = core.least_power(matrix, off, -free, free, np.ones(coils), currents, active)
        assert status == (core.OUT_OF_RANGE if rows > coils else core.FOUND)


def test_arrays_that_do_not_fit_are_refused():
    good = (
        np.ones((2, 3)),
        np.ones(2),
        -np.ones(3),
        np.ones(3),
        np.ones(3),
        np.empty(3),
        np.empty(3, np.int64),
    )
    assert core.least_power(*good) == core.FOUND
    for place, wrong in (
        (0, np.ones((3, 2))), (0, np.ones((3, 2)).T), (1, np.ones(2, np.float32)), (2, np.ones(2)),
        (3, [1.0, 1.0, 1.0]), (4, np.ones((3, 1))), (5, np.empty(2)), (6, np.empty(3)), (6, np.empty(2, np.int64)),
    ):  # fmt: skip
        with pytest.raises(TypeError):
            core.least_power(*good[:place], wrong, *good[place + 1 :])
    for wrong in ((np.ones((3, 2)), np.ones(2), np.empty(2)), (np.ones((2, 3)), np.ones(2), np.empty(3))):
        with pytest.raises(TypeError):
            core.non_negative_least_squares(*wrong)
