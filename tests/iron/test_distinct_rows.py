"""Distinct rows of node numbers, against NumPy's own."""

import numpy as np
import pytest

from fieldmap.iron.topology import distinct_rows


@pytest.mark.parametrize("width", [1, 2, 3])
def test_the_same_as_unique_along_an_axis(width):
    rows = np.random.default_rng(width).integers(0, 9, (300, width))
    wanted = np.unique(rows, axis=0, return_index=True, return_inverse=True, return_counts=True)
    for found, one in zip(distinct_rows(rows), wanted, strict=True):
        np.testing.assert_array_equal(found, one)


def test_no_rows():
    found = distinct_rows(np.zeros((0, 2), np.int64))
    assert found.rows.shape == (0, 2)
    assert found.number.size == found.first.size == found.times.size == 0


def test_numbers_that_do_not_fit_into_one():
    large = np.array([[0, 2**21, 1], [2**21 - 1, 0, 3]])
    with pytest.raises(OverflowError):
        distinct_rows(large)
    assert distinct_rows(np.minimum(large, 2**21 - 1)).rows.tolist() == [[0, 2**21 - 1, 1], [2**21 - 1, 0, 3]]
