"""Block GMRES against a direct solve."""

import numpy as np
import pytest

from fieldmap.errors import NotConverged
from fieldmap.iron.operators.linear_systems import block_gmres, require_convergence

RNG = np.random.default_rng(5)


def test_reported_residual_is_the_true_one():
    matrix = np.eye(40) * 3 + RNG.normal(size=(40, 40)) * 0.3
    right = RNG.normal(size=(40, 2))
    x, history = block_gmres(lambda v: matrix @ v, right, 1e-30, 6)
    true = np.linalg.norm(matrix @ x - right, axis=0) / np.linalg.norm(right, axis=0)
    assert history[-1] == pytest.approx(true, rel=1e-8)
    assert (np.diff([h.max() for h in history]) < 0).all()


def test_zero_column_and_exact_breakdown():
    """A zero source gives zero; an eigenvector is found in one step, and later steps do no harm."""
    matrix = np.diag([1.0, 2.0, 3.0, 4.0])
    right = np.column_stack([np.zeros(4), [0.0, 2.0, 0, 0], [1.0, 1, 1, 1]])
    x, _ = block_gmres(lambda v: matrix @ v, right, 1e-13, 10)
    assert x == pytest.approx(np.linalg.solve(matrix, right), abs=1e-12)


def test_the_last_residual_decides():
    require_convergence("solver", (1.0, 1e-3, 1e-6), 1e-6)
    for residuals in ((1e-9, 2e-6), ()):
        with pytest.raises(NotConverged) as caught:
            require_convergence("solver", residuals, 1e-6)
        assert caught.value.residuals == residuals
        last = "2.00e-06 after 2 steps" if residuals else "no step"
        assert caught.value.problems[0].received == last
