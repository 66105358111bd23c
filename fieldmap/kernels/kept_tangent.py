"""A tangent that is kept while the solution moves on: steps with its Cholesky factor, corrected by what they taught.

Where a step s changed the residual R = -f' of a convex functional f by -y, the true tangent takes s to y on average
along the step. The limited-memory BFGS formula corrects the kept tangent to do the same for the last steps, and leaves
it positive because s . y > 0 (J. Nocedal, Updating quasi-Newton matrices with limited storage, Math. Comput. 35 (1980)
773, the two loops on p. 779).
"""

import numpy as np
from numba import njit

PAIRS = 12


@njit(cache=True, error_model="numpy", fastmath=True)
def solve_factored(factor, right, out):
    """out (r,) = (L L^T)^-1 right, with L the lower triangle of factor (r, r)."""
    count = right.size
    for i in range(count):
        value = right[i]
        for k in range(i):
            value -= factor[i, k] * out[k]
        out[i] = value / factor[i, i]
    for i in range(count - 1, -1, -1):
        out[i] /= factor[i, i]
        for k in range(i):
            out[k] -= factor[i, k] * out[i]


@njit(cache=True, error_model="numpy", fastmath=True)
def direction(factor, residual, changes, responses, count, out):
    """out (r,): the step that the factor and the first `count` pairs of changes and responses (PAIRS, r) propose."""
    left, shares = residual.copy(), np.empty(count)
    for k in range(count - 1, -1, -1):
        shares[k] = np.dot(changes[k], left) / np.dot(changes[k], responses[k])
        left -= shares[k] * responses[k]
    solve_factored(factor, left, out)
    for k in range(count):
        excess = np.dot(responses[k], out) / np.dot(changes[k], responses[k])
        out += (shares[k] - excess) * changes[k]


@njit(cache=True)
def keep_pair(change, response, changes, responses, count):
    """Number of pairs after a step `change` that changed the residual by -response; the oldest gives way."""
    if not np.dot(change, response) > 0.0:
        return count
    if count == PAIRS:
        for k in range(PAIRS - 1):
            changes[k] = changes[k + 1]
            responses[k] = responses[k + 1]
        count -= 1
    changes[count] = change
    responses[count] = response
    return count + 1
