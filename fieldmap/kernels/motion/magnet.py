"""Force and torque on a magnet that moves with a body: docs/theory/dynamics.md (7), (8).

body: its dipoles (layout), one for a point dipole, the points of a volume rule for a finite magnet. field: as in
kept_field, a point for each dipole.
"""

from numba import njit

from fieldmap.kernels.map.cached_field import kept_at
from fieldmap.kernels.map.map_block import INSIDE, PLAIN, PLAIN_INLINED
from fieldmap.kernels.motion.layout import FIRST, MAGNETS, POSITION
from fieldmap.kernels.motion.rotation import to_body, to_map, turn_matrix


@njit(**PLAIN_INLINED)
def magnet_wrench(field, body, state, load):
    """load (6,): force in the frame of the map, torque about the centre of mass in the frame of the body.

    Returns the status of the first point that is not inside the map, INSIDE if all are.
    """
    r = turn_matrix(state)
    fx, fy, fz, tx, ty, tz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for p in range(int(body[MAGNETS])):
        at = FIRST + 6 * p
        ax, ay, az = to_map(r, body[at], body[at + 1], body[at + 2])
        mx, my, mz = to_map(r, body[at + 3], body[at + 4], body[at + 5])
        x, y, z = state[POSITION] + ax, state[POSITION + 1] + ay, state[POSITION + 2] + az
        status, v = kept_at(field, p, x, y, z)
        if status != INSIDE:
            return status
        gx = v[3] * mx + v[6] * my + v[9] * mz
        gy = v[4] * mx + v[7] * my + v[10] * mz
        gz = v[5] * mx + v[8] * my + v[11] * mz
        fx, fy, fz = fx + gx, fy + gy, fz + gz
        tx += my * v[2] - mz * v[1] + ay * gz - az * gy
        ty += mz * v[0] - mx * v[2] + az * gx - ax * gz
        tz += mx * v[1] - my * v[0] + ax * gy - ay * gx
    load[0], load[1], load[2] = fx, fy, fz
    load[3], load[4], load[5] = to_body(r, tx, ty, tz)
    return INSIDE


@njit(**PLAIN)
def magnet_energy(field, body, state):
    """Interaction energy -m . B, J, NaN outside the map."""
    r = turn_matrix(state)
    energy = 0.0
    for p in range(int(body[MAGNETS])):
        at = FIRST + 6 * p
        ax, ay, az = to_map(r, body[at], body[at + 1], body[at + 2])
        mx, my, mz = to_map(r, body[at + 3], body[at + 4], body[at + 5])
        x, y, z = state[POSITION] + ax, state[POSITION + 1] + ay, state[POSITION + 2] + az
        _, v = kept_at(field, p, x, y, z)
        energy -= mx * v[0] + my * v[1] + mz * v[2]
    return energy
