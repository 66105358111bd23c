"""From currents to the weights of a map's fields.

scale: of the field, a calibration. SUPERPOSED: a field per coil, and one of weight 1 behind them if the block has one
more: linear iron, or saturating iron linearised about currents. TABLED: saturating iron by a table over the division
(u, x, y) of six currents: grid (3, 3) has first value, step and number of nodes of each signal; values (nodes, f) and
slopes (nodes, 6, f) of the iron's fields at the nodes, in C order. Between nodes and beyond the table:
docs/theory/dynamics.md (27), (28).
"""

import math

from numba import njit

from fieldmap.kernels.map_block import INLINED, OUTER
from fieldmap.kernels.motion.allocation import divide

SUPERPOSED, TABLED = 0, 1


@njit(**OUTER)
def undivide(currents, n):
    """u, x, y of six currents, as fieldmap.device.current_division.undivide_currents."""
    u = 0.0
    for k in range(6):
        u += currents[k] / 6.0
    if u == 0.0:
        return 0.0, 0.0, 0.0
    corners = -currents[0] - currents[2] + currents[3] + currents[5]
    x = (corners + n * (currents[4] - currents[1])) / (u * (4.0 + 2.0 * n * n))
    y = (-currents[0] + currents[2] - currents[3] + currents[5]) / (4.0 * u)
    return u, x, y


@njit(**INLINED)
def find_weights(kind, scale, grid, values, slopes, exponent, currents, near, room, weights):
    """Fill weights (f,); False for currents beyond the table, which then goes on with its slopes. near, room (6,):
    scratch."""
    n = currents.shape[0]
    for k in range(n):
        weights[k] = scale * currents[k]
    if kind == SUPERPOSED:
        if weights.shape[0] > n:
            weights[n] = scale
        return True
    return _from_table(scale, grid, values, slopes, exponent, currents, near, room, weights)


@njit(**OUTER)
def _from_table(scale, grid, values, slopes, exponent, currents, near, room, weights):
    n = currents.shape[0]
    u, x, y = undivide(currents, exponent)
    inside, i, j, k, tu, tx, ty = _cell(grid, u, x, y)
    divide(
        grid[0, 0] + (i + tu) * grid[0, 1],
        grid[1, 0] + (j + tx) * grid[1, 1],
        grid[2, 0] + (k + ty) * grid[2, 1],
        exponent,
        near,
    )
    for f in range(n, weights.shape[0]):
        weights[f] = 0.0
    for corner in range(8):
        a, b, c = corner >> 2, (corner >> 1) & 1, corner & 1
        share = (tu if a else 1.0 - tu) * (tx if b else 1.0 - tx) * (ty if c else 1.0 - ty)
        node = ((i + a) * int(grid[1, 2]) + j + b) * int(grid[2, 2]) + k + c
        divide(
            grid[0, 0] + (i + a) * grid[0, 1],
            grid[1, 0] + (j + b) * grid[1, 1],
            grid[2, 0] + (k + c) * grid[2, 1],
            exponent,
            room,
        )
        # Half of the slope along the division, all of it beside.
        for m in range(6):
            room[m] = scale * share * (0.5 * (near[m] - room[m]) + currents[m] - near[m])
        row = values[node]
        for f in range(row.shape[0]):
            weights[n + f] += scale * share * row[f]
        for m in range(6):
            slope, by = slopes[node, m], room[m]
            for f in range(row.shape[0]):
                weights[n + f] += by * slope[f]
    return inside


@njit(**OUTER)
def _cell(grid, u, x, y):
    """Whether a division lies on the grid; its cell and place in the cell, those of the nearest if it does not."""
    a, b, c = (u - grid[0, 0]) / grid[0, 1], (x - grid[1, 0]) / grid[1, 1], (y - grid[2, 0]) / grid[2, 1]
    p, q, r = grid[0, 2] - 1.0, grid[1, 2] - 1.0, grid[2, 2] - 1.0
    edge = 1e-9
    inside = -edge <= a <= p + edge and -edge <= b <= q + edge and -edge <= c <= r + edge
    a, b, c = min(max(a, 0.0), p), min(max(b, 0.0), q), min(max(c, 0.0), r)
    i = min(max(math.floor(a), 0), int(p) - 1)
    j = min(max(math.floor(b), 0), int(q) - 1)
    k = min(max(math.floor(c), 0), int(r) - 1)
    return inside, i, j, k, a - i, b - j, c - k
