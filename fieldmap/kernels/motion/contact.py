"""A body that touches a floor, a ceiling or the wall of an upright tube: penalties at points of its surface.

contact (CONTACT,): stiffness (N/m) and damping (N s/m) of the penalty, friction coefficient, slip speed below which
friction is viscous (m/s), height of floor and ceiling (m; infinite: none), radius of the tube (m; infinite: none) and
its axis (x, y). skin (k, 3): points of the surface in the frame of the body. docs/theory/dynamics.md (19), (20).
"""

import math

from numba import njit

from fieldmap.kernels.map_block import OUTER
from fieldmap.kernels.motion.layout import POSITION, SPIN, VELOCITY
from fieldmap.kernels.motion.losses import _cross
from fieldmap.kernels.motion.rotation import to_body, to_map, turn_matrix

STIFFNESS, DAMPING, FRICTION, SLIP, FLOOR, CEILING, RADIUS, AXIS = 0, 1, 2, 3, 4, 5, 6, 7
CONTACT = 9
FREE, ON_FLOOR, ON_CEILING, ON_WALL = 0, 1, 2, 4


@njit(cache=True)
def _push(contact, depth, n, v):
    """Force (3) of a wall with inward normal n on a point that is `depth` inside it and moves at v."""
    inward = n[0] * v[0] + n[1] * v[1] + n[2] * v[2]
    normal = max(contact[STIFFNESS] * depth - contact[DAMPING] * inward, 0.0)
    tx, ty, tz = v[0] - inward * n[0], v[1] - inward * n[1], v[2] - inward * n[2]
    slip = math.sqrt(tx * tx + ty * ty + tz * tz)
    rub = contact[FRICTION] * normal / max(slip, contact[SLIP])
    return normal * n[0] - rub * tx, normal * n[1] - rub * ty, normal * n[2] - rub * tz


@njit(**OUTER)
def add_contact(contact, skin, state, load):
    """Add the walls' force and torque to load (6,); what is touched, as the sum of ON_FLOOR, ON_CEILING, ON_WALL."""
    r = turn_matrix(state)
    w = to_map(r, state[SPIN], state[SPIN + 1], state[SPIN + 2])
    touched = FREE
    for p in range(skin.shape[0]):
        arm = to_map(r, skin[p, 0], skin[p, 1], skin[p, 2])
        x, y, z = state[POSITION] + arm[0], state[POSITION + 1] + arm[1], state[POSITION + 2] + arm[2]
        dx, dy = x - contact[AXIS], y - contact[AXIS + 1]
        distance = math.sqrt(dx * dx + dy * dy)
        floor, ceiling, wall = z < contact[FLOOR], z > contact[CEILING], distance > contact[RADIUS]
        if not (floor or ceiling or wall):
            continue
        swing = _cross(w, arm)
        v = (
            state[VELOCITY] + swing[0],
            state[VELOCITY + 1] + swing[1],
            state[VELOCITY + 2] + swing[2],
        )
        if floor:
            touched |= ON_FLOOR
            _add(load, r, arm, _push(contact, contact[FLOOR] - z, (0.0, 0.0, 1.0), v))
        if ceiling:
            touched |= ON_CEILING
            _add(load, r, arm, _push(contact, z - contact[CEILING], (0.0, 0.0, -1.0), v))
        if wall:
            touched |= ON_WALL
            normal = (-dx / distance, -dy / distance, 0.0)
            _add(load, r, arm, _push(contact, distance - contact[RADIUS], normal, v))
    return touched


@njit(cache=True)
def _add(load, r, arm, force):
    t = _cross(arm, force)
    turned = to_body(r, t[0], t[1], t[2])
    for k in range(3):
        load[k] += force[k]
        load[3 + k] += turned[k]
