"""Force and torque on a magnet that moves with a body: docs/theory/dynamics.md (7), (8).

body: its dipoles (layout), one for a point dipole, the points of a volume rule for a finite magnet. block, weights: a
map's coefficients and the weights of its fields (the currents, where they superpose); `fixed` is 1 for a block that is
contracted at its currents already.
"""

from numba import njit

from fieldmap.kernels.lookup import contracted_at, superposed_at
from fieldmap.kernels.map_block import INSIDE, OUTER
from fieldmap.kernels.motion.layout import FIRST, MAGNETS, POSITION
from fieldmap.kernels.motion.rotation import to_body, to_map, turn_matrix


@njit(**OUTER)
def magnet_wrench(block, fixed, weights, body, state, load):
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
        if fixed:
            status, v = contracted_at(block, x, y, z)
        else:
            status, v = superposed_at(block, weights, x, y, z)
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


@njit(**OUTER)
def magnet_energy(block, fixed, weights, body, state):
    """Interaction energy -m . B, J, NaN outside the map."""
    r = turn_matrix(state)
    energy = 0.0
    for p in range(int(body[MAGNETS])):
        at = FIRST + 6 * p
        ax, ay, az = to_map(r, body[at], body[at + 1], body[at + 2])
        mx, my, mz = to_map(r, body[at + 3], body[at + 4], body[at + 5])
        x, y, z = state[POSITION] + ax, state[POSITION + 1] + ay, state[POSITION + 2] + az
        if fixed:
            _, v = contracted_at(block, x, y, z)
        else:
            _, v = superposed_at(block, weights, x, y, z)
        energy -= mx * v[0] + my * v[1] + mz * v[2]
    return energy
