"""What takes energy from a moving body: drag and eddy currents, docs/theory/dynamics.md (9)..(18).

drag (5, 3): linear (N s/m) along the axes of the map; linear and quadratic (N s^2/m^2) along those of the body; linear
(N m s) and quadratic (N m s^2) of its turning. lossy: 1 if anything of drag is not zero. dipole (6,): moment and place
of the magnet in the frame of the body, what the plate sees of it.
"""

from numba import njit

from fieldmap.kernels.map_block import INLINED
from fieldmap.kernels.motion.layout import POSITION, SPIN, VELOCITY
from fieldmap.kernels.motion.plate import CONDUCTIVITY, plate_force
from fieldmap.kernels.motion.rotation import to_body, to_map


@njit(**INLINED)
def _resist(linear, quadratic, speed):
    return -(linear + quadratic * abs(speed)) * speed


@njit(**INLINED)
def losses(state, r, velocity, spin, drag, lossy, plate, dipole):
    """Force (3) in the frame of the map, torque (3) in that of the body, at a velocity (3) and spin (3).

    r: turn_matrix of the state, whose place and turn alone are read.
    """
    force, torque = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    if lossy:
        u, v, w = to_body(r, velocity[0], velocity[1], velocity[2])
        fx, fy, fz = to_map(
            r,
            _resist(drag[1, 0], drag[2, 0], u),
            _resist(drag[1, 1], drag[2, 1], v),
            _resist(drag[1, 2], drag[2, 2], w),
        )
        force = (
            fx - drag[0, 0] * velocity[0],
            fy - drag[0, 1] * velocity[1],
            fz - drag[0, 2] * velocity[2],
        )
        torque = (
            _resist(drag[3, 0], drag[4, 0], spin[0]),
            _resist(drag[3, 1], drag[4, 1], spin[1]),
            _resist(drag[3, 2], drag[4, 2], spin[2]),
        )
    if plate[CONDUCTIVITY] > 0.0:
        more, turning = _eddies(state, r, velocity, spin, plate, dipole)
        force = (force[0] + more[0], force[1] + more[1], force[2] + more[2])
        torque = (torque[0] + turning[0], torque[1] + turning[1], torque[2] + turning[2])
    return force, torque


@njit(**INLINED)
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(**INLINED)
def _eddies(state, r, velocity, spin, plate, dipole):
    m = to_map(r, dipole[0], dipole[1], dipole[2])
    arm = to_map(r, dipole[3], dipole[4], dipole[5])
    w = to_map(r, spin[0], spin[1], spin[2])
    swing = _cross(w, arm)
    v = (velocity[0] + swing[0], velocity[1] + swing[1], velocity[2] + swing[2])
    x, y, z = state[POSITION] + arm[0], state[POSITION + 1] + arm[1], state[POSITION + 2] + arm[2]
    force, turning = plate_force(plate, x, y, z, m, v, _cross(w, m))
    a, b = _cross(m, turning), _cross(arm, force)
    return force, to_body(r, a[0] + b[0], a[1] + b[1], a[2] + b[2])


@njit(**INLINED)
def velocity_of(state):
    """Velocity (3) of the centre of mass."""
    return state[VELOCITY], state[VELOCITY + 1], state[VELOCITY + 2]


@njit(**INLINED)
def spin_of(state):
    """Angular velocity (3) in the frame of the body."""
    return state[SPIN], state[SPIN + 1], state[SPIN + 2]
