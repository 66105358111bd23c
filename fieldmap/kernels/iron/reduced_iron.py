"""A tangent that is kept while the solution moves on: steps with its Cholesky factor, corrected by what they taught.

Where a step s changed the residual R = -f' of a convex functional f by -y, the true tangent takes s to y on average
along the step. The limited-memory BFGS formula corrects the kept tangent to do the same for the last steps, and leaves
it positive because s . y > 0 (J. Nocedal, Updating quasi-Newton matrices with limited storage, Math. Comput. 35 (1980)
773, the two loops on p. 779).
"""

import math
from typing import Any

import numpy as np

from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.iron.magnetisation_law import flux_density
from fieldmap.kernels.iron.matrix_vector import times, times_transposed

PAIRS = 12


@inlined(fastmath=True)
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


# Spelled out: an expression of arrays takes seconds to compile, most of them for its message about shapes.
@njit(inline="always")
def _add_times(factor, vector, total):
    """total (n,) += factor times vector (n,)."""
    for i in range(total.size):
        total[i] += factor * vector[i]


@inlined(fastmath=True)
def direction(factor, residual, changes, responses, count, out):
    """out (r,): the step that the factor and the first `count` pairs of changes and responses (PAIRS, r) propose."""
    left, shares = residual.copy(), np.empty(count)
    for k in range(count - 1, -1, -1):
        shares[k] = np.dot(changes[k], left) / np.dot(changes[k], responses[k])
        _add_times(-shares[k], responses[k], left)
    solve_factored(factor, left, out)
    for k in range(count):
        excess = np.dot(responses[k], out) / np.dot(changes[k], responses[k])
        _add_times(shares[k] - excess, changes[k], out)


@njit
def keep_pair(change, response, changes, responses, count):
    """Number of pairs after a step `change` that changed the residual by -response; the oldest gives way."""
    if not np.dot(change, response) > 0.0:
        return count
    if count == PAIRS:
        for k in range(PAIRS - 1):
            for i in range(change.size):
                changes[k, i] = changes[k + 1, i]
                responses[k, i] = responses[k + 1, i]
        count -= 1
    for i in range(change.size):
        changes[count, i] = change[i]
        responses[count, i] = response[i]
    return count + 1


# Without counts of references (map_block.PLAIN).
_PLAIN: dict[str, Any] = {"_nrt": False}
_FAST: dict[str, Any] = {**_PLAIN, "fastmath": True}
_TINY, _ROUNDING = 1e-14, 1e-7
# Numbers in a vector register, single precision.
_WIDTH = 16
# Points whose parts of the tangent are added at a time.
_POINTS = 4
# Below this relative decrement the tangent is kept for the next steps, as long as each leaves less than `_GAIN` of it.
_NEAR, _GAIN = 0.1, 0.6
# Error of h and R after steps in single precision, as a share of the largest relative decrement among them.
_SINGLE = 1e-6


@inlined(**_PLAIN)
def _magnetise_point(p, h, weights, law, offset, knots, coefficients, vector, isotropic, along):
    x, y, z = h[3 * p], h[3 * p + 1], h[3 * p + 2]
    size = math.sqrt(x * x + y * y + z * z) + _TINY
    b, slope = flux_density(size, law[p], offset, knots, coefficients)
    m = weights[p] * (b / size - 1.0)
    isotropic[p] = m
    along[p] = weights[p] * (slope - b / size) / (size * size)
    vector[3 * p], vector[3 * p + 1], vector[3 * p + 2] = m * x, m * y, m * z


@njit(**_PLAIN)
def _magnetise(h, weights, law, offset, knots, coefficients, vector, isotropic, along):
    """vector (3 p,) = w m h; isotropic (p,) = w m; along (p,) = w (db/dh - b/h) / h^2."""
    for p in range(weights.size):
        _magnetise_point(p, h, weights, law, offset, knots, coefficients, vector, isotropic, along)


