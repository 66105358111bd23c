"""Least-power currents within limits that give a linear demand: a strictly convex quadratic program, solved exactly.

    min sum_k w_k i_k^2    with    A i = b,   lower <= i <= upper                  docs/theory/actuation.md (5)

In x_k = sqrt(w_k) i_k the currents that meet the demand are x0 + N y: x0 the shortest of them, N an orthonormal basis
of what the demand does not feel (pivoted QR). What is left is the shortest y with G y >= h, which Lawson and Hanson
(Solving Least Squares Problems, 1974, ch. 23, LDP) reduce to non-negative least squares, an active-set method that
ends after finitely many steps and either finds y or proves that there is none.

Arrays float64, C-contiguous. Arguments are not checked here; a checked function stands in front.
"""

import numpy as np

from fieldmap.kernels.compilation import njit
from fieldmap.kernels.copy_vector import copy_vector

FOUND, OUT_OF_RANGE, BEYOND_LIMITS, NO_END = 0, 1, 2, 3

# Rows are scaled to length 1, but those below FAINT of the longest only as far as that one is. What is then below RANK
# of the largest adds nothing to the rank: it is rounding.
FAINT, RANK = 1e-7, 1e-9
RANGE = 1e-9  # a demand off the range of A by this share of its length is out of it
ROUNDING = 1e-11  # limits may be missed by this share of the longest, and are then met by clipping

# Loops in the place of array expressions: compiled in half the time, and three times as fast on vectors this short.

OUTER = {"fastmath": {"contract"}, "nogil": True}


@njit
def _product(a, b):
    total = 0.0
    for i in range(a.shape[0]):
        total += a[i] * b[i]
    return total


@njit
def _length(a):
    return np.sqrt(_product(a, a))


@njit
def _add(a, factor, b):
    """a += factor b."""
    for i in range(a.shape[0]):
        a[i] += factor * b[i]


@njit
def _least_squares(columns, target, chosen, count, q, r, solution):
    """solution (count,) of min |sum_p s_p columns[chosen[p]] - target|, by modified Gram-Schmidt, target at the end.

    columns (n, size); q (n + 1, size) and r (n + 1, n + 1) for the work. False if the chosen depend on each other.
    """
    for p in range(count):
        copy_vector(columns[chosen[p]], q[p])
    copy_vector(target, q[count])
    for p in range(count):
        before = _length(columns[chosen[p]])
        r[p, p] = _length(q[p])
        if not r[p, p] > 1e-10 * before:
            return False
        for other in range(p + 1, count + 1):
            share = _product(q[p], q[other]) / r[p, p]
            r[p, other] = share
            _add(q[other], -share / r[p, p], q[p])
    for p in range(count - 1, -1, -1):
        total = r[p, count]
        for other in range(p + 1, count):
            total -= r[p, other] * solution[other]
        solution[p] = total / r[p, p]
    return True


@njit
def _steepest(columns, residual, inside, barred):
    """Number of the column outside the active set that promises most, or -1."""
    best, found = 1e-13, -1
    for j in range(columns.shape[0]):
        if not inside[j] and not barred[j]:
            promise = _product(columns[j], residual)
            if promise > best:
                best, found = promise, j
    return found


@njit
def _left_over(columns, target, u, residual):
    """residual = target - sum_j u_j columns[j]."""
    copy_vector(target, residual)
    for j in range(columns.shape[0]):
        if u[j] != 0.0:
            _add(residual, -u[j], columns[j])


@njit
def _step_back(u, trial, chosen, count, inside):
    """Go from u towards the trial until a number reaches zero, and drop it from the active set. How many are left."""
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
    return kept


@njit
def non_negative_least_squares(columns, target, u):
    """u (n,) >= 0 of min |sum_j u_j columns[j] - target|: Lawson and Hanson's NNLS; columns (n, size) of length 1.

    False if without end.
    """
    n, size = columns.shape
    q, r, trial, residual = np.empty((n + 1, size)), np.empty((n + 1, n + 1)), np.empty(n), np.empty(size)
    chosen, count = np.empty(n, np.int64), 0
    inside, barred = np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    u[:] = 0.0
    for _ in range(10 * n + 10):
        _left_over(columns, target, u, residual)
        found = _steepest(columns, residual, inside, barred)
        if found < 0 or count == size:
            return True
        chosen[count] = found
        solved = _least_squares(columns, target, chosen, count + 1, q, r, trial)
        if not solved or trial[count] <= 0.0:
            barred[found] = True
            continue
        inside[found] = True
        count += 1
        barred[:] = False
        while count > 0 and trial[:count].min() <= 0.0:
            kept = _step_back(u, trial, chosen, count, inside)
            if kept == count:
                return False
            count = kept
            if not _least_squares(columns, target, chosen, count, q, r, trial):
                return False
        for p in range(count):
            u[chosen[p]] = trial[p]
    return False


