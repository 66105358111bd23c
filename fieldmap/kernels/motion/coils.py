"""Currents of coils behind amplifiers: L di/dt + R i = V, V what the amplifier asks for within its supply.

coils (n, 4), for one length of step h: decay exp(-R h / L) of the winding; decay exp(-h / tau) of the amplifier's own
answer (0: it follows at once as far as its supply allows); final currents V_upper / R and V_lower / R. The current
goes where the amplifier steers it, unless the supply's limits allow less: exact for any h. docs/theory/dynamics.md
(25), (26).
"""

from numba import njit

from fieldmap.kernels.map.map_block import PLAIN_INLINED

WINDING, AMPLIFIER, HIGHEST, LOWEST = 0, 1, 2, 3


@njit(**PLAIN_INLINED)
def advance_currents(coils, commands, currents):
    """Advance currents (n,) by one step towards commands (n,); whether a supply limit held one back, and whether any
    changed."""
    held, moved = False, False
    for k in range(currents.shape[0]):
        wanted = commands[k] + (currents[k] - commands[k]) * coils[k, AMPLIFIER]
        high = coils[k, HIGHEST] + (currents[k] - coils[k, HIGHEST]) * coils[k, WINDING]
        low = coils[k, LOWEST] + (currents[k] - coils[k, LOWEST]) * coils[k, WINDING]
        held |= wanted > high or wanted < low
        new = min(max(wanted, low), high)
        moved |= new != currents[k]
        currents[k] = new
    return held, moved
