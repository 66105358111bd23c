"""What takes energy from a moving body: drag and eddy currents, docs/theory/dynamics.md (9)..(17)."""

from numba import njit

from fieldmap.kernels.map.map_block import PLAIN_INLINED
from fieldmap.kernels.motion.layout import (
    CONDUCTIVITY,
    DIPOLE,
    DRAG,
    LOSSY,
    PLATE,
    POSITION,
    SPIN,
    VELOCITY,
)
from fieldmap.kernels.motion.plate import plate_force
from fieldmap.kernels.motion.rotation import to_body, to_map


@njit(**PLAIN_INLINED)
def _resist(linear, quadratic, speed):
    return -(linear + quadratic * abs(speed)) * speed


@njit(**PLAIN_INLINED)
def losses(body, state, r, velocity, spin):
    """Force (3) in the frame of the map, torque (3) in that of the body, at a velocity (3) and spin (3).

    r: turn_matrix of the state, whose place and turn alone are read.
    """
    force, torque = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    if body[LOSSY] != 0.0:
        u, v, w = to_body(r, velocity[0], velocity[1], velocity[2])
        fx, fy, fz = to_map(
            r,
            _resist(body[DRAG + 3], body[DRAG + 6], u),
            _resist(body[DRAG + 4], body[DRAG + 7], v),
            _resist(body[DRAG + 5], body[DRAG + 8], w),
        )
        force = (
            fx - body[DRAG] * velocity[0],
            fy - body[DRAG + 1] * velocity[1],
            fz - body[DRAG + 2] * velocity[2],
        )
        torque = (
            _resist(body[DRAG + 9], body[DRAG + 12], spin[0]),
            _resist(body[DRAG + 10], body[DRAG + 13], spin[1]),
            _resist(body[DRAG + 11], body[DRAG + 14], spin[2]),
        )
    if body[PLATE + CONDUCTIVITY] > 0.0:
        more, turning = _eddies(body, state, r, velocity, spin)
        force = (force[0] + more[0], force[1] + more[1], force[2] + more[2])
        torque = (torque[0] + turning[0], torque[1] + turning[1], torque[2] + turning[2])
    return force, torque


@njit(**PLAIN_INLINED)
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(**PLAIN_INLINED)
def _eddies(body, state, r, velocity, spin):
    m = to_map(r, body[DIPOLE], body[DIPOLE + 1], body[DIPOLE + 2])
    arm = to_map(r, body[DIPOLE + 3], body[DIPOLE + 4], body[DIPOLE + 5])
    w = to_map(r, spin[0], spin[1], spin[2])
    swing = _cross(w, arm)
    v = (velocity[0] + swing[0], velocity[1] + swing[1], velocity[2] + swing[2])
    x, y, z = state[POSITION] + arm[0], state[POSITION + 1] + arm[1], state[POSITION + 2] + arm[2]
    force, turning = plate_force(body, PLATE, x, y, z, m, v, _cross(w, m))
    a, b = _cross(m, turning), _cross(arm, force)
    return force, to_body(r, a[0] + b[0], a[1] + b[1], a[2] + b[2])


@njit(**PLAIN_INLINED)
def velocity_of(state):
    """Velocity (3) of the centre of mass."""
    return state[VELOCITY], state[VELOCITY + 1], state[VELOCITY + 2]


@njit(**PLAIN_INLINED)
def spin_of(state):
    """Angular velocity (3) in the frame of the body."""
    return state[SPIN], state[SPIN + 1], state[SPIN + 2]
