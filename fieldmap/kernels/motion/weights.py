"""From currents to the weights of a map's fields.

scale: of the field, a calibration. SUPERPOSED: a field per coil, and one of weight 1 behind them if the block has one
more: linear iron, or saturating iron linearised about currents. TABLED: saturating iron by a table over the division of
six currents, as fieldmap.kernels.map.current_table takes it.
"""

from numba import njit

from fieldmap.kernels.map.current_table import BEYOND, table_weights
from fieldmap.kernels.map.map_block import PLAIN

SUPERPOSED, TABLED = 0, 1


@njit(**PLAIN)
def find_weights(kind, scale, table, currents, weights):
    """Fill weights (f,); False for currents beyond the table, which then goes on with its slopes."""
    if kind == TABLED:
        status = table_weights(table, currents, weights)
        for f in range(weights.shape[0]):
            weights[f] *= scale
        return status != BEYOND
    n = currents.shape[0]
    for k in range(n):
        weights[k] = scale * currents[k]
    if weights.shape[0] > n:
        weights[n] = scale
    return True
