"""Six currents and the three signals of `fieldmap.currents.LiftAndDirections`."""

import math

from fieldmap.kernels.compilation import njit
from fieldmap.kernels.map.map_block import PLAIN_INLINED


@njit(**PLAIN_INLINED, forceinline=True)
def divide(u, x, y, n):
    """The six currents of a lift u and directions x, y; n: how much more the coils on the x axis follow x."""
    left, right, below, above = 1.0 - x, 1.0 + x, 1.0 - y, 1.0 + y
    a, c, d, f = u * left * below, u * left * above, u * right * below, u * right * above
    half = 3.0 * u - 0.5 * (a + c + d + f)
    return a, half * (1.0 - n * x), c, d, half * (1.0 + n * x), f


@njit(**PLAIN_INLINED, forceinline=True)
def signals(i, n):
    """(u, x, y, mismatch): the signals whose currents are nearest to i (6,), and by what share of u these are off.
    Currents without a mean have none: (0, 0, 0, infinity)."""
    u = (i[0] + i[1] + i[2] + i[3] + i[4] + i[5]) / 6.0
    if u == 0.0:
        return 0.0, 0.0, 0.0, math.inf
    x = (i[3] + i[5] - i[0] - i[2] + n * (i[4] - i[1])) / ((4.0 + 2.0 * n * n) * u)
    y = (i[2] + i[5] - i[0] - i[3]) / (4.0 * u)
    a, b, c, d, e, f = divide(u, x, y, n)
    worst = max(abs(a - i[0]), abs(b - i[1]), abs(c - i[2]), abs(d - i[3]), abs(e - i[4]), abs(f - i[5]))
    return u, x, y, worst / abs(u)
