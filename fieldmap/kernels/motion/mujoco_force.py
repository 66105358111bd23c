"""Force and torque on magnets in MuJoCo: what its callback for passive forces calls, without Python.

MuJoCo hands over addresses, and so does this: everything that a callback needs lies in arrays whose addresses stand in
one of whole numbers, the task, of which the callback has the address. Nothing is written but the status, so
several threads may step at a time.
"""

from typing import Any

from llvmlite import ir
from numba import carray, types
from numba.core import cgutils
from numba.extending import intrinsic

from fieldmap.kernels.addresses import reals, words
from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.constants import MU0_OVER_4PI
from fieldmap.kernels.map import induced_moment as iron
from fieldmap.kernels.map.lookup import superposed_at
from fieldmap.kernels.map.map_block import INSIDE, PLAIN, PLAIN_INLINED, WHOLE

# Where things stand in a task: addresses of MuJoCo's model and of its function mj_applyFT; offsets in its data of the
# pointers to xpos, xmat and qfrc_passive; address and size of the map's block, of the currents (and 1 for a field that
# no current drives), of the dipoles (k, 6), of the bodies; whether magnets act on each other; status of the first point
# that was not in the map, number of its magnet, and address of three numbers for that point; address of the map's
# origin in the world (3).
MODEL, APPLY, XPOS, XMAT, PASSIVE, BLOCK, BLOCK_SIZE, CURRENTS, COILS = range(9)
DIPOLES, DIPOLE_COUNT, BODIES, BODY_COUNT, MUTUAL, STATUS, AT_FAULT, PLACE, ORIGIN = range(9, 18)
# Address and size of the soft pieces of all bodies, as in fieldmap.kernels.map.induced_moment, one after the other.
SOFT, SOFT_SIZE, SIZE = 18, 19, 20
# Of BODIES (b, 5): number of the body in MuJoCo, its first dipole, the one after its last; its first degree of freedom
# where a free joint is all that it hangs on, else -1; where its soft pieces begin, else -1.
_WORD, _REAL = ir.IntType(64), ir.DoubleType()


def _applied(
    _: Any, function: Any, model: Any, data: Any, load: Any, place: Any, body: Any, target: Any
) -> Any:
    """mj_applyFT(model, data, force, torque, point, body, target), load: six numbers on the stack, all as addresses."""
    reals = types.UniTuple(types.float64, 6)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        function, model, data, load, place, body, target = arguments
        number = ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [_WORD] * 5 + [number, _WORD])
        room = cgutils.alloca_once(builder, _REAL, size=6)
        for k in range(6):
            slot = builder.gep(room, [ir.Constant(number, k)])
            builder.store(builder.extract_value(load, k), slot)
        force = builder.ptrtoint(room, _WORD)
        torque = builder.add(force, ir.Constant(_WORD, 24))
        called = builder.inttoptr(function, kind.as_pointer())
        builder.call(called, [model, data, force, torque, place, builder.trunc(body, number), target])
        return context.get_dummy_value()

    return types.void(types.intp, types.intp, types.intp, reals, types.intp, types.intp, types.intp), generate


_apply: Any = intrinsic(_applied)


@inlined(**PLAIN_INLINED)
def _turned(turn, x, y, z):
    """A vector of the body in the world; turn (9,)."""
    return (
        turn[0] * x + turn[1] * y + turn[2] * z,
        turn[3] * x + turn[4] * y + turn[5] * z,
        turn[6] * x + turn[7] * y + turn[8] * z,
    )


