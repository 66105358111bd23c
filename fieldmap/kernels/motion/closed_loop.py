"""A levitated magnet in closed loop: one run, from sensor to current to motion and back, at two rates.

Every control period: sense, compute, allocate, convert. `delay` mechanical steps later the new currents are asked for.
Every mechanical step: currents move, then the body. docs/theory/dynamics.md (30).

rows (r, 13 + 2 n + 3 + m): state, currents, commanded currents, what is seen, outputs.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from fieldmap.kernels.control.block import SIGNALS, control
from fieldmap.kernels.control.instruments import LOWER as LOWER_LIMIT
from fieldmap.kernels.control.instruments import UPPER as UPPER_LIMIT
from fieldmap.kernels.control.instruments import drive
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
from fieldmap.kernels.motion.layout import FORCE, MAGNETS, POSITION, STATE
from fieldmap.kernels.motion.sensing import SCAN_TIME, add_scans, see, sensed_point
from fieldmap.kernels.motion.step import find_load, step_of_two

# What ends a run; names in fieldmap.dynamics.loop_run.
NOTHING, FELL_OUT, LEFT_ABOVE, LEFT_SIDEWAYS, NOT_A_NUMBER = 0, 1, 2, 3, 4
HIT_FLOOR, HIT_POLE, HIT_TUBE, SATURATED, BEYOND_CURRENTS = 5, 6, 7, 8, 9
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
    """State (13,), currents (n,) and memory of the controller; all are advanced."""

    state: Any
    currents: Any
    memory: Any


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
    if inverse.rounds == 0:
        allocate(allocation, outputs, voltages)
        return
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


@njit(**WHOLE)
def _record(row, state, currents, commands, seen, outputs):
    n, m = currents.shape[0], outputs.shape[0]
    row[:STATE] = state
    row[STATE : STATE + n] = currents
    row[STATE + n : STATE + 2 * n] = commands
    row[STATE + 2 * n : STATE + 2 * n + 3] = seen
    row[STATE + 2 * n + 3 : STATE + 2 * n + 3 + m] = outputs


@njit(**WHOLE)
def _sample(period, time, plant, sensing, control_law, signals, state, memory, room, waiting):
    """Sense, compute, allocate, convert: fill waiting (n,), A; whether a limit held anything back."""
    controller, allocation, inverse = control_law
    point, read, seen, v, scratch, outputs, voltages = room
    sensed_point(state, plant.seen_at, point)
    noise, voltage_noise = signals.noise[period], signals.voltage_noise[period]
    see(sensing, point, time, noise, voltage_noise, signals.scans, read, seen)
    v[:3], v[3:6] = signals.references[period], seen
    held = control(controller, v, signals.feedforward[period], memory, scratch, outputs)
    _to_coils(plant, allocation, inverse, seen, outputs, voltages)
    return _command(plant.drives, signals.current_noise[period], voltages, waiting) or held


@njit(**PLAIN_INLINED)
def _move_currents(plant, field, commands, currents, watch):
    """One step of the currents, and the weights if any moved; whether a supply held one back, and whether any moved."""
    superposition = plant.superposition
    held, moved = advance_currents(plant.coils, commands, currents)
    if moved:
        kind, scale, table = superposition.kind, superposition.scale, superposition.table
        watch[WITHIN] = find_weights(kind, scale, table, currents, field[1])
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


@njit(**PLAIN)
def _begin(timing, plant, field, sensing, scans, moving, watch, points):
    """The load at the start and the first scan; the status of the map."""
    superposition, coils = plant.superposition, plant.coils
    state, currents, load = moving
    watch[AT_ONCE] = 1
    for k in range(currents.shape[0]):
        watch[AT_ONCE] &= coils[k, WINDING] == 0.0 and coils[k, AMPLIFIER] == 0.0
    sensed_point(state, plant.seen_at, points[1])
    if sensing.scan[SCAN_TIME] > 0.0:
        instant = timing.step * 1e-9
        watch[SCAN] = add_scans(
            sensing.scan, points[1], points[1], 0.0, instant, 0, scans, sensing.into, sensing.shift
        )
    kind, scale, table = superposition.kind, superposition.scale, superposition.table
    watch[WITHIN] = find_weights(kind, scale, table, currents, field[1])
    return find_load(field, plant.body, state, load)[0]


@njit(**WHOLE)
def _room(plant, currents, memory, m):
    """What a run writes to: the cached field; commands now, the last, those before; two points; arrays of `_sample`."""
    field = keep_field(plant.block, np.empty(int(plant.block[SETS])), int(plant.body[MAGNETS]))
    asked = (currents.copy(), currents.copy(), currents.copy())
    points = (np.empty(3), np.empty(3))
    scratch, voltages = np.empty(memory.shape[0] + m), np.empty(currents.shape[0])
    room = (points[1], np.empty(3), np.empty(3), np.ones(SIGNALS), scratch, np.zeros(m), voltages)
    return field, asked, points, room


@njit(**WHOLE)
def closed_loop(timing, plant, sensing, controller, allocation, inverse, ending, signals, start, rows):
    """Run until the end or an event; (event, mechanical steps done, rows filled, what was ever touched).

    timing, plant, sensing, controller, allocation, inverse, ending, signals, start: `Timing`, `Plant`, `Sensing`,
    `Block`, `Allocation`, `Inverse`, `Ending`, `Signals`, `Moving`. plant.body is overwritten with disturbances.
    """
    h, per_period, every = timing.step, timing.per_period, timing.every
    block, body, loads, scans = plant.block, plant.body, signals.loads, signals.scans
    state, currents, memory = start
    field, asked, points, room = _room(plant, currents, memory, signals.feedforward.shape[1])
    moving, control_law = (state, currents, np.empty(6)), (controller, allocation, inverse)
    watch, row, saturated = np.zeros(4, np.int64), 0, 0
    body[FORCE : FORCE + 6] = loads[0]
    status = _begin(timing, plant, field, sensing, scans, moving, watch, points)
    if status != INSIDE:
        return way_out(block, status, state[POSITION + 2]), 0, 0, 0
    for period in range(signals.references.shape[0]):
        first = period * per_period
        asked[2][:] = asked[1]
        held = _sample(period, first * h, plant, sensing, control_law, signals, state, memory, room, asked[1])
        if loads.shape[0] > 1 and period > 0:
            body[FORCE : FORCE + 6] = loads[period]
            find_load(field, body, state, moving[2])
        if period % every == 0 and row < rows.shape[0]:
            _record(rows[row], state, currents, asked[0], room[2], room[5])
            row += 1
        event, steps, limited = _mechanics(
            first, timing, plant, field, sensing, scans, asked, ending, moving, watch, points
        )
        if event != NOTHING:
            return event, first + steps, row, watch[EVER]
        saturated = saturated + 1 if held or limited else 0
        if ending.longest_saturation > 0 and saturated >= ending.longest_saturation:
            return SATURATED, first + per_period, row, watch[EVER]
    return NOTHING, signals.references.shape[0] * per_period, row, watch[EVER]
