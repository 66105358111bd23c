"""A Cholesky factor updated as rows come and go, against the factor of the current matrix."""

import numpy as np
import pytest

from fieldmap.kernels.growing_cholesky import append, remove, solve_lower, solve_upper


def test_it_is_the_factor_of_what_is_left():
    random = np.random.default_rng(3)
    columns = random.standard_normal((60, 40))
    gram = columns.T @ columns
    factor, held = np.full((40, 40), np.nan), []
    for step in range(200):
        if held and (len(held) == 40 or random.random() < 0.4):
            place = int(random.integers(len(held)))
            remove(factor, len(held), place)
            held.pop(place)
        else:
            new = int(random.choice([k for k in range(40) if k not in held]))
            assert append(factor, len(held), gram[held, new].copy(), gram[new, new])
            held.append(new)
        count = len(held)
        if count and step % 10 == 9:
            own = np.triu(factor[:count, :count])
            assert own.T @ own == pytest.approx(gram[np.ix_(held, held)], abs=1e-11 * gram.max())
            right = random.standard_normal(count)
            lower, upper = right.copy(), right.copy()
            solve_lower(factor, count, lower)
            solve_upper(factor, count, upper)
            assert own.T @ lower == pytest.approx(right, abs=1e-10)
            assert own @ upper == pytest.approx(right, abs=1e-10)


def test_what_depends_on_the_others_is_refused_and_changes_nothing():
    columns = np.random.default_rng(4).standard_normal((10, 3))
    columns[:, 2] = columns[:, 0] - 2.0 * columns[:, 1]
    gram, factor = columns.T @ columns, np.zeros((3, 3))
    assert append(factor, 0, np.zeros(0), gram[0, 0])
    assert append(factor, 1, gram[:1, 1].copy(), gram[1, 1])
    before = factor.copy()
    assert not append(factor, 2, gram[:2, 2].copy(), gram[2, 2])
    assert np.array_equal(factor, before)
