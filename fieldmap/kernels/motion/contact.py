"""A body that touches a floor, a ceiling or the wall of an upright tube: penalties at points of its surface.

Walls and points: see layout. docs/theory/dynamics.md (19), (20).
"""

import math

from fieldmap.kernels.compilation import njit
from fieldmap.kernels.map.map_block import PLAIN
from fieldmap.kernels.motion.layout import (
    ANGULAR_VELOCITY,
    AXIS,
    CEILING,
    DAMPING,
    FIRST,
    FLOOR,
    FRICTION,
    MAGNETS,
    POSITION,
    RADIUS,
    SKIN,
    SLIP,
    STIFFNESS,
    VELOCITY,
)
from fieldmap.kernels.motion.rotation import cross, to_body, to_map, turn_matrix

FREE, ON_FLOOR, ON_CEILING, ON_WALL = 0, 1, 2, 4


@njit
def _push(body, depth, n, v):
    """Force (3) of a wall with inward normal n on a point that is `depth` inside it and moves at v."""
    inward = n[0] * v[0] + n[1] * v[1] + n[2] * v[2]
    normal = max(body[STIFFNESS] * depth - body[DAMPING] * inward, 0.0)
    tx, ty, tz = v[0] - inward * n[0], v[1] - inward * n[1], v[2] - inward * n[2]
    slip = math.sqrt(tx * tx + ty * ty + tz * tz)
    rub = body[FRICTION] * normal / max(slip, body[SLIP])
    return normal * n[0] - rub * tx, normal * n[1] - rub * ty, normal * n[2] - rub * tz


@njit(**PLAIN)
def add_contact(body, state, load):
    """Add the walls' force and torque to load (6,); what is touched, as the sum of ON_FLOOR, ON_CEILING, ON_WALL."""
    r = turn_matrix(state)
    w = to_map(r, state[ANGULAR_VELOCITY], state[ANGULAR_VELOCITY + 1], state[ANGULAR_VELOCITY + 2])
    touched = FREE
    first = FIRST + 6 * int(body[MAGNETS])
    for p in range(int(body[SKIN])):
        at = first + 3 * p
        arm = to_map(r, body[at], body[at + 1], body[at + 2])
        x, y, z = state[POSITION] + arm[0], state[POSITION + 1] + arm[1], state[POSITION + 2] + arm[2]
        dx, dy = x - body[AXIS], y - body[AXIS + 1]
        distance = math.sqrt(dx * dx + dy * dy)
        floor, ceiling, wall = z < body[FLOOR], z > body[CEILING], distance > body[RADIUS]
        if not (floor or ceiling or wall):
            continue
        swing = cross(w, arm)
        v = (
            state[VELOCITY] + swing[0],
            state[VELOCITY + 1] + swing[1],
            state[VELOCITY + 2] + swing[2],
        )
        if floor:
            touched |= ON_FLOOR
            _add(load, r, arm, _push(body, body[FLOOR] - z, (0.0, 0.0, 1.0), v))
        if ceiling:
            touched |= ON_CEILING
            _add(load, r, arm, _push(body, z - body[CEILING], (0.0, 0.0, -1.0), v))
        if wall:
            touched |= ON_WALL
            normal = (-dx / distance, -dy / distance, 0.0)
            _add(load, r, arm, _push(body, distance - body[RADIUS], normal, v))
    return touched


@njit
def _add(load, r, arm, force):
    t = cross(arm, force)
    turned = to_body(r, t[0], t[1], t[2])
    for k in range(3):
        load[k] += force[k]
        load[3 + k] += turned[k]
