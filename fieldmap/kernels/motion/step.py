"""One step of the motion: Strang's splitting into kick and free flight, and its composition of fourth order.

Kick: velocities change at rest in place and turn, under magnet, walls, weight and losses. Flight: the free motion of
the rigid body (rotation). Kick half, flight, kick half is of second order and symmetric in time; without losses it is
symplectic. Three such steps of x1, x0, x1 times the length make one of fourth order (Yoshida, Phys. Lett. A 150, 262,
1990). docs/theory/dynamics.md (21)..(24).

body: the flat array of layout. field: as for magnet_wrench. load (6,): force and torque at the present
place, kept from step to step.
"""

import numpy as np

from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.copy_vector import copy_vector
from fieldmap.kernels.map.map_block import INSIDE, PLAIN, PLAIN_INLINED, WHOLE
from fieldmap.kernels.motion.contact import add_contact
from fieldmap.kernels.motion.layout import (
    ANGULAR_VELOCITY,
    CONDUCTIVITY,
    FORCE,
    GRAVITY,
    INERTIA,
    LOSSY,
    MASS,
    PLATE,
    POSITION,
    SKIN,
    TORQUE,
    VELOCITY,
)
from fieldmap.kernels.motion.losses import angular_velocity_of, losses, velocity_of
from fieldmap.kernels.motion.magnet import magnet_wrench
from fieldmap.kernels.motion.rotation import free_turn, normalise, to_body, turn_matrix

X1 = 1.3512071919596578  # 1 / (2 - 2^(1/3))
X0 = 1.0 - 2.0 * X1


@njit(**PLAIN, forceinline=True)
def find_load(field, body, state, load):
    """Fill load (6,) at the state; the status of the map, and what is touched."""
    status = magnet_wrench(field, body, state, load)
    touched = 0
    if status == INSIDE:
        touched = add_contact(body, state, load) if body[SKIN] > 0.0 else 0
        for k in range(3):
            load[k] += body[MASS] * body[GRAVITY + k] + body[FORCE + k]
        if body[TORQUE] != 0.0 or body[TORQUE + 1] != 0.0 or body[TORQUE + 2] != 0.0:
            t = to_body(turn_matrix(state), body[TORQUE], body[TORQUE + 1], body[TORQUE + 2])
            load[3], load[4], load[5] = load[3] + t[0], load[4] + t[1], load[5] + t[2]
    return status, touched


@inlined(**PLAIN_INLINED)
def _changes(body, state, r, v, s, load):
    """Rates of velocity (3) and angular velocity (3) at v and s, without the gyroscopic part."""
    force, torque = losses(body, state, r, v, s)
    m = body[MASS]
    return (
        ((load[0] + force[0]) / m, (load[1] + force[1]) / m, (load[2] + force[2]) / m),
        (
            (load[3] + torque[0]) / body[INERTIA],
            (load[4] + torque[1]) / body[INERTIA + 1],
            (load[5] + torque[2]) / body[INERTIA + 2],
        ),
    )


@inlined(**PLAIN_INLINED)
def _moved(v, a, h):
    return v[0] + h * a[0], v[1] + h * a[1], v[2] + h * a[2]


@njit(**PLAIN, forceinline=True)
def kick(body, state, load, h, order):
    """Velocities after a time h at rest in place and turn; with losses by a Runge-Kutta rule of `order`."""
    if body[LOSSY] == 0.0 and body[PLATE + CONDUCTIVITY] == 0.0:
        for k in range(3):
            state[VELOCITY + k] += h * load[k] / body[MASS]
            state[ANGULAR_VELOCITY + k] += h * load[3 + k] / body[INERTIA + k]
        return
    r = turn_matrix(state)
    v, s = velocity_of(state), angular_velocity_of(state)
    a, b = _changes(body, state, r, v, s, load)
    a2, b2 = _changes(body, state, r, _moved(v, a, 0.5 * h), _moved(s, b, 0.5 * h), load)
    if order == 4:
        a3, b3 = _changes(body, state, r, _moved(v, a2, 0.5 * h), _moved(s, b2, 0.5 * h), load)
        a4, b4 = _changes(body, state, r, _moved(v, a3, h), _moved(s, b3, h), load)
        for k in range(3):
            state[VELOCITY + k] += h / 6.0 * (a[k] + 2.0 * a2[k] + 2.0 * a3[k] + a4[k])
            state[ANGULAR_VELOCITY + k] += h / 6.0 * (b[k] + 2.0 * b2[k] + 2.0 * b3[k] + b4[k])
        return
    for k in range(3):
        state[VELOCITY + k] += h * a2[k]
        state[ANGULAR_VELOCITY + k] += h * b2[k]


