"""Weights of a map's fields from a table over the signals of a current division: a tensor product of cubic splines.

The splines' coefficients (nu, nx, ny, k) belong to knots with four at each end, so that they are defined from the first
to the last node. A spline's basis follows from the recurrence of Cox and de Boor (C. de Boor, A Practical Guide to
Splines, Springer 1978, X (4)). Currents off the division, or beyond the table, go on from the nearest division in it
with the slopes of the weights by the six currents: docs/theory/current_dependence.md (7).
"""

from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.map.lift_and_directions import divide, signals
from fieldmap.kernels.map.map_block import PLAIN, PLAIN_INLINED

FOUND, NOT_A_DIVISION, BEYOND = 0, 1, 2


@inlined(**PLAIN_INLINED)
def _basis(knots, v):
    """First of the four cubic basis functions that are not zero at a value, and their values."""
    count = knots.size - 4
    span = 3
    while span < count - 1 and v >= knots[span + 1]:
        span += 1
    t1, t2, t3 = knots[span - 2], knots[span - 1], knots[span]
    t4, t5, t6 = knots[span + 1], knots[span + 2], knots[span + 3]
    share = 1.0 / (t4 - t3)
    p, q = (t4 - v) * share / (t4 - t2), (v - t3) * share / (t5 - t3)
    a, b, c = (t4 - v) * p / (t4 - t1), ((v - t2) * p + (t5 - v) * q) / (t5 - t2), (v - t3) * q / (t6 - t3)
    return span - 3, ((t4 - v) * a, (v - t1) * a + (t5 - v) * b, (v - t2) * b + (t6 - v) * c, (v - t3) * c)


@inlined(**PLAIN_INLINED)
def _sum(coefficients, knots, u, x, y, out):
    """out (k,): 64 coefficients of every weight times the three bases."""
    i, in_u = _basis(knots[0], u)
    j, in_x = _basis(knots[1], x)
    m, in_y = _basis(knots[2], y)
    out[:] = 0.0
    for a in range(4):
        for b in range(4):
            share = in_u[a] * in_x[b]
            p, q, r, s = share * in_y[0], share * in_y[1], share * in_y[2], share * in_y[3]
            rows = coefficients[i + a, j + b]
            for k in range(out.size):
                out[k] += p * rows[m, k] + q * rows[m + 1, k] + r * rows[m + 2, k] + s * rows[m + 3, k]


@inlined(**PLAIN_INLINED)
def _cell(nodes, value):
    """The cell of nodes that a value lies in, and the shares of its two ends."""
    i = 0
    while i < nodes.size - 2 and value >= nodes[i + 1]:
        i += 1
    share = (value - nodes[i]) / (nodes[i + 1] - nodes[i])
    return i, (1.0 - share, share)


@njit(**PLAIN)
def _add_slopes(nodes, slopes, u, x, y, off, out):
    """Add to out (k,) what currents off (6,) from a division change: slopes (nu, nx, ny, 6, k) at nodes, trilinear."""
    i, in_u = _cell(nodes[0], u)
    j, in_x = _cell(nodes[1], x)
    m, in_y = _cell(nodes[2], y)
    for a in range(2):
        for b in range(2):
            for c in range(2):
                share = in_u[a] * in_x[b] * in_y[c]
                s = slopes[i + a, j + b, m + c]
                p, q, r = share * off[0], share * off[1], share * off[2]
                d, e, f = share * off[3], share * off[4], share * off[5]
                for k in range(out.size):
                    out[k] += (
                        p * s[0, k] + q * s[1, k] + r * s[2, k] + d * s[3, k] + e * s[4, k] + f * s[5, k]
                    )


@njit(**PLAIN)
def table_weights(table, currents, out):
    """Fill out (6 + k,): the currents (6,), then the weights of the k fields of the iron; how good they are.

    table: (exponent, and limit of the currents, A (2,), largest mismatch (1,), lower (3,), upper (3,), knots of u, x,
    y, coefficients, nodes of u, x, y, slopes (nu, nx, ny, 6, k)). FOUND: a division of the table, by the splines alone.
    NOT_A_DIVISION: next to one. BEYOND: the nearest division is beyond the table, or a
    coil beyond the limit. NaN in the currents fills NaN: BEYOND.
    """
    division, mismatch, lower, upper, knots, coefficients, nodes, slopes = table
    n, iron, largest = division[0], out[6:], 0.0
    u, x, y, worst = signals(currents, n)
    a, b, c = (
        min(max(u, lower[0]), upper[0]),
        min(max(x, lower[1]), upper[1]),
        min(max(y, lower[2]), upper[2]),
    )
    status = FOUND
    if not (a == u and b == x and c == y):
        status = BEYOND
    elif worst > mismatch[0]:
        status = NOT_A_DIVISION
    for k in range(6):
        out[k] = currents[k]
        largest = max(largest, abs(currents[k]))
    if status == FOUND and largest > division[1]:
        status = BEYOND
    _sum(coefficients, knots, a, b, c, iron)
    if status != FOUND:
        i, near = currents, divide(a, b, c, n)
        off = (
            i[0] - near[0],
            i[1] - near[1],
            i[2] - near[2],
            i[3] - near[3],
            i[4] - near[4],
            i[5] - near[5],
        )
        _add_slopes(nodes, slopes, a, b, c, off, iron)
    return status
