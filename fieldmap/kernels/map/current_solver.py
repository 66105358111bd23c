"""Currents to weights of the fields of saturating iron, for compiled callers: Newton's method without Python.

The equation is that of `fieldmap.kernels.map.reduced_iron`, with the gradients in single precision throughout. A solve
begins from an expansion of the amplitudes in Chebyshev polynomials of the currents' signals, or, near the currents
asked for before, from where those lead. A step reads the gradients once. What a caller passes: a `CompiledModel`, which
is never written to, and a `SolverState`, one for each thread. fieldmap.h has the same in C.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numpy.typing import NDArray

from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.late_call import LateFunctions, array_at
from fieldmap.kernels.map.continuation import continued
from fieldmap.kernels.map.lift_and_directions import signals
from fieldmap.kernels.map.lookup import at_currents
from fieldmap.kernels.map.parametrisation import LIFT_AND_DIRECTIONS
from fieldmap.kernels.map.reduced_iron import (
    PAIRS,
    add_rest,
    direction,
    energy_of,
    fill_tangent_factor,
    keep_pair,
    solve_factored,
)

FOUND, BEYOND, NOT_CONVERGED, NOT_FINITE = 0, 1, 2, 3

PASSED = 3
"""States behind, from which one near them begins."""

# Positions in `SolverState.numbers`: how many states it has passed; steps of the newest, and what they left of it,
# estimated, in the norm of the energy.
COUNT, STEPS, LEFT = 0, 1, 2
NUMBERS = 3

MOST_STEPS = 60
"""Steps after which a solve gives up."""
# Nearer than this share of the range of the signals to the last ones, a solve begins from those behind.
_NEAR = 0.1
# As in `reduced_iron.newton`: below this decrement the tangent is kept, as long as a step leaves less than _GAIN of it.
_KEPT, _GAIN = 0.1, 0.6
# Share of a tolerance to which states are solved whose slopes are asked for.
_FOR_SLOPES = 0.01
# Below this tolerance slopes are corrected so often: each time leaves a thousandth or less.
_CORRECTED, _CORRECTIONS = 1e-9, 3
_SINGLE, _TINY = 1e-6, 1e-14
# Without counts of references (map_block.PLAIN).
_PLAIN: dict[str, Any] = {"_nrt": False}
_FAST: dict[str, Any] = {**_PLAIN, "fastmath": True}


class SignalDomain(NamedTuple):
    """The currents that a model is for. kind, exponent: as `fieldmap.kernels.map.parametrisation`; matrix (c, d):
    currents of signals, inverse (d, c) its pseudo-inverse, both empty for LIFT_AND_DIRECTIONS; lower, upper (d,), with
    a margin of rounding; limit of every current, A, or infinity; tolerance of currents that are not of the
    parametrisation; checked: whether currents beyond are refused."""

    kind: int
    exponent: float
    matrix: NDArray[np.float64]
    inverse: NDArray[np.float64]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    limit: float
    tolerance: float
    checked: bool


class CompiledModel(NamedTuple):
    """The arrays of a `fieldmap.store.ReducedModel` as this kernel takes them: p points, r modes, c coils, k fields.

    gradients (3 p, r), single precision; fixed (3 p,) or (0,); the others as there. terms (t, 3) and expansion (t, r),
    single precision: amplitudes as a sum over products of Chebyshev polynomials of the signals, each scaled to -1..1; a
    term is another term before it (column 0) times the polynomial of signal (1) and degree (2); the first is 1.
    tolerance: share of the state that a solve may leave, in the norm of the energy.
    """

    source: NDArray[np.float64]
    fixed: NDArray[np.float64]
    gradients: NDArray[np.float32]
    weights: NDArray[np.float64]
    law: NDArray[np.int64]
    offset: NDArray[np.int64]
    knots: NDArray[np.float64]
    coefficients: NDArray[np.float64]
    air: NDArray[np.float64]
    constant: NDArray[np.float64]
    output: NDArray[np.float64]
    terms: NDArray[np.int64]
    expansion: NDArray[np.float32]
    domain: SignalDomain
    tolerance: float


class SolverState(NamedTuple):
    """What a solver remembers: the last currents (PASSED, c) with their amplitudes (PASSED, r), newest last, a factor
    (r, r) of the tangent near the newest, h (3 p,) there, the piece (p,) of the law at every point, NUMBERS numbers,
    and weights (f,) of the newest."""

    currents: NDArray[np.float64]
    amplitudes: NDArray[np.float64]
    factor: NDArray[np.float64]
    h: NDArray[np.float64]
    piece: NDArray[np.int64]
    numbers: NDArray[np.float64]
    weights: NDArray[np.float64]


# What numba makes of them. Arrays of other types, such as those that may not be written to, are others to it.
_VECTOR, _MATRIX, _WORDS, _TERMS, _SINGLES = (
    types.Array(number, dimensions, "C")
    for number, dimensions in (
        (types.float64, 1),
        (types.float64, 2),
        (types.int64, 1),
        (types.int64, 2),
        (types.float32, 2),
    )
)
_READ = types.Array(types.float64, 1, "C", readonly=True)
_ENDS = types.float64, _MATRIX, _MATRIX, _VECTOR, _VECTOR, types.float64, types.float64, types.boolean
DOMAIN = types.NamedTuple((types.int64, *_ENDS), SignalDomain)
_LAW = _VECTOR, _WORDS, _WORDS, _VECTOR, _MATRIX
_EXPANSION = _TERMS, _SINGLES
MODEL = types.NamedTuple(
    (_MATRIX, _VECTOR, _SINGLES, *_LAW, _MATRIX, _VECTOR, _MATRIX, *_EXPANSION, DOMAIN, types.float64),
    CompiledModel,
)
STATE = types.NamedTuple((_MATRIX, _MATRIX, _MATRIX, _VECTOR, _WORDS, _VECTOR, _VECTOR), SolverState)


@njit
def signals_of(domain, currents, out):
    """Fill out (d,) with the nearest signals of currents (c,); whether they are in the domain."""
    largest = 0.0
    for k in range(currents.size):
        largest = max(largest, abs(currents[k]))
    if domain.kind == LIFT_AND_DIRECTIONS:
        u, x, y, worst = signals(currents, domain.exponent)
        out[0], out[1], out[2] = u, x, y
    else:
        for j in range(out.size):
            out[j] = 0.0
            for k in range(currents.size):
                out[j] += domain.inverse[j, k] * currents[k]
        worst = 0.0
        for k in range(currents.size):
            off = -currents[k]
            for j in range(out.size):
                off += domain.matrix[k, j] * out[j]
            worst = max(worst, abs(off))
        if largest > 0.0:
            worst /= largest
    inside = worst <= domain.tolerance and largest <= domain.limit
    for j in range(out.size):
        inside = inside and domain.lower[j] <= out[j] <= domain.upper[j]
    return inside


@inlined(**_FAST)
def _polynomials(values, lower, upper, out):
    """out (d, n): Chebyshev polynomials of the signals (d,), each scaled to -1..1 and taken to the nearest there."""
    for j in range(values.size):
        width = upper[j] - lower[j]
        x = min(max(2.0 * (values[j] - lower[j]) / width - 1.0, -1.0), 1.0) if width > 0.0 else 0.0
        out[j, 0], out[j, 1] = 1.0, x
        for n in range(2, out.shape[1]):
            out[j, n] = 2.0 * x * out[j, n - 1] - out[j, n - 2]


@inlined(**_PLAIN)
def _multiply(terms, polynomials, out):
    """out (t,): the value of every term."""
    out[0] = 1.0
    for i in range(1, out.size):
        out[i] = out[terms[i, 0]] * polynomials[terms[i, 1], terms[i, 2]]


@njit(forceinline=True)
def products_of_terms(terms, values, domain):
    """The values (t,) of terms (t, 3), as in `CompiledModel`, at signals (d,) of the domain."""
    degree = 1
    for i in range(terms.shape[0]):
        degree = max(degree, terms[i, 2])
    polynomials = np.empty((values.size, degree + 1))
    _polynomials(values, domain.lower, domain.upper, polynomials)
    out = np.empty(terms.shape[0])
    _multiply(terms, polynomials, out)
    return out


@inlined(**_FAST)
def _sum_terms(products, expansion, total):
    """total (r,), single precision: the terms' values times their coefficients (t, r)."""
    for m in range(total.size):
        total[m] = np.float32(0.0)
    for i in range(products.size):
        share, row = np.float32(products[i]), expansion[i]
        for m in range(total.size):
            total[m] += share * row[m]


