"""One step of the motion: Strang's splitting into kick and free flight, and its composition of fourth order.

Kick: velocities change at rest in place and turn, under magnet, walls, weight and losses. Flight: the free motion of
the rigid body (rotation). Kick half, flight, kick half is of second order and symmetric in time; without losses it is
symplectic. Three such steps of x1, x0, x1 times the length make one of fourth order (Yoshida, Phys. Lett. A 150, 262,
1990). docs/theory/dynamics.md (21)..(24).

moving: (body, points, moments, drag, lossy, plate, dipole, contact, skin), as the files beside this one describe them.
field: (block, fixed). load (6,): force and torque at the present place, kept from step to step.
"""

import numpy as np
from numba import njit

from fieldmap.kernels.map_block import INLINED, INSIDE, OUTER
from fieldmap.kernels.motion.contact import add_contact
from fieldmap.kernels.motion.layout import (
    FORCE,
    GRAVITY,
    INERTIA,
    MASS,
    POSITION,
    SPIN,
    TORQUE,
    VELOCITY,
)
from fieldmap.kernels.motion.losses import losses, spin_of, velocity_of
from fieldmap.kernels.motion.magnet import magnet_wrench
from fieldmap.kernels.motion.plate import CONDUCTIVITY
from fieldmap.kernels.motion.rotation import free_turn, normalise, to_body, turn_matrix

X1 = 1.3512071919596578  # 1 / (2 - 2^(1/3))
X0 = 1.0 - 2.0 * X1


@njit(**OUTER)
def find_load(field, weights, moving, state, load):
    """Fill load (6,) at the state; the status of the map, and what is touched."""
    body, points, moments, _, _, _, _, contact, skin = moving
    status = magnet_wrench(field[0], field[1], weights, points, moments, state, load)
    touched = 0
    if status == INSIDE:
        touched = add_contact(contact, skin, state, load) if skin.shape[0] else 0
        for k in range(3):
            load[k] += body[MASS] * body[GRAVITY + k] + body[FORCE + k]
        if body[TORQUE] != 0.0 or body[TORQUE + 1] != 0.0 or body[TORQUE + 2] != 0.0:
            t = to_body(turn_matrix(state), body[TORQUE], body[TORQUE + 1], body[TORQUE + 2])
            load[3], load[4], load[5] = load[3] + t[0], load[4] + t[1], load[5] + t[2]
    return status, touched


@njit(**INLINED)
def _changes(state, r, v, s, moving, load):
    """Rates of velocity (3) and spin (3) at velocity v and spin s, without what the spin does by itself."""
    body, _, _, drag, lossy, plate, dipole, _, _ = moving
    force, torque = losses(state, r, v, s, drag, lossy, plate, dipole)
    m = body[MASS]
    return (
        ((load[0] + force[0]) / m, (load[1] + force[1]) / m, (load[2] + force[2]) / m),
        (
            (load[3] + torque[0]) / body[INERTIA],
            (load[4] + torque[1]) / body[INERTIA + 1],
            (load[5] + torque[2]) / body[INERTIA + 2],
        ),
    )


@njit(**INLINED)
def _moved(v, a, h):
    return v[0] + h * a[0], v[1] + h * a[1], v[2] + h * a[2]


@njit(**OUTER)
def kick(moving, state, load, h, order):
    """Velocity and spin after a time h at rest in place and turn; with losses by a Runge-Kutta rule of `order`."""
    body, _, _, _, lossy, plate, _, _, _ = moving
    if lossy == 0 and plate[CONDUCTIVITY] == 0.0:
        for k in range(3):
            state[VELOCITY + k] += h * load[k] / body[MASS]
            state[SPIN + k] += h * load[3 + k] / body[INERTIA + k]
        return
    r = turn_matrix(state)
    v, s = velocity_of(state), spin_of(state)
    a, b = _changes(state, r, v, s, moving, load)
    a2, b2 = _changes(state, r, _moved(v, a, 0.5 * h), _moved(s, b, 0.5 * h), moving, load)
    if order == 4:
        a3, b3 = _changes(state, r, _moved(v, a2, 0.5 * h), _moved(s, b2, 0.5 * h), moving, load)
        a4, b4 = _changes(state, r, _moved(v, a3, h), _moved(s, b3, h), moving, load)
        for k in range(3):
            state[VELOCITY + k] += h / 6.0 * (a[k] + 2.0 * a2[k] + 2.0 * a3[k] + a4[k])
            state[SPIN + k] += h / 6.0 * (b[k] + 2.0 * b2[k] + 2.0 * b3[k] + b4[k])
        return
    for k in range(3):
        state[VELOCITY + k] += h * a2[k]
        state[SPIN + k] += h * b2[k]


@njit(**INLINED)
def fly(moving, state, h):
    """Free motion for a time h."""
    for k in range(3):
        state[POSITION + k] += h * state[VELOCITY + k]
    free_turn(state, moving[0], h)
    normalise(state)


@njit(**OUTER)
def step_of_two(field, weights, moving, state, load, h):
    """One step of second order; `load` goes in as that at the beginning, comes out as that at the end.

    weights: those at the end of the step. Returns status and what is touched, at the end.
    """
    kick(moving, state, load, 0.5 * h, 2)
    fly(moving, state, h)
    status, touched = find_load(field, weights, moving, state, load)
    if status == INSIDE:
        kick(moving, state, load, 0.5 * h, 2)
    return status, touched


@njit(**OUTER)
def step_of_four(field, weights, moving, state, load, h):
    """One step of fourth order; weights (3, n): those at the ends of its three parts. Else as `step_of_two`."""
    status, touched = INSIDE, 0
    for part in range(3):
        length = (X0 if part == 1 else X1) * h
        kick(moving, state, load, 0.5 * length, 4)
        fly(moving, state, length)
        status, touched = find_load(field, weights[part], moving, state, load)
        if status != INSIDE:
            return status, touched
        kick(moving, state, load, 0.5 * length, 4)
    return status, touched


@njit(**OUTER)
def rates(field, weights, moving, state, load, out):
    """Time derivative (13,) of a state: the right-hand side for an integrator of another kind. Status of the map."""
    status, _ = find_load(field, weights, moving, state, load)
    r = turn_matrix(state)
    v, s = velocity_of(state), spin_of(state)
    a, b = _changes(state, r, v, s, moving, load)
    body = moving[0]
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


@njit(**OUTER)
def fixed_currents(field, weights, moving, state, h, every, order, states):
    """A motion at weights that do not change: states (rows, 13) after every `every` steps, the first after none.

    Returns rows filled, the status of the map and what was touched by then. `state` is advanced.
    """
    load = np.empty(6)
    status, touched = find_load(field, weights, moving, state, load)
    three = np.empty((3, weights.shape[0]))
    three[:] = weights
    states[0] = state
    for row in range(1, states.shape[0]):
        for _ in range(every):
            if order == 4:
                status, now = step_of_four(field, three, moving, state, load, h)
            else:
                status, now = step_of_two(field, weights, moving, state, load, h)
            touched |= now
            if status != INSIDE:
                return row, status, touched
        states[row] = state
    return states.shape[0], status, touched