@inlined(**_FAST)
def _evaluate(source, gradients, a, tables, h, vector, isotropic, along, out):
    """out (r,) = G^T (w m h) at h = s - G a, and what `_magnetise` makes of h: in one pass over G."""
    weights, law, offset, knots, coefficients = tables
    for j in range(a.size):
        out[j] = 0.0
    for p in range(weights.size):
        for k in range(3 * p, 3 * p + 3):
            row, total = gradients[k], 0.0
            for j in range(a.size):
                total += row[j] * a[j]
            h[k] = source[k] - total
        _magnetise_point(p, h, weights, law, offset, knots, coefficients, vector, isotropic, along)
        gx, gy, gz = gradients[3 * p], gradients[3 * p + 1], gradients[3 * p + 2]
        x, y, z = vector[3 * p], vector[3 * p + 1], vector[3 * p + 2]
        for j in range(a.size):
            out[j] += x * gx[j] + y * gy[j] + z * gz[j]


@inlined(**_FAST)
def _material_row(p, h, single, isotropic, along, radial, out_x, out_y, out_z):
    """Three rows (r,) of w (db/dh - 1) G, those of point p."""
    x, y, z = np.float32(h[3 * p]), np.float32(h[3 * p + 1]), np.float32(h[3 * p + 2])
    m, extra = np.float32(isotropic[p]), np.float32(along[p])
    gx, gy, gz = single[3 * p], single[3 * p + 1], single[3 * p + 2]
    # One result per loop: of more, the compiler cannot tell that they do not overlap, and makes no vector code.
    for j in range(gx.size):
        radial[j] = extra * (x * gx[j] + y * gy[j] + z * gz[j])
    for j in range(gx.size):
        out_x[j] = m * gx[j] + x * radial[j]
    for j in range(gx.size):
        out_y[j] = m * gy[j] + y * radial[j]
    for j in range(gx.size):
        out_z[j] = m * gz[j] + z * radial[j]


