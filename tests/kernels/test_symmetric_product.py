"""Products with the upper half of a symmetric matrix against the whole matrix."""

import numpy as np
import pytest

from fieldmap.kernels.iron.symmetric_product import symmetric_product


@pytest.mark.parametrize("size", [1, 3, 4, 5, 8, 31])
@pytest.mark.parametrize("columns", [1, 3])
@pytest.mark.parametrize(("precision", "digits"), [(np.float64, 1e-13), (np.float32, 2e-5)])
def test_the_upper_triangle_is_enough(size, columns, precision, digits):
    random = np.random.default_rng(size)
    half = random.standard_normal((size, size))
    whole = (half + half.T).astype(precision)
    right = random.standard_normal((columns, size)).astype(precision)
    out = np.full_like(right, np.nan)
    # The part below the diagonal must not be read.
    symmetric_product(np.triu(whole) + np.tril(np.full_like(whole, np.nan), -1), right, out)
    assert out == pytest.approx(right @ whole, abs=digits * float(np.abs(right @ whole).max()))