@inlined
def expanded(model, values, out):
    """out (r,): the amplitudes that the expansion gives at signals (d,), taken to the nearest of the domain."""
    total = np.empty(out.size, np.float32)
    _sum_terms(products_of_terms(model.terms, values, model.domain), model.expansion, total)
    for m in range(out.size):
        out[m] = total[m]


@inlined(**_PLAIN)
def _law(p, h, tables, piece):
    """b and db/dh at point p; piece: where the law was last found, renewed."""
    _, law, offset, knots, c = tables
    j, high = piece[p], offset[law[p] + 1] - 1
    if not (knots[j] <= h and (j == high or h < knots[j + 1])):
        j, above = offset[law[p]], high
        while above - j > 1:
            middle = (j + above) // 2
            if knots[middle] <= h:
                j = middle
            else:
                above = middle
        if h >= knots[high]:
            j = high
        piece[p] = j
    t = h - knots[j]
    c0, c1, c2, c3 = c[j, 0], c[j, 1], c[j, 2], c[j, 3]
    if j == high:
        c0, c1 = 0.0, 0.0
    return ((c0 * t + c1) * t + c2) * t + c3, (3.0 * c0 * t + 2.0 * c1) * t + c2


@inlined(**_PLAIN)
def _magnetised(p, x, y, z, tables, piece):
    """w m(|h|) of point p."""
    size = math.sqrt(x * x + y * y + z * z) + _TINY
    b, _ = _law(p, size, tables, piece)
    return tables[0][p] * (b / size - 1.0)


