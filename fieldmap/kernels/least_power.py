"""Least-power currents within limits that give a linear demand: a strictly convex quadratic program, solved exactly.

    min sum_k w_k i_k^2    with    A i = b,   lower <= i <= upper                  docs/theory/actuation.md (5)

In x_k = sqrt(w_k) i_k the currents that meet the demand are x0 + N y: x0 the shortest of them, N an orthonormal basis
of what the demand does not feel (pivoted QR). What is left is the shortest y with G y >= h, which Lawson and Hanson
(Solving Least Squares Problems, 1974, ch. 23, LDP) reduce to non-negative least squares, an active-set method that
ends after finitely many steps and either finds y or proves that there is none.

Arrays float64, C-contiguous. Arguments are not checked here; a checked function stands in front.
"""

import numpy as np
from numba import njit

from fieldmap.kernels.map_block import OUTER

FOUND, OUT_OF_RANGE, BEYOND_LIMITS, NO_END = 0, 1, 2, 3

FAINT = (
    1e-7  # rows are scaled to length 1, but those below this share of the longest only as far as that one is
)
RANK = 1e-9  # rows whose new part is below this share of the largest add nothing to the rank: rounding
RANGE = 1e-9  # a demand off the range of A by this share of its length is out of it
ROUNDING = 1e-11  # limits may be missed by this share of the longest, and are then met by clipping


@njit(cache=True)
def _least_squares(columns, target, chosen, count, work, solution):
    """solution (count,) of min |columns[:, chosen] s - target|, by modified Gram-Schmidt with the target at the end.

    columns (rows, all), work (rows + all + 1, all + 1). False if the chosen columns depend on each other.
    """
    rows = columns.shape[0]
    q, r = work[:rows], work[rows:]
    for p in range(count):
        q[:, p] = columns[:, chosen[p]]
    q[:, count] = target
    for p in range(count):
        before = np.sqrt(np.sum(columns[:, chosen[p]] ** 2))
        r[p, p] = np.sqrt(np.sum(q[:, p] ** 2))
        if not r[p, p] > 1e-10 * before:
            return False
        q[:, p] /= r[p, p]
        for other in range(p + 1, count + 1):
            r[p, other] = np.sum(q[:, p] * q[:, other])
            q[:, other] -= r[p, other] * q[:, p]
    for p in range(count - 1, -1, -1):
        total = r[p, count]
        for other in range(p + 1, count):
            total -= r[p, other] * solution[other]
        solution[p] = total / r[p, p]
    return True


@njit(cache=True)
def _steepest(columns, residual, inside, barred):
    """Number of the column outside the active set that promises most, or -1."""
    best, found = 1e-13, -1
    for j in range(columns.shape[1]):
        if not inside[j] and not barred[j]:
            promise = np.sum(columns[:, j] * residual)
            if promise > best:
                best, found = promise, j
    return found


@njit(cache=True)
def non_negative_least_squares(columns, target, u):
    """u (n,) >= 0 of min |columns u - target|: Lawson and Hanson's NNLS, columns of length 1. False if without end."""
    rows, n = columns.shape
    work, trial = np.empty((rows + n + 1, n + 1)), np.empty(n)
    chosen, count = np.empty(n, np.int64), 0
    inside, barred = np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    u[:] = 0.0
    for _ in range(10 * n + 10):
        found = _steepest(columns, target - columns @ u, inside, barred)
        if found < 0 or count == rows:
            return True
        chosen[count] = found
        solved = _least_squares(columns, target, chosen, count + 1, work, trial)
        if not solved or trial[count] <= 0.0:
            barred[found] = True
            continue
        inside[found] = True
        count += 1
        barred[:] = False
        while count > 0 and trial[:count].min() <= 0.0:
            step = 1.0
            for p in range(count):
                if trial[p] <= 0.0:
                    step = min(step, u[chosen[p]] / (u[chosen[p]] - trial[p]))
            kept = 0
            for p in range(count):
                j = chosen[p]
                u[j] += step * (trial[p] - u[j])
                if trial[p] <= 0.0 and u[j] <= 1e-14:
                    u[j], inside[j] = 0.0, False
                else:
                    chosen[kept] = j
                    kept += 1
            if kept == count:
                return False
            count = kept
            if not _least_squares(columns, target, chosen, count, work, trial):
                return False
        for p in range(count):
            u[chosen[p]] = trial[p]
    return False


@njit(cache=True)
def _shortest_within(basis, start, low, high, x, active):
    """x (n,) = start + basis y, the shortest y with low <= x <= high; active (n,) -1, 0 or 1. A status."""
    n, d = basis.shape
    columns, u = np.zeros((d + 1, 2 * n)), np.empty(2 * n)
    for k in range(n):
        columns[:d, k], columns[d, k] = basis[k], low[k] - start[k]
        columns[:d, n + k], columns[d, n + k] = -basis[k], start[k] - high[k]
    for j in range(2 * n):
        if not np.isfinite(columns[d, j]):
            columns[:, j] = 0.0
        length = np.sqrt(np.sum(columns[:, j] ** 2))
        columns[:, j] /= length if length > 0.0 else 1.0
    target = np.zeros(d + 1)
    target[d] = 1.0
    if not non_negative_least_squares(columns, target, u):
        return NO_END
    residual = columns @ u - target
    for k in range(n):
        active[k] = int(u[n + k] > 0.0) - int(u[k] > 0.0)
    if not abs(residual[d]) > 1e-14:
        return BEYOND_LIMITS
    x[:] = start - basis @ residual[:d] / residual[d]
    return FOUND