@njit
def _shortest_within(basis, start, low, high, x, active):
    """x (n,) = start + sum_j y_j basis[j], the shortest y with low <= x <= high; active (n,) -1, 0 or 1. A status."""
    d, n = basis.shape
    columns, u = np.zeros((2 * n, d + 1)), np.empty(2 * n)
    for k in range(n):
        for side, limit in ((1.0, low[k]), (-1.0, high[k])):
            if np.isfinite(limit):
                row = columns[k if side > 0.0 else n + k]
                for j in range(d):
                    row[j] = side * basis[j, k]
                row[d] = side * (limit - start[k])
                length = _length(row)
                if length > 0.0:
                    for j in range(d + 1):
                        row[j] /= length
    target, residual = np.zeros(d + 1), np.empty(d + 1)
    target[d] = 1.0
    if not non_negative_least_squares(columns, target, u):
        return NO_END
    _left_over(columns, target, u, residual)
    for k in range(n):
        active[k] = int(u[n + k] > 0.0) - int(u[k] > 0.0)
    if not abs(residual[d]) > 1e-14:
        return BEYOND_LIMITS
    copy_vector(start, x)
    for j in range(d):
        _add(x, -residual[j] / residual[d], basis[j])
    return FOUND


@njit(**OUTER)
def least_power(matrix, demand, lower, upper, weight, currents, active):
    """currents (n,) and which limits they lie on, active (n,): -1 lower, 1 upper; a status.

    matrix (m, n), demand (m,), lower, upper, weight (n,), weight > 0; limits may be infinite. Where the status is
    BEYOND_LIMITS, active names the limits that together rule the demand out, and currents are those of no limits.
    """
    m, n = matrix.shape
    root, rest, rows = np.sqrt(weight), demand.copy(), matrix.copy()
    longest, size = 0.0, 0.0
    for r in range(m):
        for k in range(n):
            rows[r, k] /= root[k]
        longest = max(longest, _length(rows[r]))
    for r in range(m):
        length = max(_length(rows[r]), FAINT * longest)
        if length > 0.0:
            rest[r] /= length
            for k in range(n):
                rows[r, k] /= length
        size = max(size, abs(rest[r]))
    start = np.zeros(n)
    rank, off, basis = _meet(rows, rest, start)
    active[:] = 0
    for k in range(n):
        currents[k] = start[k] / root[k]
    if off > RANGE * size:
        return OUT_OF_RANGE
    return _within(basis[rank:], start, root, lower, upper, currents, active)


@njit
def _meet(rows, demand, x):
    """x (n,), the shortest with rows x = demand; rank; how far the demand is off the range; orthonormal basis (n, n),
    of which what lies behind the rank is what the rows (m, n) do not feel. Householder's QR of the columns that the
    rows are, pivoted; rows and demand are used up.
    """
    m, n = rows.shape
    basis = np.eye(n)
    rank, largest = 0, 0.0
    for p in range(min(m, n)):
        _pivot(rows, demand, p)
        size = _length(rows[p, p:])
        largest = max(largest, size)
        if not size > RANK * largest:
            break
        _reflect(rows, basis, p, size)
        z = demand[p]
        for s in range(p):
            z -= rows[p, s] * demand[s]
        demand[p] = z / rows[p, p]
        _add(x, demand[p], basis[p])
        rank += 1
    off = 0.0
    for c in range(rank, m):
        off = max(off, abs(demand[c] - _product(rows[c, :rank], demand[:rank])))
    return rank, off, basis


@njit
def _pivot(rows, demand, p):
    """Bring the row with most right of column p to place p."""
    best, found = -1.0, p
    for c in range(p, rows.shape[0]):
        size = _length(rows[c, p:])
        if size > best:
            best, found = size, c
    for s in range(rows.shape[1]):
        rows[p, s], rows[found, s] = rows[found, s], rows[p, s]
    demand[p], demand[found] = demand[found], demand[p]


@njit
def _reflect(rows, basis, p, size):
    """One Householder step: row p is turned into its diagonal, the basis gathers the turns."""
    v = rows[p, p:].copy()
    v[0] += size if v[0] >= 0.0 else -size
    twice = 2.0 / _product(v, v)
    for c in range(p, rows.shape[0]):
        _add(rows[c, p:], -twice * _product(v, rows[c, p:]), v)
    for s in range(basis.shape[1]):
        total = 0.0
        for i in range(v.shape[0]):
            total += v[i] * basis[p + i, s]
        for i in range(v.shape[0]):
            basis[p + i, s] -= twice * total * v[i]


@njit
def _within(basis, start, root, lower, upper, currents, active):
    """The limits, on top of what the demand asks for; start and limits in x, currents in A."""
    n, low, high = start.shape[0], lower * root, upper * root
    # In units of the widest limit, or of the currents: so the tolerances of the active-set method mean something.
    scale = 0.0
    for k in range(n):
        for length in (start[k], low[k], high[k]):
            if np.isfinite(length):
                scale = max(scale, abs(length))
    if scale == 0.0:
        scale = 1.0
    slack = ROUNDING * scale
    x = start.copy()
    if _excess(x, low, high) > slack:
        if basis.shape[0] == 0:
            for k in range(n):
                active[k] = int(start[k] > high[k] + slack) - int(start[k] < low[k] - slack)
            return BEYOND_LIMITS
        status = _shortest_within(basis, start / scale, low / scale, high / scale, x, active)
        if status != FOUND:
            return status
        x *= scale
        if not _excess(x, low, high) <= slack:
            return BEYOND_LIMITS
    for k in range(n):
        currents[k] = min(max(x[k] / root[k], lower[k]), upper[k])
    return FOUND


@njit
def _excess(x, low, high):
    worst = -np.inf
    for k in range(x.shape[0]):
        worst = max(worst, low[k] - x[k], x[k] - high[k])
    return worst
