"""Products of a matrix and a vector against numpy's."""

import numpy as np
import pytest

from fieldmap.kernels.iron.matrix_vector import times, times_transposed


@pytest.mark.parametrize(("kind", "accuracy"), [(np.float64, 1e-14), (np.float32, 1e-6)])
@pytest.mark.parametrize("shape", [(1, 1), (7, 3), (40, 33), (0, 4), (4, 0)])
def test_products_are_those_of_numpy_in_the_kind_of_the_matrix(shape, kind, accuracy):
    random = np.random.default_rng(3)
    matrix = random.standard_normal(shape).astype(kind)
    right, left = random.standard_normal(shape[1]).astype(kind), random.standard_normal(shape[0]).astype(kind)
    scale = accuracy * max(shape)
    forward, backward = times(matrix, right), times_transposed(left, matrix)
    assert forward.dtype == backward.dtype == kind
    np.testing.assert_allclose(forward, matrix.astype(float) @ right, rtol=0, atol=5 * scale)
    np.testing.assert_allclose(backward, left @ matrix.astype(float), rtol=0, atol=5 * scale)