@njit(**OUTER)
def least_power(matrix, demand, lower, upper, weight, currents, active):
    """currents (n,) and which limits they lie on, active (n,): -1 lower, 1 upper; a status.

    matrix (m, n), demand (m,), lower, upper, weight (n,), weight > 0; limits may be infinite. Where the status is
    BEYOND_LIMITS, active names the limits that together rule the demand out, and currents are those of no limits.
    """
    m, n = matrix.shape
    root = np.sqrt(weight)
    scaled, rest = matrix / root, demand.copy()
    lengths = np.empty(m)
    for r in range(m):
        lengths[r] = np.sqrt(np.sum(scaled[r] ** 2))
    longest = np.max(lengths)
    for r in range(m):
        length = max(lengths[r], FAINT * longest)
        if length > 0.0:
            scaled[r] /= length
            rest[r] /= length
    start = np.zeros(n)
    rank, off, basis = _meet(scaled, rest, start)
    active[:] = 0
    currents[:] = start / root
    if off > RANGE * np.sqrt(np.sum(rest**2)):
        return OUT_OF_RANGE
    return _within(basis[:, rank:].copy(), start, root, lower, upper, currents, active)


@njit(cache=True)
def _meet(matrix, demand, x):
    """x (n,), the shortest with matrix x = demand; rank; how far the demand is off the range; orthonormal basis (n, n),
    whose columns from the rank on are what the matrix does not feel. Householder's QR of the transpose, pivoted.
    """
    m, n = matrix.shape
    r, q, b = matrix.T.copy(), np.eye(n), demand.copy()
    rank, largest = 0, 0.0
    for p in range(min(m, n)):
        _pivot(r, b, p)
        size = np.sqrt(np.sum(r[p:, p] ** 2))
        largest = max(largest, size)
        if not size > RANK * largest:
            break
        _reflect(r, q, p, size)
        z = b[p]
        for s in range(p):
            z -= r[s, p] * b[s]
        b[p] = z / r[p, p]
        x += b[p] * q[:, p]
        rank += 1
    off = 0.0
    for c in range(rank, m):
        left = b[c]
        for s in range(rank):
            left -= r[s, c] * b[s]
        off = max(off, abs(left))
    return rank, off, q


@njit(cache=True)
def _pivot(r, b, p):
    """Bring the column with most below row p to place p."""
    best, found = -1.0, p
    for c in range(p, r.shape[1]):
        size = np.sum(r[p:, c] ** 2)
        if size > best:
            best, found = size, c
    for s in range(r.shape[0]):
        r[s, p], r[s, found] = r[s, found], r[s, p]
    b[p], b[found] = b[found], b[p]


@njit(cache=True)
def _reflect(r, q, p, size):
    """One Householder step: column p of r is turned into the diagonal, q gathers the turn."""
    v = r[p:, p].copy()
    v[0] += size if v[0] >= 0.0 else -size
    square = np.sum(v * v)
    for c in range(p, r.shape[1]):
        r[p:, c] -= (2.0 / square * np.sum(v * r[p:, c])) * v
    for s in range(q.shape[0]):
        q[s, p:] -= (2.0 / square * np.sum(v * q[s, p:])) * v


@njit(cache=True)
def _within(basis, start, root, lower, upper, currents, active):
    n, low, high = start.shape[0], lower * root, upper * root
    # In units of the widest limit, or of the currents: so the tolerances of the active-set method mean something.
    scale = np.max(np.abs(start))
    for k in range(n):
        for limit in (low[k], high[k]):
            if np.isfinite(limit):
                scale = max(scale, abs(limit))
    if scale == 0.0:
        scale = 1.0
    slack = ROUNDING * scale
    if _excess(start, low, high) <= slack:
        currents[:] = np.minimum(np.maximum(currents, lower), upper)
        return FOUND
    if basis.shape[1] == 0:
        for k in range(n):
            active[k] = int(start[k] > high[k] + slack) - int(start[k] < low[k] - slack)
        return BEYOND_LIMITS
    x = np.empty(n)
    status = _shortest_within(basis, start / scale, low / scale, high / scale, x, active)
    if status != FOUND:
        return status
    x *= scale
    if not _excess(x, low, high) <= slack:
        return BEYOND_LIMITS
    currents[:] = np.minimum(np.maximum(x / root, lower), upper)
    return FOUND


@njit(cache=True)
def _excess(x, low, high):
    return max(np.max(low - x), np.max(x - high))
