"""A map's field along a path: what a point needs is superposed once and kept while neither cell nor weights change.

field: (block, weights, places, numbers): a map's coefficients, the weights of its sets, and for each of q points the
cell whose coefficients lie in its row of numbers (q, n), -1 for none. `forget` after any change of the weights.
"""

import numpy as np
from numba import njit

from fieldmap.kernels.map import cell_harmonics, global_harmonics
from fieldmap.kernels.map.lookup import NODE, of_cell, of_nodes, of_table
from fieldmap.kernels.map.map_block import (
    CELL_HARMONIC,
    DEGREE,
    GLOBAL_HARMONIC,
    INSIDE,
    KIND,
    PLAIN_INLINED,
    WHOLE,
    cell_number,
    locate,
    node_number,
    superpose,
)

NAN = np.nan


@njit(cache=True)
def keep_field(block, weights, count):
    """A field of `count` points, nothing kept yet."""
    size = 8 * NODE
    if block[KIND] == CELL_HARMONIC:
        size = cell_harmonics.SIZE
    elif block[KIND] == GLOBAL_HARMONIC:
        size = global_harmonics.ROWS * int(block[DEGREE]) ** 2 + (int(block[DEGREE]) + 1) ** 2
    places = np.empty(count, np.int64)
    places[:] = -1
    return block, weights, places, np.empty((count, size))


@njit(**PLAIN_INLINED)
def forget(field):
    """The weights have changed."""
    places = field[2]
    for p in range(places.shape[0]):
        places[p] = -1


@njit(**WHOLE)
def _superpose_all(block, weights, place, i, j, k, out):
    """out (n,): the coefficients of a cell, of the nodes at its corners, or the table of the only polynomial and
    room to work in."""
    if block[KIND] == CELL_HARMONIC:
        superpose(block, place, cell_harmonics.SIZE, weights, out)
    elif block[KIND] == GLOBAL_HARMONIC:
        degree = int(block[DEGREE])
        size, table = (degree + 1) ** 2, global_harmonics.ROWS * degree**2
        superpose(block, place, size, weights, out[table:])
        global_harmonics.expand(out[table:], degree, out[:table])
    else:
        for corner in range(8):
            node = node_number(block, i + corner // 4, j + corner // 2 % 2, k + corner % 2)
            superpose(block, node, NODE, weights, out[corner * NODE : (corner + 1) * NODE])


@njit(**PLAIN_INLINED)
def kept_at(field, p, x, y, z):
    """(status, the three of the field, the nine of its gradient), as `fieldmap.kernels.map.lookup.superposed_at`, for
    point number p at x, y, z."""
    block, weights, places, numbers = field
    status, i, j, k, tx, ty, tz = locate(block, x, y, z)
    if status != INSIDE:
        return status, (NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN)
    place = cell_number(block, i, j, k)
    kept = numbers[p]
    if places[p] != place:
        _superpose_all(block, weights, place, i, j, k, kept)
        places[p] = place
    if block[KIND] == CELL_HARMONIC:
        return status, of_cell(block, kept, tx, ty, tz)
    if block[KIND] == GLOBAL_HARMONIC:
        table = global_harmonics.ROWS * int(block[DEGREE]) ** 2
        return status, of_table(block, kept[:table], kept[table:], tx, ty, tz)
    return status, of_nodes(block, kept.reshape((2, 2, 2, 3, 8)), 0, 0, 0, 0, tx, ty, tz)
