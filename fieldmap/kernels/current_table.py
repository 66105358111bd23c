"""Weights of a map's fields from a table over the signals of a current division: a tensor product of cubic splines.

The signals u, x, y are found from the currents as in `fieldmap.device.current_division` (thesis (6-2), (6-3)); the
splines' coefficients (nu, nx, ny, k) belong to knots with four at each end, so that they are defined from the first to
the last node. A spline's basis follows from the recurrence of Cox and de Boor (C. de Boor, A Practical Guide to
Splines, Springer 1978, X (4)).
"""

import numpy as np
from numba import njit

from fieldmap.kernels.lookup import at_currents

FOUND, NOT_A_DIVISION, BEYOND = 0, 1, 2


@njit(cache=True, error_model="numpy")
def signals(currents, exponent):
    """(u, x, y, mismatch): the signals whose division with exponent n is nearest, and by what share of u it is off."""
    i = currents
    u = (i[0] + i[1] + i[2] + i[3] + i[4] + i[5]) / 6.0
    x = (i[3] + i[5] - i[0] - i[2] + exponent * (i[4] - i[1])) / (4.0 + 2.0 * exponent * exponent) / u
    y = (i[2] + i[5] - i[0] - i[3]) / (4.0 * u)
    worst = 0.0
    middle = 0.0
    for k in range(6):
        if k == 1 or k == 4:
            continue
        corner = u * (1.0 + (x if k > 2 else -x)) * (1.0 + (y if k == 2 or k == 5 else -y))
        middle += corner
        worst = max(worst, abs(corner - i[k]))
    half = 3.0 * u - 0.5 * middle
    worst = max(worst, abs(half * (1.0 - exponent * x) - i[1]), abs(half * (1.0 + exponent * x) - i[4]))
    return u, x, y, worst / abs(u)


@njit(cache=True)
def _basis(knots, value):
    """First of the four cubic basis functions that are not zero at a value, and their values."""
    count = knots.size - 4
    span = 3
    while span < count - 1 and value >= knots[span + 1]:
        span += 1
    left, right = np.empty(4), np.empty(4)
    out = np.zeros(4)
    out[0] = 1.0
    for degree in range(1, 4):
        left[degree] = value - knots[span + 1 - degree]
        right[degree] = knots[span + degree] - value
        saved = 0.0
        for k in range(degree):
            share = out[k] / (right[k + 1] + left[degree - k])
            out[k] = saved + right[k + 1] * share
            saved = left[degree - k] * share
        out[degree] = saved
    return span - 3, out


@njit(cache=True, fastmath=True)
def _sum(coefficients, first, bases, out):
    """out (k,): 64 coefficients of every weight times the three bases."""
    out[:] = 0.0
    for a in range(4):
        for b in range(4):
            for c in range(4):
                share = bases[0][a] * bases[1][b] * bases[2][c]
                row = coefficients[first[0] + a, first[1] + b, first[2] + c]
                for k in range(out.size):
                    out[k] += share * row[k]


@njit(cache=True)
def table_weights(table, currents, out):
    """Fill out (6 + k,): the currents (6,), then the weights of the k fields of the iron; whether that was possible.

    table: (exponent (1,), largest mismatch (1,), lower (3,), upper (3,), three arrays of knots, coefficients).
    Currents off the division, or beyond the table, fill NaN: NOT_A_DIVISION, BEYOND.
    """
    exponent, mismatch, lower, upper, u_knots, x_knots, y_knots, coefficients = table
    u, x, y, off = signals(currents, exponent[0])
    status = FOUND
    if not off <= mismatch[0]:
        status = NOT_A_DIVISION
    elif not (lower[0] <= u <= upper[0] and lower[1] <= x <= upper[1] and lower[2] <= y <= upper[2]):
        status = BEYOND
    if status != FOUND:
        out[:] = np.nan
        return status
    first_u, in_u = _basis(u_knots, u)
    first_x, in_x = _basis(x_knots, x)
    first_y, in_y = _basis(y_knots, y)
    out[:6] = currents
    _sum(coefficients, (first_u, first_x, first_y), (in_u, in_x, in_y), out[6:])
    return status


@njit(cache=True)
def tabulated_at_currents(data, currents, x, y, z):
    """B, G as of `fieldmap.kernels.lookup.at_currents`, with the weights of a table; data: (block, table)."""
    block, table = data
    weights = np.empty(currents.size + table[7].shape[3])
    table_weights(table, currents, weights)
    return at_currents(block, weights, x, y, z)