@njit(**_FAST)
def _evaluate(applied, g, a, tables, h, piece, vector, material):
    """h (3 p,) = applied - G a, vector (3 p,) = w m h, material (r,) = G^T w m h: sums in double precision."""
    for j in range(a.size):
        material[j] = 0.0
    for p in range(piece.size):
        k = 3 * p
        gx, gy, gz = g[k], g[k + 1], g[k + 2]
        x, y, z = 0.0, 0.0, 0.0
        for j in range(a.size):
            x += gx[j] * a[j]
            y += gy[j] * a[j]
            z += gz[j] * a[j]
        x, y, z = applied[k] - x, applied[k + 1] - y, applied[k + 2] - z
        m = _magnetised(p, x, y, z, tables, piece)
        h[k], h[k + 1], h[k + 2] = x, y, z
        x, y, z = m * x, m * y, m * z
        vector[k], vector[k + 1], vector[k + 2] = x, y, z
        for j in range(a.size):
            material[j] += x * gx[j] + y * gy[j] + z * gz[j]


@njit(**_FAST)
def _field_at(applied, g, a, h):
    """h (3 p,) = applied - G a, in double precision."""
    for k in range(h.size):
        row, total = g[k], 0.0
        for j in range(a.size):
            total += row[j] * a[j]
        h[k] = applied[k] - total


