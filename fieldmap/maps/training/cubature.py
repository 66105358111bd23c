"""Hyper-reduction: few sample points with positive weights that integrate the projected law as all points do.

Empirical cubature: the contributions of the points to the residuals of the solved states, compressed by random
combinations and a singular value decomposition, are matched by non-negative least squares (Lawson and Hanson), whose
solution is sparse. Positive weights keep the reduced functional convex. Farhat, Avery, Chapman and Cortial, Int. J.
Numer. Meth. Engng 98 (2014) 625; Hernandez, Caicedo and Ferrer, Comput. Methods Appl. Mech. Engrg 313 (2017) 687.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dgemm
from scipy.optimize import nnls

from fieldmap.typing import Array

# Points from which the fit may choose, per condition, and at least; drawn by their share in the conditions.
_CANDIDATES_PER_CONDITION, _FEWEST_CANDIDATES = 12, 4000
# Random combinations beyond the conditions: what a randomised range finder wants (Halko et al., SIAM Review 2011).
_OVERSAMPLING = 20


def empirical_cubature(
    contributions: Iterable[Array], conditions: int, seed: int = 0
) -> tuple[NDArray[np.int64], Array]:
    """Numbers (m,) of the chosen points and factors (m,) > 0 on their own weights; m is about `conditions`.

    contributions: one array (p, r) per state, what each of the p points adds to the r residuals.
    """
    random = np.random.default_rng(seed)
    sketch = _sketch(contributions, conditions + _OVERSAMPLING, random)
    left = np.linalg.svd(sketch, full_matrices=False)[0][:, : min(conditions, *sketch.shape)]
    one = np.ones(len(left))
    rest = one - left @ (left.T @ one)
    # The volume itself is one of the conditions.
    if np.linalg.norm(rest) > 1e-8 * np.sqrt(len(one)):
        left = np.column_stack([left, rest / np.linalg.norm(rest)])
    wanted = left.T @ one
    importance = (left**2).sum(axis=1)
    most = min(len(left), max(_FEWEST_CANDIDATES, _CANDIDATES_PER_CONDITION * left.shape[1]))
    able = int((importance > 0).sum())
    candidates = random.choice(len(left), min(most, able), replace=False, p=importance / importance.sum())
    factors = nnls(np.ascontiguousarray(left[candidates].T), wanted, maxiter=50 * left.shape[1])[0]
    chosen = np.flatnonzero(factors > 0)
    order = np.argsort(candidates[chosen])
    return candidates[chosen][order], factors[chosen][order]


def _sketch(contributions: Iterable[Array], columns: int, random: np.random.Generator) -> Array:
    total: Array | None = None
    for part in contributions:
        if total is None:
            total = np.zeros((columns, len(part)), order="F")
        mixed = np.asfortranarray(random.standard_normal((part.shape[1], columns)).T)
        # Added in place: a new array of this size for every state would cost eight times the product itself.
        total = dgemm(1.0, mixed, np.ascontiguousarray(part).T, beta=1.0, c=total, overwrite_c=1)
    return np.empty((0, columns)) if total is None else np.asarray(total.T)
