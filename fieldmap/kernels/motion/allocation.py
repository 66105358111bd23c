"""From the controller's outputs to the voltages of the coils' amplifiers, and from currents to the map's weights.

allocation: (kind, exponent, matrix, constant): the division of (u, x, y) among six coils (thesis (6-2), (6-3)), or
matrix @ outputs + constant.
"""

from numba import njit

from fieldmap.kernels.map_block import OUTER

DIVISION, MATRIX = 0, 1


@njit(**OUTER)
def divide(u, x, y, n, out):
    """out (6,): fieldmap.device.current_division.divide_currents, of one set of signals."""
    left, right, below, above = 1.0 - x, 1.0 + x, 1.0 - y, 1.0 + y
    out[0], out[2] = u * left * below, u * left * above
    out[3], out[5] = u * right * below, u * right * above
    rest = 3.0 * u - 0.5 * (out[0] + out[2] + out[3] + out[5])
    out[1], out[4] = rest * (1.0 - n * x), rest * (1.0 + n * x)


@njit(**OUTER)
def allocate(allocation, outputs, voltages):
    """Fill voltages (n,)."""
    kind, exponent, matrix, constant = allocation
    if kind == DIVISION:
        divide(outputs[0], outputs[1], outputs[2], exponent, voltages)
        return
    for k in range(voltages.shape[0]):
        voltages[k] = constant[k]
        for j in range(outputs.shape[0]):
            voltages[k] += matrix[k, j] * outputs[j]
