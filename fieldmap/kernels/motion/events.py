"""What ends a run, or is remembered of it: numbers for the names in fieldmap.dynamics.events."""

from numba import njit

from fieldmap.kernels.map.map_block import CELLS, INVERSE, LOWER, NOT_FINITE, PLAIN
from fieldmap.kernels.motion.contact import ON_CEILING, ON_FLOOR, ON_WALL

NOTHING, FELL_OUT, LEFT_ABOVE, LEFT_SIDEWAYS, NOT_A_NUMBER = 0, 1, 2, 3, 4
HIT_FLOOR, HIT_POLE, HIT_TUBE, SATURATED, BEYOND_CURRENTS = 5, 6, 7, 8, 9
# Beside the sum of contacts: the currents were beyond the table of saturating iron.
BEYOND = 8


@njit(**PLAIN)
def way_out(block, status, z):
    """How a magnet at height z left the map."""
    if status == NOT_FINITE or z != z:
        return NOT_A_NUMBER
    if z < block[LOWER + 2]:
        return FELL_OUT
    if z > block[LOWER + 2] + block[CELLS + 2] / block[INVERSE + 2]:
        return LEFT_ABOVE
    return LEFT_SIDEWAYS


@njit(**PLAIN)
def hit(touched, ending):
    """The event of what is touched, if it is among those that end a run (a sum like `touched`)."""
    if touched & ending & ON_FLOOR:
        return HIT_FLOOR
    if touched & ending & ON_CEILING:
        return HIT_POLE
    if touched & ending & ON_WALL:
        return HIT_TUBE
    return NOTHING