@njit(**PLAIN)
def _by_dipole(r, source, moment):
    """Force and field on a dipole `moment` at r from a dipole `source` (docs/theory/wrench.md); triples."""
    x, y, z = r
    square = x * x + y * y + z * z
    scale = MU0_OVER_4PI / (square * square * square**0.5)
    a = source[0] * x + source[1] * y + source[2] * z
    b = moment[0] * x + moment[1] * y + moment[2] * z
    both = source[0] * moment[0] + source[1] * moment[1] + source[2] * moment[2] - 5.0 * a * b / square
    force = (
        3.0 * scale * (a * moment[0] + b * source[0] + both * x),
        3.0 * scale * (a * moment[1] + b * source[1] + both * y),
        3.0 * scale * (a * moment[2] + b * source[2] + both * z),
    )
    flux = (
        scale * (3.0 * a * x - square * source[0]),
        scale * (3.0 * a * y - square * source[1]),
        scale * (3.0 * a * z - square * source[2]),
    )
    return force, flux


@njit(**PLAIN)
def _by_others(task, bodies, dipoles, places, turns, own, point, moment):
    """Force and field on a dipole of magnet `own` at a point by the dipoles of all others."""
    fx, fy, fz, bx, by, bz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for other in range(task[BODY_COUNT]):
        if other == own:
            continue
        body = bodies[other, 0]
        for q in range(bodies[other, 1], bodies[other, 2]):
            d, turn = dipoles[q], turns[body]
            ax, ay, az = _turned(turn, d[0], d[1], d[2])
            source = _turned(turn, d[3], d[4], d[5])
            r = (
                point[0] - places[body, 0] - ax,
                point[1] - places[body, 1] - ay,
                point[2] - places[body, 2] - az,
            )
            force, flux = _by_dipole(r, source, moment)
            fx, fy, fz = fx + force[0], fy + force[1], fz + force[2]
            bx, by, bz = bx + flux[0], by + flux[1], bz + flux[2]
    return fx, fy, fz, bx, by, bz


# Not inlined, so that what is done for every magnet counts no references.
@njit(**WHOLE)
def _superposed_at(block, currents, x, y, z):
    """See `fieldmap.kernels.map.lookup`."""
    return superposed_at(block, currents, x, y, z)


@njit(**PLAIN)
def _on_iron(soft, base, place, turn, block, currents, origin):
    """Status of the map, and force and torque (6) of the map's field on a body's soft pieces about its origin."""
    fx, fy, fz, tx, ty, tz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for p in range(int(soft[base])):
        at = base + 1 + iron.SIZE * p + iron.POINT
        ax, ay, az = _turned(turn, soft[at], soft[at + 1], soft[at + 2])
        x, y, z = place[0] + ax - origin[0], place[1] + ay - origin[1], place[2] + az - origin[2]
        status, v = _superposed_at(block, currents, x, y, z)
        if status != INSIDE:
            return status, (x, y, z, 0.0, 0.0, 0.0)
        bx = turn[0] * v[0] + turn[3] * v[1] + turn[6] * v[2]
        by = turn[1] * v[0] + turn[4] * v[1] + turn[7] * v[2]
        bz = turn[2] * v[0] + turn[5] * v[1] + turn[8] * v[2]
        mx, my, mz, _ = iron.induced_moment(soft, base, p, bx, by, bz)
        m = _turned(turn, mx, my, mz)
        gx = v[3] * m[0] + v[6] * m[1] + v[9] * m[2]
        gy = v[4] * m[0] + v[7] * m[1] + v[10] * m[2]
        gz = v[5] * m[0] + v[8] * m[1] + v[11] * m[2]
        fx, fy, fz = fx + gx, fy + gy, fz + gz
        tx += m[1] * v[2] - m[2] * v[1] + ay * gz - az * gy
        ty += m[2] * v[0] - m[0] * v[2] + az * gx - ax * gz
        tz += m[0] * v[1] - m[1] * v[0] + ax * gy - ay * gx
    return INSIDE, (fx, fy, fz, tx, ty, tz)


