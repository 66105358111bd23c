"""Force and torque on what is magnetic in a moving body: docs/theory/dynamics.md (7), (8), wrench.md (5)..(8).

body: its dipoles (layout), one for a point dipole, the points of a volume rule for a finite magnet, and its pieces of
soft iron, whose moments the field induces. field: as in cached_field, a point for each dipole and each soft piece.
"""

from collections.abc import Callable
from typing import Any

from numba import types
from numba.extending import overload

from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.late_call import LateFunctions, array_at
from fieldmap.kernels.map.cached_field import kept_at, kept_in
from fieldmap.kernels.map.induced_moment import POINT, SIZE, induced_moment
from fieldmap.kernels.map.lookup import KERNELS
from fieldmap.kernels.map.map_block import (
    INLINED_EARLY,
    INSIDE,
    KIND,
    PLAIN,
    PLAIN_INLINED,
    InterpolantKernels,
)
from fieldmap.kernels.motion.layout import FIRST, MAGNETS, POSITION, SKIN, SOFT, STATE
from fieldmap.kernels.motion.rotation import to_body, to_map, turn_matrix


@njit(**PLAIN_INLINED, forceinline=True)
def field_points(body):
    """At how many points the field acts on a body."""
    return int(body[MAGNETS] + body[SOFT])


@inlined(**PLAIN_INLINED)
def _first_soft(body):
    """Where the array of the soft pieces begins."""
    return FIRST + 6 * int(body[MAGNETS]) + 3 * int(body[SKIN])


def _wrench_in(kernels: InterpolantKernels) -> Callable[..., Any]:
    """`magnet_wrench` in fields of one interpolant."""
    kept_at = kept_in((kernels,))

    # Without caches of their own: they are compiled into the late function.
    @njit(**PLAIN, cache=False)
    def soft_wrench(field, body, r, state):
        """Status of the map; force and torque (6) on the soft pieces about the centre of mass, frame of the map."""
        base, dipoles = _first_soft(body), int(body[MAGNETS])
        fx, fy, fz, tx, ty, tz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for p in range(int(body[SOFT])):
            at = base + 1 + SIZE * p + POINT
            ax, ay, az = to_map(r, body[at], body[at + 1], body[at + 2])
            x, y, z = state[POSITION] + ax, state[POSITION + 1] + ay, state[POSITION + 2] + az
            status, v = kept_at(field, dipoles + p, x, y, z)
            if status != INSIDE:
                return status, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
            bx, by, bz = to_body(r, v[0], v[1], v[2])
            mx, my, mz, _ = induced_moment(body, base, p, bx, by, bz)
            mx, my, mz = to_map(r, mx, my, mz)
            gx = v[3] * mx + v[6] * my + v[9] * mz
            gy = v[4] * mx + v[7] * my + v[10] * mz
            gz = v[5] * mx + v[8] * my + v[11] * mz
            fx, fy, fz = fx + gx, fy + gy, fz + gz
            tx += my * v[2] - mz * v[1] + ay * gz - az * gy
            ty += mz * v[0] - mx * v[2] + az * gx - ax * gz
            tz += mx * v[1] - my * v[0] + ax * gy - ay * gx
        return INSIDE, (fx, fy, fz, tx, ty, tz)

    @njit(**INLINED_EARLY, cache=False)
    def wrench(field, body, state, load):
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
        if body[SOFT] > 0.0:
            status, soft = soft_wrench(field, body, r, state)
            if status != INSIDE:
                return status
            fx, fy, fz = fx + soft[0], fy + soft[1], fz + soft[2]
            tx, ty, tz = tx + soft[3], ty + soft[4], tz + soft[5]
        load[0], load[1], load[2] = fx, fy, fz
        load[3], load[4], load[5] = to_body(r, tx, ty, tz)
        return INSIDE

    return wrench


_WRENCHES = tuple(map(_wrench_in, KERNELS))


# What a late function names must be the same in every process, or numba would not find it in its files again: a number,
# but not one of the kernels made above. So the number is the constant from which `_wrench` takes its kernel.
def _wrench(kind, field, body, state, load):
    return _WRENCHES[kind](field, body, state, load)


@overload(_wrench, inline="always", prefer_literal=True)
def _wrench_of_constant(kind, field, body, state, load):
    """`_wrench` for a kind that is a constant where it is compiled: of one interpolant alone."""
    if not isinstance(kind, types.IntegerLiteral):
        return None
    wrench = _WRENCHES[kind.literal_value]
    return lambda kind, field, body, state, load: wrench(field, body, state, load)


def _late_wrench(kind: int) -> Callable[..., Any]:
    def late_wrench(
        block, weights, places, numbers, body, state, load, coefficients, sets, points, kept, length
    ):
        rows = array_at(numbers, (points, kept))
        field = (
            array_at(block, (coefficients,)),
            array_at(weights, (sets,)),
            array_at(places, (points,)),
            rows,
        )
        mover, moving = array_at(body, (length,)), array_at(state, (STATE,))
        return _wrench(kind, field, mover, moving, array_at(load, (6,)))

    return late_wrench


_READ, _WORDS = types.Array(types.float64, 1, "C", readonly=True), types.Array(types.int64, 1, "C")
_KEPT, _LOAD = types.Array(types.float64, 2, "C"), types.Array(types.float64, 1, "C")
_ARRAYS = _READ, _READ, _WORDS, _KEPT, _READ, _READ, _LOAD
LATE_WRENCHES = LateFunctions(
    "fieldmap_magnet_wrench",
    types.intc,
    (*_ARRAYS, *5 * (types.intp,)),
    [_late_wrench(kind) for kind in range(len(KERNELS))],
    **PLAIN,
)
"""Of every interpolant, by its number in `fieldmap.kernels.map.lookup.KERNELS`."""
_call_wrench = LATE_WRENCHES.call


@njit(**PLAIN)
def magnet_wrench(field, body, state, load):
    """load (6,): force in the frame of the map, torque about the centre of mass in the frame of the body.

    Returns the status of the first point that is not inside the map, INSIDE if all are.
    """
    block, weights, places, numbers = field
    sizes = block.shape[0], weights.shape[0], numbers.shape[0], numbers.shape[1], body.shape[0]
    return _call_wrench(int(block[KIND]), (block, weights, places, numbers, body, state, load, *sizes))


@njit(**PLAIN)
def magnet_energy(field, body, state):
    """Interaction energy -m . B of the dipoles and -integral of m dB of soft pieces, J, NaN outside the map."""
    r, base, dipoles = turn_matrix(state), _first_soft(body), int(body[MAGNETS])
    energy = 0.0
    # One loop for both: what looks the field up is large, and would be compiled in each.
    for p in range(field_points(body)):
        at = FIRST + 6 * p if p < dipoles else base + 1 + SIZE * (p - dipoles) + POINT
        ax, ay, az = to_map(r, body[at], body[at + 1], body[at + 2])
        x, y, z = state[POSITION] + ax, state[POSITION + 1] + ay, state[POSITION + 2] + az
        _, v = kept_at(field, p, x, y, z)
        if p < dipoles:
            mx, my, mz = to_map(r, body[at + 3], body[at + 4], body[at + 5])
            energy -= mx * v[0] + my * v[1] + mz * v[2]
        else:
            bx, by, bz = to_body(r, v[0], v[1], v[2])
            energy += induced_moment(body, base, p - dipoles, bx, by, bz)[3]
    return energy