@njit(**_FAST)
def _step(g, change, tables, h, piece, vector, step_h, moved, response):
    """At h - G change: step_h (3 p,) = G change, moved (3 p,) = w m h, response (r,) = G^T (moved - vector).

    One pass over G. Returns the slopes of the law's part of the functional along the step, before and behind it."""
    for j in range(change.size):
        response[j] = np.float32(0.0)
    before, behind = 0.0, 0.0
    for p in range(piece.size):
        k = 3 * p
        gx, gy, gz = g[k], g[k + 1], g[k + 2]
        sx, sy, sz = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for j in range(change.size):
            sx += gx[j] * change[j]
            sy += gy[j] * change[j]
            sz += gz[j] * change[j]
        step_h[k], step_h[k + 1], step_h[k + 2] = sx, sy, sz
        x, y, z = h[k] - sx, h[k + 1] - sy, h[k + 2] - sz
        m = _magnetised(p, x, y, z, tables, piece)
        x, y, z = m * x, m * y, m * z
        moved[k], moved[k + 1], moved[k + 2] = x, y, z
        before += vector[k] * sx + vector[k + 1] * sy + vector[k + 2] * sz
        behind += x * sx + y * sy + z * sz
        dx, dy, dz = np.float32(x - vector[k]), np.float32(y - vector[k + 1]), np.float32(z - vector[k + 2])
        for j in range(change.size):
            response[j] += dx * gx[j] + dy * gy[j] + dz * gz[j]
    return before, behind


@njit(**_FAST)
def _respond(g, vector, moved, response):
    """response (r,) = G^T (moved - vector)."""
    for j in range(response.size):
        response[j] = np.float32(0.0)
    for k in range(vector.size):
        share, row = np.float32(moved[k] - vector[k]), g[k]
        for j in range(response.size):
            response[j] += share * row[j]


@njit(**_PLAIN)
def _slope_at(h, step_h, t, tables, piece, moved):
    """The slope of the law's part of the functional along the step at h - t step_h; moved (3 p,) = w m h there."""
    total = 0.0
    for p in range(piece.size):
        k = 3 * p
        x, y, z = h[k] - t * step_h[k], h[k + 1] - t * step_h[k + 1], h[k + 2] - t * step_h[k + 2]
        m = _magnetised(p, x, y, z, tables, piece)
        moved[k], moved[k + 1], moved[k + 2] = m * x, m * y, m * z
        total += m * (x * step_h[k] + y * step_h[k + 1] + z * step_h[k + 2])
    return total


@njit(**_PLAIN)
def _shorter(h, step_h, rest, start, end, tables, piece, moved):
    """Where the functional is least along a step that is too long, in (0, 1). rest: slope at 0 and second derivative of
    what does not depend on h; start, end: slopes at 0 and 1."""
    low, high, low_value, high_value, t = 0.0, 1.0, start, end, 1.0
    for _ in range(11):
        t = low + (high - low) * min(max(low_value / (low_value - high_value), 0.1), 0.9)
        value = _slope_at(h, step_h, t, tables, piece, moved) - rest[0] - t * rest[1]
        if abs(value) < 0.1 * abs(start):
            break
        if value < 0.0:
            high, high_value = t, value
        else:
            low, low_value = t, value
    return t


@njit(**_PLAIN)
def _magnetise(h, tables, piece, isotropic, along):
    """isotropic (p,) = w m; along (p,) = w (db/dh - b/h) / h^2 at h (3 p,)."""
    weights = tables[0]
    for p in range(piece.size):
        x, y, z = h[3 * p], h[3 * p + 1], h[3 * p + 2]
        size = math.sqrt(x * x + y * y + z * z) + _TINY
        b, slope = _law(p, size, tables, piece)
        isotropic[p] = weights[p] * (b / size - 1.0)
        along[p] = weights[p] * (slope - b / size) / (size * size)


@inlined(**_FAST)
def _times(matrix, vector, out):
    """out (n,) = matrix (n, m) @ vector (m,)."""
    for i in range(out.size):
        row, total = matrix[i], 0.0
        for j in range(vector.size):
            total += row[j] * vector[j]
        out[i] = total


