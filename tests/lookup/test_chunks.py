"""Points that several threads share: each piece takes its own rows, and what is not one row for each point whole."""

import numpy as np
import pytest

from fieldmap.lookup.evaluation import CHUNK, Box, in_chunks


@pytest.mark.parametrize("length", [1, 8, 2 * CHUNK, 4 * CHUNK])
def test_rows_go_with_their_points_and_other_arrays_whole(length):
    points = np.arange(6.0 * CHUNK).reshape(2 * CHUNK, 3)
    rows, other, seen = points[:, 0].copy(), np.arange(float(length)), []

    def evaluate(x, own, given):
        np.testing.assert_array_equal(own, x[:, 0])
        seen.append((len(x), len(given)))
        return 0

    in_chunks(evaluate, points, (rows, other), Box(np.zeros(3), np.ones(3), "raise", 2))
    assert len(seen) > 1
    assert sum(count for count, _ in seen) == len(points)
    assert all(given == (count if length == len(points) else length) for count, given in seen)
