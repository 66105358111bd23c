"""Quaternions, and the free motion of a rigid rotor by splitting: docs/theory/dynamics.md (3)..(6).

The kinetic energy L^2 / (2 I1) + L2^2 (1/I2 - 1/I1) / 2 + L3^2 (1/I3 - 1/I1) / 2, L the angular momentum in the frame
of the body, is a sum of parts whose motions are rotations: the first turns the body about L and commutes with the
others. With I1 = I2 the second is absent and the step is exact. Otherwise it is of second order, symmetric in time and
symplectic; L keeps its length and its direction in space to rounding. After Dullweber, Leimkuhler and McLachlan,
J. Chem. Phys. 107, 5840 (1997), with the part that commutes taken out.
"""

import math

from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.map.map_block import PLAIN_INLINED
from fieldmap.kernels.motion.layout import ANGULAR_VELOCITY, INERTIA, TURN


@njit(**PLAIN_INLINED, forceinline=True)
def turn_matrix(state):
    """The nine entries, row by row, of the matrix that takes vectors from the body to the map."""
    w, x, y, z = state[TURN], state[TURN + 1], state[TURN + 2], state[TURN + 3]
    xx, yy, zz = 2.0 * x * x, 2.0 * y * y, 2.0 * z * z
    xy, xz, yz = 2.0 * x * y, 2.0 * x * z, 2.0 * y * z
    wx, wy, wz = 2.0 * w * x, 2.0 * w * y, 2.0 * w * z
    return 1.0 - yy - zz, xy - wz, xz + wy, xy + wz, 1.0 - xx - zz, yz - wx, xz - wy, yz + wx, 1.0 - xx - yy


@njit(**PLAIN_INLINED, forceinline=True)
def to_map(r, x, y, z):
    """A vector of the body in the frame of the map; r: nine entries of `turn_matrix`."""
    return (
        r[0] * x + r[1] * y + r[2] * z,
        r[3] * x + r[4] * y + r[5] * z,
        r[6] * x + r[7] * y + r[8] * z,
    )


@njit(**PLAIN_INLINED, forceinline=True)
def to_body(r, x, y, z):
    """A vector of the map in the frame of the body; r: nine entries of `turn_matrix`."""
    return (
        r[0] * x + r[3] * y + r[6] * z,
        r[1] * x + r[4] * y + r[7] * z,
        r[2] * x + r[5] * y + r[8] * z,
    )


@inlined(**PLAIN_INLINED)
def cross(a, b):
    """a x b of two triples."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined(**PLAIN_INLINED)
def _turn_by(state, w, x, y, z):
    """state's quaternion times (w, x, y, z): a rotation about axes of the body."""
    a, b, c, d = state[TURN], state[TURN + 1], state[TURN + 2], state[TURN + 3]
    state[TURN] = a * w - b * x - c * y - d * z
    state[TURN + 1] = a * x + b * w + c * z - d * y
    state[TURN + 2] = a * y - b * z + c * w + d * x
    state[TURN + 3] = a * z + b * y - c * x + d * w


@inlined(**PLAIN_INLINED)
def _about_momentum(state, px, py, pz, h):
    """The body turns about its momentum, given over I1, for a time h."""
    rate = math.sqrt(px * px + py * py + pz * pz)
    half = 0.5 * h * rate
    # sin(half) / rate, also where the rate vanishes.
    share = math.sin(half) / rate if rate > 1e-150 else 0.5 * h
    _turn_by(state, math.cos(half), share * px, share * py, share * pz)


@njit(**PLAIN_INLINED, forceinline=True)
def free_turn(state, body, h):
    """Advance quaternion and angular velocity by a time h without torque."""
    i1, i2, i3 = body[INERTIA], body[INERTIA + 1], body[INERTIA + 2]
    p1, p2, p3 = (
        i1 * state[ANGULAR_VELOCITY],
        i2 * state[ANGULAR_VELOCITY + 1],
        i3 * state[ANGULAR_VELOCITY + 2],
    )
    _about_momentum(state, p1 / i1, p2 / i1, p3 / i1, h)
    unlike = i1 != i2
    if unlike:
        p1, p3 = _about_second(state, p1, p2, p3, 0.5 * h * (1.0 / i2 - 1.0 / i1))
    if i3 != i1:
        angle = h * p3 * (1.0 / i3 - 1.0 / i1)
        s, c = math.sin(0.5 * angle), math.cos(0.5 * angle)
        _turn_by(state, c, 0.0, 0.0, s)
        sine, cosine = 2.0 * s * c, c * c - s * s
        p1, p2 = cosine * p1 + sine * p2, cosine * p2 - sine * p1
    if unlike:
        p1, p3 = _about_second(state, p1, p2, p3, 0.5 * h * (1.0 / i2 - 1.0 / i1))
    state[ANGULAR_VELOCITY], state[ANGULAR_VELOCITY + 1], state[ANGULAR_VELOCITY + 2] = (
        p1 / i1,
        p2 / i2,
        p3 / i3,
    )


@inlined(**PLAIN_INLINED)
def _about_second(state, p1, p2, p3, factor):
    """A turn about the body's second axis by factor p2; the momentum's other two components after it."""
    angle = factor * p2
    s, c = math.sin(0.5 * angle), math.cos(0.5 * angle)
    _turn_by(state, c, 0.0, s, 0.0)
    sine, cosine = 2.0 * s * c, c * c - s * s
    return cosine * p1 - sine * p3, cosine * p3 + sine * p1


@njit(**PLAIN_INLINED, forceinline=True)
def normalise(state):
    """Take what rounding did to the quaternion's length back: one step of Newton's method for 1 / length."""
    a, b, c, d = state[TURN], state[TURN + 1], state[TURN + 2], state[TURN + 3]
    scale = 1.5 - 0.5 * (a * a + b * b + c * c + d * d)
    for k in range(4):
        state[TURN + k] *= scale