@njit(**_FAST)
def _product(a, b):
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i]
    return total


@njit(inline="always")
def _tables(model):
    return model.weights, model.law, model.offset, model.knots, model.coefficients


@njit(inline="always")
def _tangent(model, h, piece, factor, isotropic, along, unit):
    """Fill factor (r, r), lower, with that of Cholesky of the tangent at h (3 p,), and what `_magnetise` fills; the
    right-hand sides of the fields `unit` (3 p, c)."""
    _magnetise(h, _tables(model), piece, isotropic, along)
    return fill_tangent_factor(h, model.gradients, isotropic, along, model.air, factor, unit)


@njit(inline="always")
def _applied(model, currents):
    """Field (3 p,) of coils and background at the points, T."""
    out = np.empty(model.source.shape[0])
    _times(model.source, currents, out)
    for i in range(model.fixed.size):
        out[i] += model.fixed[i]
    return out


@njit(inline="always")
def _begin(model, state, currents, values, a):
    """Fill a (r,) with amplitudes to begin with; whether they come from the states behind."""
    d, count = model.domain, int(state.numbers[COUNT])
    near = count > 0
    if near:
        last = np.empty(values.size)
        signals_of(d, state.currents[PASSED - 1], last)
        for j in range(values.size):
            near = near and abs(values[j] - last[j]) <= _NEAR * (d.upper[j] - d.lower[j])
    if near:
        behind, of = state.currents[PASSED - count :], state.amplitudes[PASSED - count :]
        continued(currents, behind, of, np.empty(count), np.empty(count), a)
    else:
        expanded(model, values, a)
    return near


def _late_solve(model, state, amperes, coils, tolerance):
    currents, r, n = array_at(amperes, (coils,)), model.constant.size, 3 * model.weights.size
    for k in range(coils):
        if not math.isfinite(currents[k]):
            return NOT_FINITE
    values = np.empty(model.domain.lower.size)
    if not signals_of(model.domain, currents, values) and model.domain.checked:
        return BEYOND
    numbers = state.numbers
    same = numbers[COUNT] > 0.0 and numbers[LEFT] < tolerance
    for k in range(coils):
        same = same and state.currents[PASSED - 1, k] == currents[k]
    if same:
        return FOUND
    a, change = np.empty(r), np.empty(r)
    near = _begin(model, state, currents, values, a)
    known, factor = near, state.factor
    applied = _applied(model, currents)
    h, vector, moved, step_h = state.h, np.empty(n), np.empty(n), np.empty(n)
    isotropic, along = np.empty(model.weights.size), np.empty(model.weights.size)
    residual, response, air_change = np.empty(r), np.empty(r), np.empty(r)
    single, change_single = np.empty(r, np.float32), np.empty(r, np.float32)
    alone = np.empty((0, 0))
    # Not a bare 0: what takes it would be compiled for that number, and again for others.
    none = np.int64(0)
    changes, responses, count = np.empty((PAIRS, r)), np.empty((PAIRS, r)), none
    g, piece, tables = model.gradients, state.piece, _tables(model)
    _times(model.air, a, air_change)
    _evaluate(applied, g, a, tables, h, piece, vector, residual)
    add_rest(model.constant, air_change, residual)
    decrement, before, farthest, largest, steps = np.inf, np.inf, 0.0, 1e-300, 0
    found, left = False, np.inf
    while steps < MOST_STEPS:
        steps += 1
        for _ in range(2):
            fresh = not known
            if fresh:
                _tangent(model, h, piece, factor, isotropic, along, alone)
                count = none
            direction(factor, residual, changes, responses, count, change)
            slope = _product(residual, change)
            energy = energy_of(factor, a)
            largest = max(largest, energy)
            decrement = math.sqrt(max(slope, 0.0) / max(energy, 1e-6 * largest))
            known = fresh or decrement < _GAIN * before
            if known:
                break
        # What is left behind this step, if it leaves as large a share as the last one did; no less than the step, for
        # with a tangent that is too stiff one small step proves little.
        share = min(decrement / before, 0.9) if 0.0 < before < np.inf else 0.5
        left = decrement * max(1.0, share / (1.0 - share))
        if (fresh or before < np.inf or near) and left < tolerance:
            if _SINGLE * farthest < tolerance:
                for i in range(r):
                    a[i] += change[i]
                found = True
                break
            _times(model.air, a, air_change)
            _evaluate(applied, g, a, tables, h, piece, vector, residual)
            add_rest(model.constant, air_change, residual)
            before, farthest = np.inf, 0.0
            continue
        before, farthest = decrement, max(farthest, decrement)
        known = decrement < _KEPT
        for i in range(r):
            change_single[i] = change[i]
        was, end = _step(g, change_single, tables, h, piece, vector, step_h, moved, single)
        _times(model.air, change, air_change)
        rest, t = (was - slope, _product(air_change, change)), 1.0
        end -= rest[0] + rest[1]
        if end < -0.3 * abs(slope):
            t = _shorter(h, step_h, rest, slope, end, tables, piece, moved)
            _respond(g, vector, moved, single)
        for k in range(n):
            h[k] -= t * step_h[k]
        vector, moved = moved, vector
        for i in range(r):
            response[i] = t * air_change[i] - single[i]
            residual[i] -= response[i]
            change[i] *= t
            a[i] += change[i]
        count = keep_pair(change, response, changes, responses, count)
    numbers[STEPS], numbers[LEFT] = steps, left
    if not found:
        numbers[COUNT] = 0.0
        return NOT_CONVERGED
    _remember(model, state, currents, a, near)
    return FOUND