@njit(**PLAIN)
def _load(task, bodies, dipoles, soft, places, turns, block, currents, origin, n):
    """Status of the map, and force and torque (6) on magnet n about its body's origin, in the world."""
    body = bodies[n, 0]
    fx, fy, fz, tx, ty, tz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for q in range(bodies[n, 1], bodies[n, 2]):
        d, turn = dipoles[q], turns[body]
        ax, ay, az = _turned(turn, d[0], d[1], d[2])
        m = _turned(turn, d[3], d[4], d[5])
        x, y, z = places[body, 0] + ax, places[body, 1] + ay, places[body, 2] + az
        status, v = _superposed_at(block, currents, x - origin[0], y - origin[1], z - origin[2])
        if status != INSIDE:
            return status, (x - origin[0], y - origin[1], z - origin[2], 0.0, 0.0, 0.0)
        bx, by, bz = v[0], v[1], v[2]
        gx = v[3] * m[0] + v[6] * m[1] + v[9] * m[2]
        gy = v[4] * m[0] + v[7] * m[1] + v[10] * m[2]
        gz = v[5] * m[0] + v[8] * m[1] + v[11] * m[2]
        if task[MUTUAL]:
            near = _by_others(task, bodies, dipoles, places, turns, n, (x, y, z), m)
            gx, gy, gz = gx + near[0], gy + near[1], gz + near[2]
            bx, by, bz = bx + near[3], by + near[4], bz + near[5]
        fx, fy, fz = fx + gx, fy + gy, fz + gz
        tx += m[1] * bz - m[2] * by + ay * gz - az * gy
        ty += m[2] * bx - m[0] * bz + az * gx - ax * gz
        tz += m[0] * by - m[1] * bx + ax * gy - ay * gx
    if bodies[n, 4] < 0:
        return INSIDE, (fx, fy, fz, tx, ty, tz)
    status, more = _on_iron(soft, bodies[n, 4], places[body], turns[body], block, currents, origin)
    if status != INSIDE:
        return status, more
    return INSIDE, (fx + more[0], fy + more[1], fz + more[2], tx + more[3], ty + more[4], tz + more[5])


@njit(**WHOLE)
def add_forces(active, model, data):
    """The callback: add the load of every magnet to the passive forces of MuJoCo's data.

    active: address of the address of a task.
    """
    task = carray(words(carray(words(active), (1,))[0]), (SIZE,))
    if task[STATUS] != INSIDE or (task[MODEL] != 0 and task[MODEL] != model):
        return
    if task[MODEL] == 0:
        # The first call says where the model lies, and does nothing else.
        task[MODEL] = model
        return
    xpos = carray(words(data + task[XPOS]), (1,))[0]
    xmat = carray(words(data + task[XMAT]), (1,))[0]
    passive = carray(words(data + task[PASSIVE]), (1,))[0]
    bodies = carray(words(task[BODIES]), (task[BODY_COUNT], 5))
    most = 0
    for n in range(task[BODY_COUNT]):
        most = max(most, bodies[n, 0] + 1)
    places, turns = carray(reals(xpos), (most, 3)), carray(reals(xmat), (most, 9))
    dipoles = carray(reals(task[DIPOLES]), (task[DIPOLE_COUNT], 6))
    soft = carray(reals(task[SOFT]), (task[SOFT_SIZE],))
    block = carray(reals(task[BLOCK]), (task[BLOCK_SIZE],))
    currents = carray(reals(task[CURRENTS]), (task[COILS],))
    origin = carray(reals(task[ORIGIN]), (3,))
    for n in range(task[BODY_COUNT]):
        status, load = _load(task, bodies, dipoles, soft, places, turns, block, currents, origin, n)
        if status != INSIDE:
            place = carray(reals(task[PLACE]), (3,))
            for k in range(3):
                place[k] = load[k]
            task[AT_FAULT] = n
            task[STATUS] = status
            return
        body, first = bodies[n, 0], bodies[n, 3]
        if first < 0:
            _apply(task[APPLY], model, data, load, xpos + 24 * body, body, passive)
            continue
        # What mj_applyFT would do: force in the world, torque in the body.
        turn, out = turns[body], carray(reals(passive + 8 * first), (6,))
        for k in range(3):
            out[k] += load[k]
            out[3 + k] += turn[k] * load[3] + turn[3 + k] * load[4] + turn[6 + k] * load[5]
