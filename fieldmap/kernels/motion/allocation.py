"""From the controller's outputs to the voltages of the coils' amplifiers, and from currents to the map's weights.

allocation: (kind, exponent, matrix, constant): the division of (u, x, y) among six coils (thesis (6-2), (6-3)), or
matrix @ outputs + constant.
"""

from numba import njit

from fieldmap.kernels.map.lift_and_directions import divide
from fieldmap.kernels.map.map_block import PLAIN

DIVISION, MATRIX = 0, 1


@njit(**PLAIN)
def allocate(allocation, outputs, voltages):
    """Fill voltages (n,)."""
    kind, exponent, matrix, constant = allocation
    if kind == DIVISION:
        found = divide(outputs[0], outputs[1], outputs[2], exponent)
        for k in range(6):
            voltages[k] = found[k]
        return
    for k in range(voltages.shape[0]):
        voltages[k] = constant[k]
        for j in range(outputs.shape[0]):
            voltages[k] += matrix[k, j] * outputs[j]
