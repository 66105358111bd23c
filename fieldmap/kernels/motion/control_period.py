"""One control period of a machine at given commands: for controllers that are Python, one call a sample."""

from fieldmap.kernels.compilation import njit
from fieldmap.kernels.map.cached_field import forget
from fieldmap.kernels.map.map_block import INSIDE, WHOLE
from fieldmap.kernels.motion.currents import advance_currents, find_weights
from fieldmap.kernels.motion.step import find_load, step_of_two


@njit(**WHOLE)
def advance_period(
    h, steps, at_once, kind, scale, table, iron, coils, body, field, commands, state, currents, load
):
    """Advance state (13,), currents (n,) and load (6,) by `steps` steps of h; the status of the map.

    As the mechanics of `fieldmap.kernels.motion.closed_loop`. kind, scale, table, iron: how the field's weights follow
    the currents (`fieldmap.kernels.motion.currents.Superposition`). at_once: currents take their commands (n,) at the
    beginning. load: that of the state as it comes in.
    """
    for step in range(steps):
        # Where currents jump, the load at the beginning is that of the new ones.
        jumps = at_once and step == 0
        _, moved = advance_currents(coils, commands, currents)
        if moved:
            find_weights(kind, scale, table, iron, currents, field[1])
            forget(field)
            if jumps:
                status, _ = find_load(field, body, state, load)
                if status != INSIDE:
                    return status
        status, _ = step_of_two(field, body, state, load, h)
        if status != INSIDE:
            return status
    return INSIDE
