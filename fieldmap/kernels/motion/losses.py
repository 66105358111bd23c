"""What takes energy from a moving body: drag, and eddy currents in a conducting plate.

docs/theory/dynamics.md (9)..(18). The plate has any thickness and no end to the sides; motion is slow. Its numbers lie
at PLATE of a body's array.
"""

import math

from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.constants import MU0
from fieldmap.kernels.map.map_block import PLAIN_INLINED
from fieldmap.kernels.motion.layout import (
    ANGULAR_VELOCITY,
    CONDUCTIVITY,
    DIPOLE,
    DRAG,
    FACE,
    LOSSY,
    NORMAL,
    PLATE,
    POSITION,
    THICKNESS,
    VELOCITY,
)
from fieldmap.kernels.motion.rotation import cross, to_body, to_map


@inlined(**PLAIN_INLINED)
def layer_integrals(height, thickness):
    """Integrals over the depth of the plate of 3 / (8 s^4), 1 / (4 s^3), 1 / (4 s^2): (14), (15)."""
    near, far = 1.0 / height, 1.0 / (height + thickness)
    return (
        0.125 * (near * near * near - far * far * far),
        0.125 * (near * near - far * far),
        0.25 * (near - far),
    )


@njit(**PLAIN_INLINED, forceinline=True)
def plate_force(numbers, at, x, y, z, m, v, rate):
    """Force (3) on a dipole m (3) at a place, moving at v (3), and g (3), so that the torque is m x g: (16), (17).

    numbers, at: the plate's begin at numbers[at]. rate (3): dm/dt. All in the frame of the map. On or behind the face
    the formula has no meaning and gives NaN.
    """
    nx, ny, nz = numbers[at + NORMAL], numbers[at + NORMAL + 1], numbers[at + NORMAL + 2]
    face = at + FACE
    height = nx * (x - numbers[face]) + ny * (y - numbers[face + 1]) + nz * (z - numbers[face + 2])
    if not height > 0.0:
        return (math.nan, math.nan, math.nan), (math.nan, math.nan, math.nan)
    a4, a3, a2 = layer_integrals(height, numbers[at + THICKNESS])
    k = MU0 * MU0 * numbers[at + CONDUCTIVITY] / (8.0 * math.pi)
    a4, a3, a2 = k * a4, k * a3, k * a2
    # Parts along the normal, then parts in the plane.
    mn = m[0] * nx + m[1] * ny + m[2] * nz
    vn = v[0] * nx + v[1] * ny + v[2] * nz
    rn = rate[0] * nx + rate[1] * ny + rate[2] * nz
    mx, my, mz = m[0] - mn * nx, m[1] - mn * ny, m[2] - mn * nz
    vx, vy, vz = v[0] - vn * nx, v[1] - vn * ny, v[2] - vn * nz
    rx, ry, rz = rate[0] - rn * nx, rate[1] - rn * ny, rate[2] - rn * nz
    m2 = mx * mx + my * my + mz * mz
    mv = mx * vx + my * vy + mz * vz
    mr = mx * rx + my * ry + mz * rz
    # (16): force.
    plane = -a4 * (0.5 * mn * mn + 0.125 * m2)
    along = -0.25 * a4 * mv - 0.5 * a3 * rn
    turned = 0.5 * a3 * mn
    normal = -a4 * (mn * mn + 0.5 * m2) * vn + a3 * (0.5 * mr + mn * rn)
    force = (
        plane * vx + along * mx + turned * rx + normal * nx,
        plane * vy + along * my + turned * ry + normal * ny,
        plane * vz + along * mz + turned * rz + normal * nz,
    )
    # (17): what turns.
    swing, lean, drift = -0.5 * a2, 0.5 * a3 * vn, 0.5 * a3 * mn
    upright = a3 * (mn * vn - 0.5 * mv) - a2 * rn
    turning = (
        swing * rx + lean * mx + drift * vx + upright * nx,
        swing * ry + lean * my + drift * vy + upright * ny,
        swing * rz + lean * mz + drift * vz + upright * nz,
    )
    return force, turning


@inlined(**PLAIN_INLINED)
def _resist(linear, quadratic, speed):
    return -(linear + quadratic * abs(speed)) * speed


@njit(**PLAIN_INLINED, forceinline=True)
def losses(body, state, r, velocity, rate):
    """Force (3) in the frame of the map, torque (3) in that of the body, at a velocity (3) and angular velocity (3).

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
            _resist(body[DRAG + 9], body[DRAG + 12], rate[0]),
            _resist(body[DRAG + 10], body[DRAG + 13], rate[1]),
            _resist(body[DRAG + 11], body[DRAG + 14], rate[2]),
        )
    if body[PLATE + CONDUCTIVITY] > 0.0:
        more, turning = _eddies(body, state, r, velocity, rate)
        force = (force[0] + more[0], force[1] + more[1], force[2] + more[2])
        torque = (torque[0] + turning[0], torque[1] + turning[1], torque[2] + turning[2])
    return force, torque


@inlined(**PLAIN_INLINED)
def _eddies(body, state, r, velocity, rate):
    m = to_map(r, body[DIPOLE], body[DIPOLE + 1], body[DIPOLE + 2])
    arm = to_map(r, body[DIPOLE + 3], body[DIPOLE + 4], body[DIPOLE + 5])
    w = to_map(r, rate[0], rate[1], rate[2])
    swing = cross(w, arm)
    v = (velocity[0] + swing[0], velocity[1] + swing[1], velocity[2] + swing[2])
    x, y, z = state[POSITION] + arm[0], state[POSITION + 1] + arm[1], state[POSITION + 2] + arm[2]
    force, turning = plate_force(body, PLATE, x, y, z, m, v, cross(w, m))
    a, b = cross(m, turning), cross(arm, force)
    return force, to_body(r, a[0] + b[0], a[1] + b[1], a[2] + b[2])


@inlined(**PLAIN_INLINED)
def velocity_of(state):
    """Velocity (3) of the centre of mass."""
    return state[VELOCITY], state[VELOCITY + 1], state[VELOCITY + 2]


@inlined(**PLAIN_INLINED)
def angular_velocity_of(state):
    """Angular velocity (3) in the frame of the body."""
    return state[ANGULAR_VELOCITY], state[ANGULAR_VELOCITY + 1], state[ANGULAR_VELOCITY + 2]