@inlined(**_FAST)
def _spread(row, at, place):
    """Registers of a row (wide,) to their places in `at`, where those of the rows of `_POINTS` points take turns."""
    for block in range(row.size // _WIDTH):
        to, first = (3 * _POINTS * block + place) * _WIDTH, block * _WIDTH
        for t in range(_WIDTH):
            at[to + t] = row[first + t]


@inlined(**_FAST)
def _add_points(factors, at, total, whole):
    """total (n, wide) += factors^T (rows in `at`), factors (12, n), the lower triangle unless `whole`: twelve products
    for one sum that is fetched and stored, a register at a time."""
    for i in range(total.shape[0]):
        row, f = total[i], factors[:, i]
        a, b, c, d, e, g = f[0], f[1], f[2], f[3], f[4], f[5]
        m, n, o, p, q, r = f[6], f[7], f[8], f[9], f[10], f[11]
        for block in range(row.size // _WIDTH if whole else i // _WIDTH + 1):
            k = 3 * _POINTS * block * _WIDTH
            for j in range(block * _WIDTH, (block + 1) * _WIDTH):
                row[j] += (
                    (a * at[k] + b * at[k + _WIDTH] + c * at[k + 2 * _WIDTH])
                    + (d * at[k + 3 * _WIDTH] + e * at[k + 4 * _WIDTH] + g * at[k + 5 * _WIDTH])
                    + (m * at[k + 6 * _WIDTH] + n * at[k + 7 * _WIDTH] + o * at[k + 8 * _WIDTH])
                    + (p * at[k + 9 * _WIDTH] + q * at[k + 10 * _WIDTH] + r * at[k + 11 * _WIDTH])
                )
                k += 1


@inlined(fastmath=True)
def material_tangent(h, single, isotropic, along, unit):
    """Lower triangle of G^T w (db/dh - 1) G (r, r or more), in single precision; what lies above it is not complete.
    And G^T w (db/dh - 1) s (c, r or more) for the coils' fields per ampere `unit` (3 p, c)."""
    count, points, coils = single.shape[1], isotropic.size, unit.shape[1]
    # Rows of whole vector registers; the numbers behind the last one are zero.
    wide = _WIDTH * ((count + _WIDTH - 1) // _WIDTH)
    total, sides = np.zeros((count, wide), np.float32), np.zeros((coils, wide), np.float32)
    radial, at = np.zeros(wide, np.float32), np.zeros(3 * _POINTS * wide, np.float32)
    at_x, at_y, at_z = np.zeros(wide, np.float32), np.zeros(wide, np.float32), np.zeros(wide, np.float32)
    rest, applied = np.zeros((3 * _POINTS, count), np.float32), np.zeros((3 * _POINTS, coils), np.float32)
    for first in range(0, points, _POINTS):
        for k in range(min(_POINTS, points - first)):
            _material_row(first + k, h, single, isotropic, along, radial, at_x, at_y, at_z)
            _spread(at_x, at, 3 * k)
            _spread(at_y, at, 3 * k + 1)
            _spread(at_z, at, 3 * k + 2)
        if first + _POINTS <= points:
            _add_points(single[3 * first : 3 * (first + _POINTS)], at, total, False)
        else:
            for k in range(3 * (points - first)):
                for i in range(count):
                    rest[k, i] = single[3 * first + k, i]
            _add_points(rest, at, total, False)
        for k in range(3 * _POINTS):
            for c in range(coils):
                there = 3 * first + k < unit.shape[0]
                applied[k, c] = unit[3 * first + k, c] if there else 0.0
        _add_points(applied, at, sides, True)
    return total, sides[:, :count]


@inlined(fastmath=True)
def fill_tangent_factor(h, single, isotropic, along, air, factor, unit):
    """factor (r, r), lower: that of Cholesky of K. Returns what `material_tangent` does of the coils' fields per
    ampere `unit` (3 p, c)."""
    tangent, sides = material_tangent(h, single, isotropic, along, unit)
    for i in range(air.shape[0]):
        whole = np.float64(tangent[i, i]) + air[i, i]
        for j in range(i + 1):
            value = np.float64(tangent[i, j]) + air[i, j]
            for k in range(j):
                value -= factor[i, k] * factor[j, k]
            if i > j:
                factor[i, j] = value / factor[j, j]
                continue
            if value < _ROUNDING * whole:
                # What is left is rounding, and what would be divided by its root would grow from row to row: the
                # factor then has this mode by itself.
                value = whole
                for k in range(i):
                    factor[i, k] = 0.0
            factor[i, i] = math.sqrt(value)
    return sides


@inlined(fastmath=True)
def energy_of(factor, amplitude):
    """a . K a."""
    product = np.zeros(amplitude.size)
    for i in range(amplitude.size):
        for k in range(i + 1):
            product[k] += factor[i, k] * amplitude[i]
    return np.dot(product, product)


@njit(inline="always")
def add_rest(constant, air, residual):
    """residual (r,) += constant - air."""
    for i in range(residual.size):
        residual[i] += constant[i] - air[i]


@njit(nogil=True)
def newton(
    source,
    gradients,
    single,
    weights,
    law,
    offset,
    knots,
    coefficients,
    air,
    constant,
    start,
    factor,
    tolerance,
    limit,
):
    """Amplitudes (r,) for the coils' field `source` (3 p,) at the sample points, from `start` (r,).

    gradients (3 p, r), also in single precision, weights and law (p,), tables of
    `fieldmap.kernels.iron.magnetisation_law`, air (r, r), constant (r,) = r0. factor (r, r): the Cholesky factor of a
    tangent near the solution, or zeros; overwritten with the last one. Stops when the Newton decrement is below
    `tolerance` times the energy norm of the amplitudes, and takes that step too. Returns the amplitudes, the number
    of steps, and the last relative decrement (larger than `tolerance` if `limit` steps were not enough).
    """
    a, change = start.copy(), np.empty_like(start)
    h, trial = np.empty_like(source), np.empty_like(source)
    vector, moved, moved_by = np.empty_like(h), np.empty_like(h), np.empty(h.size, np.float32)
    isotropic, along = np.empty(weights.size), np.empty(weights.size)
    # Not a bare 0: what takes it would be compiled for that number, and again for others.
    none = np.int64(0)
    changes, responses, count = np.empty((PAIRS, a.size)), np.empty((PAIRS, a.size)), none
    tables = (weights, law, offset, knots, coefficients)
    residual, response = np.empty_like(a), np.empty_like(a)
    _evaluate(source, gradients, a, tables, h, vector, isotropic, along, residual)
    add_rest(constant, times(air, a), residual)
    decrement, before, farthest, largest = np.inf, np.inf, 0.0, 1e-300
    known, alone = factor[0, 0] > 0.0, np.empty((0, 0))
    for step in range(limit):
        for _ in range(2):
            fresh = not known
            if fresh:
                fill_tangent_factor(h, single, isotropic, along, air, factor, alone)
                count = none
            direction(factor, residual, changes, responses, count, change)
            slope = np.dot(residual, change)
            # A thousandth of what there was counts as well: where the solution is zero, nothing is small beside it.
            energy = energy_of(factor, a)
            largest = max(largest, energy)
            decrement = math.sqrt(max(slope, 0.0) / max(energy, 1e-6 * largest))
            known = fresh or decrement < _GAIN * before
            if known:
                break
        # A tangent from elsewhere may be far too stiff: one small step with it proves nothing.
        if (fresh or before < np.inf) and decrement < tolerance:
            if _SINGLE * farthest < tolerance:
                _add_times(1.0, change, a)
                return a, step + 1, decrement
            _evaluate(source, gradients, a, tables, h, vector, isotropic, along, residual)
            add_rest(constant, times(air, a), residual)
            before, farthest = np.inf, 0.0
            continue
        before, farthest = decrement, max(farthest, decrement)
        known = decrement < _NEAR
        step_h = times(single, change.astype(np.float32)).astype(np.float64)
        air_change = times(air, change)
        rest = np.dot(vector, step_h) - slope, np.dot(air_change, change)
        t = _step_length(h, step_h, rest, slope, tables, trial, moved, isotropic, along)
        h, trial = trial, h
        for k in range(h.size):
            moved_by[k] = moved[k] - vector[k]
        material = times_transposed(moved_by, single)
        vector, moved = moved, vector
        for i in range(a.size):
            response[i] = t * air_change[i] - material[i]
            change[i] *= t
        _add_times(-1.0, response, residual)
        _add_times(1.0, change, a)
        count = keep_pair(change, response, changes, responses, count)
    return a, limit, decrement


@inlined
def _step_length(h, step, rest, start, tables, trial, vector, isotropic, along):
    """Where the functional is least along a step: trial = h - t `step`, t in (0, 1].

    rest: slope at 0 and second derivative of what does not depend on h; start: the functional's slope at 0. vector,
    isotropic, along: what `_magnetise` makes of `trial`.
    """
    weights, law, offset, knots, coefficients = tables
    low, high, low_value, high_value, t = 0.0, 1.0, start, 0.0, 1.0
    for attempt in range(12):
        for k in range(h.size):
            trial[k] = h[k] - t * step[k]
        _magnetise(trial, weights, law, offset, knots, coefficients, vector, isotropic, along)
        value = np.dot(vector, step) - rest[0] - t * rest[1]
        if attempt == 0:
            if value > 0.0 or abs(value) <= 0.3 * abs(start):
                return 1.0
            high_value = value
        elif abs(value) < 0.1 * abs(start):
            return t
        elif value < 0.0:
            high, high_value = t, value
        else:
            low, low_value = t, value
        if attempt < 11:
            t = low + (high - low) * min(max(low_value / (low_value - high_value), 0.1), 0.9)
    return t


@njit
def sensitivities(
    sources, gradients, single, weights, law, offset, knots, coefficients, air, amplitudes, unit_source
):
    """Derivatives (s, r, c) of the amplitudes (s, r) of states by the currents, and Cholesky factors (s, r, r) of K.

    sources (3 p, s): the coils' field of every state at the sample points; unit_source (3 p, c): that of one ampere in
    every coil; the rest as for `newton`. K da/dI = G^T w (db/dh - 1) s.
    """
    states, modes, coils = amplitudes.shape[0], amplitudes.shape[1], unit_source.shape[1]
    out = np.empty((states, modes, coils))
    vector = np.empty(gradients.shape[0])
    isotropic, along = np.empty(weights.size), np.empty(weights.size)
    factors, column = np.zeros((states, modes, modes)), np.empty(modes)
    for s in range(states):
        h = sources[:, s] - times(gradients, amplitudes[s])
        _magnetise(h, weights, law, offset, knots, coefficients, vector, isotropic, along)
        right = fill_tangent_factor(h, single, isotropic, along, air, factors[s], unit_source)
        for c in range(coils):
            solve_factored(factors[s], right[c], column)
            for i in range(modes):
                out[s, i, c] = column[i]
    return out, factors
