"""A levitated magnet in closed loop: one run, from sensor to current to motion and back, at two rates.

Every control period: sense, compute, allocate, convert. `delay` mechanical steps later the new currents are asked for.
Every mechanical step: currents move, then the body. docs/theory/dynamics.md (30).

A run can stop between sensing and computing, where somebody else gives the outputs, and go on from there: loops that
are written by hand, sample by sample, pass through the same machine code as whole runs.

rows (r, 13 + 2 n + 3 + m): state, currents, commanded currents, what is seen, outputs.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.control.block import SIGNALS, control
from fieldmap.kernels.control.function import DONE, GIVEN, NO_FUNCTION, call_function
from fieldmap.kernels.control.instruments import LOWER as LOWER_LIMIT
from fieldmap.kernels.control.instruments import UPPER as UPPER_LIMIT
from fieldmap.kernels.control.instruments import drive
from fieldmap.kernels.copy_vector import copy_vector
from fieldmap.kernels.map.cached_field import forget, keep_field
from fieldmap.kernels.map.map_block import (
    CELLS,
    INSIDE,
    INVERSE,
    LOWER,
    NOT_FINITE,
    PLAIN,
    PLAIN_INLINED,
    SETS,
    WHOLE,
)
from fieldmap.kernels.motion.contact import ON_CEILING, ON_FLOOR, ON_WALL
from fieldmap.kernels.motion.currents import AMPLIFIER, WINDING, advance_currents, allocate, find_weights
from fieldmap.kernels.motion.inverse import find_signals
from fieldmap.kernels.motion.layout import FORCE, POSITION, STATE
from fieldmap.kernels.motion.magnet import field_points
from fieldmap.kernels.motion.sensing import SCAN_TIME, add_scans, see, sensed_point
from fieldmap.kernels.motion.step import find_load, step_of_two

# What ends a run; names in fieldmap.dynamics.loop_run.
NOTHING, FELL_OUT, LEFT_ABOVE, LEFT_SIDEWAYS, NOT_A_NUMBER = 0, 1, 2, 3, 4
HIT_FLOOR, HIT_POLE, HIT_TUBE, SATURATED, BEYOND_CURRENTS = 5, 6, 7, 8, 9
# Of a controller that is a function: it said so itself; its outputs are not finite.
CONTROLLER_FAILED, OUTPUTS_NOT_FINITE = 10, 11
# No end: the outputs of the next sample are to be given.
PAUSED = 12
# Beside the sum of contacts: the currents were beyond the table of saturating iron.
BEYOND = 8


class Timing(NamedTuple):
    """Length of a mechanical step, s; steps per control period; delay in steps; periods from row to row."""

    step: float
    per_period: int
    delay: int
    every: int


class Ending(NamedTuple):
    """What ends a run: sum of the contacts that do; longest saturation in periods, 0 for any."""

    contacts: int
    longest_saturation: int


class Signals(NamedTuple):
    """References (p, 3), feed-forward (p, m), loads (p or 1, 6: disturbing force and torque), noise of the position
    (p, 3), of the input converters (p, 3), of the currents (p, n); scans (k, 3), which hold their noise."""

    references: Any
    feedforward: Any
    loads: Any
    noise: Any
    voltage_noise: Any
    current_noise: Any
    scans: Any


class Moving(NamedTuple):
    """State (13,), currents (n,), memory of the controller and load (6,); all are advanced."""

    state: Any
    currents: Any
    memory: Any
    load: Any


class ControlLaw(NamedTuple):
    """From what is seen to voltages. address: of a function (`fieldmap.kernels.control.function`), NO_FUNCTION or
    GIVEN; controller: `Block`, of which a function takes the limits only; allocation: `Allocation`; inverse: `Inverse`,
    or None for outputs that go to the coils as they are: the loop is then compiled without the search."""

    address: int
    controller: Any
    allocation: Any
    inverse: Any


class Room(NamedTuple):
    """What a run writes to. field: the cached field; asked: commands now, the last, those before, (n,) each; points:
    two of them, (3,); read, seen (3,): what sensors and controller read; signals: as a block takes them, reference and
    what is seen first; scratch, outputs (m,), voltages (n,); watch (4,)."""

    field: Any
    asked: Any
    points: Any
    read: Any
    seen: Any
    signals: Any
    scratch: Any
    outputs: Any
    voltages: Any
    watch: Any


# What a run has done so far, (6,): samples; mechanical steps; rows; periods that a limit has held without a break;
# whether the next sample is sensed; what its controller returned.
SAMPLES, STEPS, ROWS, HELD, SENSED, ANSWER = 0, 1, 2, 3, 4, 5
PROGRESS = 6


@njit(**PLAIN)
def way_out(block, status, z):
    """How a magnet at height z left the map."""
    if status == NOT_FINITE or z != z:
        return NOT_A_NUMBER
    if z < block[LOWER + 2]:
        return FELL_OUT
    if z > block[LOWER + 2] + block[CELLS + 2] / block[INVERSE + 2]:
        return LEFT_ABOVE
    return LEFT_SIDEWAYS


@njit(**PLAIN)
def hit(touched, ending):
    """The event of what is touched, if it is among those that end a run (a sum like `touched`)."""
    if touched & ending & ON_FLOOR:
        return HIT_FLOOR
    if touched & ending & ON_CEILING:
        return HIT_POLE
    if touched & ending & ON_WALL:
        return HIT_TUBE
    return NOTHING


# What a run remembers from step to step: number of the next scan, what was ever touched, whether the currents lie
# within the table of the iron, whether currents follow their commands at once.
SCAN, EVER, WITHIN, AT_ONCE = 0, 1, 2, 3


@njit(**WHOLE)
def _to_coils(plant, allocation, inverse, seen, outputs, voltages):
    """Fill voltages (n,) of the coils: from the outputs, or from the forces that they are at the place that is seen."""
    if inverse is None:
        allocate(allocation, outputs, voltages)
    else:
        believed, point = inverse.believed, np.empty(3)
        sensed_point(believed, plant.seen_at, point)
        for k in range(3):
            believed[POSITION + k] += seen[k] - point[k]
        find_signals(plant, allocation, outputs, inverse)
        allocate(allocation, inverse.signals, voltages)


@njit(**PLAIN)
def _command(drives, current_noise, voltages, commands):
    """Fill commands (n,), A; whether a converter or amplifier held a voltage back."""
    held = False
    for k in range(commands.shape[0]):
        held |= voltages[k] > drives[k, UPPER_LIMIT] or voltages[k] < drives[k, LOWER_LIMIT]
        commands[k] = drive(voltages[k], current_noise[k], drives[k])
    return held


# What runs once a sample counts no references, either: `Room`, `Signals` and the rest are thirty arrays, and a function
# that counts them spends half of the sample on it. So no slices are assigned in these.
@njit(**PLAIN)
def _record(row, state, currents, commands, seen, outputs):
    n, m = currents.shape[0], outputs.shape[0]
    for k in range(STATE):
        row[k] = state[k]
    for k in range(n):
        row[STATE + k], row[STATE + n + k] = currents[k], commands[k]
    for k in range(3):
        row[STATE + 2 * n + k] = seen[k]
    for k in range(m):
        row[STATE + 2 * n + 3 + k] = outputs[k]


@njit(**PLAIN)
def _sense(sample, time, plant, sensing, signals, state, room):
    """Fill what is seen, and the signals of the controller."""
    point, v = room.points[1], room.signals
    sensed_point(state, plant.seen_at, point)
    noise, voltage_noise = signals.noise[sample], signals.voltage_noise[sample]
    see(sensing, point, time, noise, voltage_noise, signals.scans, room.read, room.seen)
    for k in range(3):
        v[k], v[3 + k] = signals.references[sample, k], room.seen[k]


@njit(**PLAIN)
def _call(law, time, feedforward, memory, room):
    """Outputs of a function, or those that are given, with the feed-forward and within the limits: an event, what the
    function returned, and whether a limit held one back."""
    outputs, lower, upper, held = room.outputs, law.controller.lower, law.controller.upper, False
    if law.address != GIVEN:
        # What it was called with, should it fail.
        for k in range(memory.shape[0]):
            room.scratch[k] = memory[k]
        answer = call_function(law.address, time, room.signals[3:6], room.signals[:3], memory, outputs)
        if answer != DONE:
            return CONTROLLER_FAILED, answer, held
    for j in range(outputs.shape[0]):
        if not math.isfinite(outputs[j]):
            return OUTPUTS_NOT_FINITE, 0, held
        wanted = outputs[j] + feedforward[j]
        outputs[j] = min(max(wanted, lower[j]), upper[j])
        held |= wanted != outputs[j]
    return NOTHING, 0, held


@njit(**PLAIN)
def _sample(sample, time, plant, law, signals, memory, room, waiting, progress):
    """Compute, allocate, convert: fill waiting (n,), A; an event, and whether a limit held anything back."""
    v, outputs, feedforward = room.signals, room.outputs, signals.feedforward[sample]
    if law.address == NO_FUNCTION:
        held = control(law.controller, v, feedforward, memory, room.scratch, outputs)
    else:
        event, progress[ANSWER], held = _call(law, time, feedforward, memory, room)
        if event != NOTHING:
            return event, held
    _to_coils(plant, law.allocation, law.inverse, room.seen, outputs, room.voltages)
    limited = _command(plant.drives, signals.current_noise[sample], room.voltages, waiting)
    return NOTHING, held or limited


@inlined(**PLAIN_INLINED)
def _move_currents(plant, field, commands, currents, watch):
    """One step of the currents, and the weights if any moved; whether a supply held one back, and whether any moved."""
    superposition = plant.superposition
    held, moved = advance_currents(plant.coils, commands, currents)
    if moved:
        kind, scale, table, iron = superposition
        watch[WITHIN] = find_weights(kind, scale, table, iron, currents, field[1])
        forget(field)
    return held, moved


@njit(**PLAIN)
def _mechanics(first, timing, plant, field, sensing, scans, asked, ending, moving, watch, points):
    """The steps of one control period, of which the first has number `first`: (event, steps done, whether a supply held
    a current back). asked: commands now, the last and those before, (n,) each; moving: state, currents, load."""
    h, per_period, delay = timing.step, timing.per_period, timing.delay
    block, body, seen_at = plant.block, plant.body, plant.seen_at
    commands, waiting, late = asked
    state, currents, load = moving
    before, point = points
    held, scanning = False, sensing.scan[SCAN_TIME] > 0.0
    for step in range(per_period):
        if step == delay or (step == 0 and delay == per_period):
            now = late if delay == per_period else waiting
            for k in range(commands.shape[0]):
                commands[k] = now[k]
            if watch[AT_ONCE] and _move_currents(plant, field, commands, currents, watch)[1]:
                find_load(field, body, state, load)
        held |= _move_currents(plant, field, commands, currents, watch)[0]
        if not watch[WITHIN]:
            watch[EVER] |= BEYOND
            if ending.contacts & BEYOND:
                return BEYOND_CURRENTS, step, held
        if scanning:
            sensed_point(state, seen_at, before)
        status, touched = step_of_two(field, body, state, load, h)
        watch[EVER] |= touched
        if status != INSIDE:
            return way_out(block, status, state[POSITION + 2]), step + 1, held
        event = hit(touched, ending.contacts)
        if event != NOTHING:
            return event, step + 1, held
        if scanning:
            sensed_point(state, seen_at, point)
            start = (first + step) * h
            watch[SCAN] = add_scans(
                sensing.scan, before, point, start, h, watch[SCAN], scans, sensing.into, sensing.shift
            )
    return NOTHING, per_period, held


def begin(timing, plant, sensing, signals, moving, outputs):
    """The `Room` of a run of so many outputs, with the load at the start and the first scan; an event. Not compiled:
    what it calls is, for others."""
    superposition, coils, currents, body = plant.superposition, plant.coils, moving.currents, plant.body
    field = keep_field(plant.block, np.empty(int(plant.block[SETS])), field_points(body))
    asked, points = (currents.copy(), currents.copy(), currents.copy()), (np.empty(3), np.empty(3))
    scratch, voltages = np.empty(moving.memory.shape[0] + outputs), np.empty(currents.shape[0])
    watch = np.zeros(4, np.int64)
    room = Room(
        field,
        asked,
        points,
        np.empty(3),
        np.empty(3),
        np.ones(SIGNALS),
        scratch,
        np.zeros(outputs),
        voltages,
        watch,
    )
    watch[AT_ONCE] = 1
    for k in range(currents.shape[0]):
        watch[AT_ONCE] &= coils[k, WINDING] == 0.0 and coils[k, AMPLIFIER] == 0.0
    copy_vector(signals.loads[0], body[FORCE : FORCE + 6])
    sensed_point(moving.state, plant.seen_at, points[1])
    if sensing.scan[SCAN_TIME] > 0.0:
        instant, into, shift = timing.step * 1e-9, sensing.into, sensing.shift
        watch[SCAN] = add_scans(
            sensing.scan, points[1], points[1], 0.0, instant, 0, signals.scans, into, shift
        )
    kind, scale, table, iron = superposition
    watch[WITHIN] = find_weights(kind, scale, table, iron, currents, field[1])
    status = find_load(field, body, moving.state, moving.load)[0]
    event = NOTHING if status == INSIDE else way_out(plant.block, status, moving.state[POSITION + 2])
    return room, event


@njit(**PLAIN)
def closed_loop(timing, plant, sensing, law, ending, signals, moving, room, progress, rows):
    """Run until the end or an event, which is returned; at given outputs until they are asked for: PAUSED.

    timing, plant, sensing, law, ending, signals, moving: `Timing`, `Plant`, `Sensing`, `ControlLaw`, `Ending`,
    `Signals`, `Moving`; room: of `begin`; progress (PROGRESS,): zeros at the start. plant.body is overwritten with
    disturbances.
    """
    h, every = timing.step, timing.every
    body, loads = plant.body, signals.loads
    state, currents, memory, load = moving
    asked, watch = room.asked, room.watch
    while progress[SAMPLES] < signals.references.shape[0]:
        sample, first = progress[SAMPLES], progress[STEPS]
        time = first * h
        if progress[SENSED] == 0:
            _sense(sample, time, plant, sensing, signals, state, room)
            progress[SENSED] = 1
            if law.address == GIVEN:
                return PAUSED
        for k in range(currents.shape[0]):
            asked[2][k] = asked[1][k]
        event, held = _sample(sample, time, plant, law, signals, memory, room, asked[1], progress)
        if event != NOTHING:
            return event
        if loads.shape[0] > 1 and sample > 0:
            for k in range(6):
                body[FORCE + k] = loads[sample, k]
            find_load(room.field, body, state, load)
        if sample % every == 0 and progress[ROWS] < rows.shape[0]:
            _record(rows[progress[ROWS]], state, currents, asked[0], room.seen, room.outputs)
            progress[ROWS] += 1
        event, steps, limited = _mechanics(
            first,
            timing,
            plant,
            room.field,
            sensing,
            signals.scans,
            asked,
            ending,
            (state, currents, load),
            watch,
            room.points,
        )
        progress[STEPS] += steps
        if event != NOTHING:
            return event
        progress[SAMPLES], progress[SENSED] = sample + 1, 0
        progress[HELD] = progress[HELD] + 1 if held or limited else 0
        if ending.longest_saturation > 0 and progress[HELD] >= ending.longest_saturation:
            return SATURATED
    return NOTHING