@njit(inline="always")
def _remember(model, state, currents, a, near):
    """Put the newest state behind the others, or in place of them where it did not begin from them."""
    if near:
        state.numbers[COUNT] = min(state.numbers[COUNT] + 1.0, float(PASSED))
        for m in range(PASSED - 1):
            for k in range(currents.size):
                state.currents[m, k] = state.currents[m + 1, k]
            for j in range(a.size):
                state.amplitudes[m, j] = state.amplitudes[m + 1, j]
    else:
        state.numbers[COUNT] = 1.0
    for k in range(currents.size):
        state.currents[PASSED - 1, k] = currents[k]
    for j in range(a.size):
        state.amplitudes[PASSED - 1, j] = a[j]
    coils, fields = currents.size, model.output.shape[0]
    for k in range(coils):
        state.weights[k] = currents[k]
    for f in range(fields):
        total = 0.0
        for j in range(a.size):
            total += model.output[f, j] * a[j]
        state.weights[coils + f] = total
    if model.fixed.size:
        state.weights[coils + fields] = 1.0


# Compiled once: it is large, and linked into every loop that solves, users' own among them.
SOLVER = LateFunctions(
    "fieldmap_solve_for_currents",
    types.intp,
    (MODEL, STATE, _READ, types.intp, types.float64),
    [_late_solve],
)
_solve = SOLVER.called_or_linked()


@njit(nogil=True)
def solve(model, state, currents, tolerance):
    """Amplitudes at currents (c,), left in state; FOUND, BEYOND the domain, NOT_CONVERGED or NOT_FINITE.

    tolerance: share of the state that it may leave. A state that was not found forgets what it
    passed. Currents as those of before, solved as exactly, cost nothing.
    """
    return _solve(model, state, currents, currents.size, tolerance)


@njit(nogil=True)
def current_weights(model, state, currents, out):
    """Fill out (f,) with the weights of a map's fields at currents (c,): the currents, then those of the iron's fields,
    then 1 for a background if there is any. Status as of `solve`; NaN unless FOUND."""
    return _weights(model, state, currents, model.tolerance, out)


@njit
def _weights(model, state, currents, tolerance, out):
    status = solve(model, state, currents, tolerance)
    for f in range(out.size):
        out[f] = state.weights[f] if status == FOUND else np.nan
    return status