@inlined(**PLAIN_INLINED)
def fly(body, state, h):
    """Free motion for a time h."""
    for k in range(3):
        state[POSITION + k] += h * state[VELOCITY + k]
    free_turn(state, body, h)
    normalise(state)


@inlined(**PLAIN_INLINED)
def step_of_two(field, body, state, load, h):
    """One step of second order; `load` goes in as that at the beginning, comes out as that at the end.

    field: with the weights at the end of the step. Returns status and what is touched, at the end.
    """
    kick(body, state, load, 0.5 * h, 2)
    fly(body, state, h)
    status, touched = find_load(field, body, state, load)
    if status == INSIDE:
        kick(body, state, load, 0.5 * h, 2)
    return status, touched


@njit(**PLAIN)
def step_of_four(field, body, state, load, h):
    """One step of fourth order, at weights that do not change; else as `step_of_two`."""
    status, touched = INSIDE, 0
    for part in range(3):
        length = (X0 if part == 1 else X1) * h
        kick(body, state, load, 0.5 * length, 4)
        fly(body, state, length)
        status, touched = find_load(field, body, state, load)
        if status != INSIDE:
            return status, touched
        kick(body, state, load, 0.5 * length, 4)
    return status, touched


@njit(**PLAIN)
def rates(field, body, state, load, out):
    """Time derivative (13,) of a state: the right-hand side for an integrator of another kind. Status of the map."""
    status, _ = find_load(field, body, state, load)
    r = turn_matrix(state)
    v, s = velocity_of(state), angular_velocity_of(state)
    a, b = _changes(body, state, r, v, s, load)
    w, x, y, z = state[6], state[7], state[8], state[9]
    i1, i2, i3 = body[INERTIA], body[INERTIA + 1], body[INERTIA + 2]
    for k in range(3):
        out[k], out[3 + k] = v[k], a[k]
    out[6] = -0.5 * (x * s[0] + y * s[1] + z * s[2])
    out[7] = 0.5 * (w * s[0] + y * s[2] - z * s[1])
    out[8] = 0.5 * (w * s[1] + z * s[0] - x * s[2])
    out[9] = 0.5 * (w * s[2] + x * s[1] - y * s[0])
    out[10] = b[0] + (i2 - i3) / i1 * s[1] * s[2]
    out[11] = b[1] + (i3 - i1) / i2 * s[2] * s[0]
    out[12] = b[2] + (i1 - i2) / i3 * s[0] * s[1]
    return status


@njit(**WHOLE)
def fixed_currents(field, body, state, h, every, order, states):
    """A motion at weights that do not change: states (rows, 13) after every `every` steps, the first after none.

    Returns rows filled, the status of the map and what was touched by then. `state` is advanced.
    """
    load = np.empty(6)
    status, touched = find_load(field, body, state, load)
    copy_vector(state, states[0])
    for row in range(1, states.shape[0]):
        for _ in range(every):
            if order == 4:
                status, now = step_of_four(field, body, state, load, h)
            else:
                status, now = step_of_two(field, body, state, load, h)
            touched |= now
            if status != INSIDE:
                return row, status, touched
        copy_vector(state, states[row])
    return states.shape[0], status, touched