@njit(**_FAST)
def _left_of_slope(model, h, isotropic, along, coil, column, out):
    """out (r,) = G^T w (db/dh - 1) (s - G column) - A column for the field s of a coil: sums in double precision."""
    g, unit = model.gradients, model.source
    _times(model.air, column, out)
    for i in range(out.size):
        out[i] = -out[i]
    for p in range(isotropic.size):
        k = 3 * p
        gx, gy, gz = g[k], g[k + 1], g[k + 2]
        x, y, z = 0.0, 0.0, 0.0
        for j in range(column.size):
            x += gx[j] * column[j]
            y += gy[j] * column[j]
            z += gz[j] * column[j]
        x, y, z = unit[k, coil] - x, unit[k + 1, coil] - y, unit[k + 2, coil] - z
        radial = along[p] * (h[k] * x + h[k + 1] * y + h[k + 2] * z)
        x, y, z = (
            isotropic[p] * x + radial * h[k],
            isotropic[p] * y + radial * h[k + 1],
            isotropic[p] * z + radial * h[k + 2],
        )
        for j in range(out.size):
            out[j] += x * gx[j] + y * gy[j] + z * gz[j]


def _late_slopes(model, state, amperes, weights, derivatives, coils, fields, shape):
    currents, out = array_at(amperes, (coils,)), array_at(weights, (fields,))
    slopes = array_at(derivatives, shape)
    status = _weights(model, state, currents, _FOR_SLOPES * model.tolerance, out)
    for f in range(out.size):
        for c in range(currents.size):
            slopes[f, c] = 0.0 if status == FOUND else np.nan
    if status != FOUND:
        return status
    newest = state.amplitudes[PASSED - 1]
    # h of the last step, not of the one before it.
    _field_at(_applied(model, currents), model.gradients, newest, state.h)
    isotropic, along = np.empty(model.weights.size), np.empty(model.weights.size)
    right = _tangent(model, state.h, state.piece, state.factor, isotropic, along, model.source)
    column, left = np.empty(model.constant.size), np.empty(model.constant.size)
    correction = np.empty(model.constant.size)
    for c in range(coils):
        slopes[c, c] = 1.0
        solve_factored(state.factor, right[c], column)
        for _ in range(_CORRECTIONS if model.tolerance < _CORRECTED else 0):
            _left_of_slope(model, state.h, isotropic, along, c, column, left)
            solve_factored(state.factor, left, correction)
            for j in range(column.size):
                column[j] += correction[j]
        for f in range(model.output.shape[0]):
            total = 0.0
            for j in range(column.size):
                total += model.output[f, j] * column[j]
            slopes[coils + f, c] = total
    return status


SLOPES = LateFunctions(
    "fieldmap_slopes_by_currents",
    types.intp,
    (MODEL, STATE, _READ, _VECTOR, _MATRIX, types.intp, types.intp, types.UniTuple(types.intp, 2)),
    [_late_slopes],
)
_slopes = SLOPES.called_or_linked()


@njit(nogil=True)
def current_slopes(model, state, currents, out, slopes):
    """`current_weights`, and slopes (f, c): their derivatives by the currents, 1/A, of the model itself. Both are as
    exact as a hundredth of the tolerance makes them: slopes follow the state to first order. The tangent is summed in
    single precision, which leaves some 1e-6 of them; below a tolerance of 1e-9 they are corrected in double."""
    return _slopes(model, state, currents, out, slopes, currents.size, out.size, slopes.shape)


@njit(nogil=True)
def solved_at_currents(data, currents, x, y, z):
    """B, G as of `fieldmap.kernels.map.lookup.at_currents`; data: (block, CompiledModel, SolverState). NaN where there
    is no solution."""
    block, model, state = data
    weights = np.empty(state.weights.size)
    current_weights(model, state, currents, weights)
    return at_currents(block, weights, x, y, z)
