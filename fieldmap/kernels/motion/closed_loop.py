"""A levitated magnet in closed loop: one run, from sensor to current to motion and back, at two rates.

Every control period: sense, compute, allocate, convert. `delay` mechanical steps later the new currents are asked for.
Every mechanical step: currents move, then the body. docs/theory/dynamics.md (30).

timing: (h, steps per control period, delay in steps, periods from row to row). plant: (block, body, seen_at, iron,
coils, drives): body as in layout, overwritten with disturbances; iron, a tuple, as find_weights takes it; drives (n, 7)
as in fieldmap.kernels.control.instruments. inverse: of a controller whose outputs are forces, as in
fieldmap.kernels.motion. ending: what ends the run (sum of contacts; longest saturation in periods, 0 for any).
signals: references (p, 3),
feedforward (p, m), loads (p or 1, 6: disturbing force and torque), noise (p, 3), voltage_noise (p, 3), current_noise
(p, n), scans (k, 3). start: state (13,), currents (n,), memory of the controller; all are advanced.
rows (r, 13 + 2 n + 3 + m): state, currents, commanded currents, what is seen, outputs.
"""

import numpy as np
from numba import njit

from fieldmap.kernels.control.instruments import drive
from fieldmap.kernels.map.cached_field import forget, keep_field
from fieldmap.kernels.map.map_block import INSIDE, PLAIN, PLAIN_INLINED, SETS, WHOLE
from fieldmap.kernels.motion.allocation import allocate
from fieldmap.kernels.motion.coils import AMPLIFIER, WINDING, advance_currents
from fieldmap.kernels.motion.controller import SIGNALS, control
from fieldmap.kernels.motion.events import BEYOND, BEYOND_CURRENTS, NOTHING, SATURATED, hit, way_out
from fieldmap.kernels.motion.inverse import find_signals
from fieldmap.kernels.motion.layout import FORCE, MAGNETS, POSITION, STATE
from fieldmap.kernels.motion.sensing import add_scans, see, sensed_point
from fieldmap.kernels.motion.step import find_load, step_of_two
from fieldmap.kernels.motion.weights import find_weights

# What a run remembers from step to step: number of the next scan, what was ever touched, whether the currents lie
# within the table of the iron, whether currents follow their commands at once.
SCAN, EVER, WITHIN, AT_ONCE = 0, 1, 2, 3


@njit(**WHOLE)
def _to_coils(plant, allocation, inverse, seen, outputs, voltages):
    """Fill voltages (n,) of the coils: from the outputs, or from the forces that they are at the place that is seen."""
    if inverse[0] == 0:
        allocate(allocation, outputs, voltages)
        return
    believed, point = inverse[3], np.empty(3)
    sensed_point(believed, plant[2], point)
    for k in range(3):
        believed[POSITION + k] += seen[k] - point[k]
    find_signals(plant, allocation, outputs, inverse)
    allocate(allocation, inverse[2], voltages)


@njit(**PLAIN)
def _command(drives, current_noise, voltages, commands):
    """Fill commands (n,), A; whether a converter or amplifier held a voltage back."""
    held = False
    for k in range(commands.shape[0]):
        held |= voltages[k] > drives[k, 2] or voltages[k] < drives[k, 1]
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
    references, feedforward, _, noise, voltage_noise, current_noise, scans = signals
    point, read, seen, v, scratch, outputs, voltages = room
    sensed_point(state, plant[2], point)
    see(sensing, point, time, noise[period], voltage_noise[period], scans, read, seen)
    v[:3], v[3:6] = references[period], seen
    held = control(controller, v, feedforward[period], memory, scratch, outputs)
    _to_coils(plant, allocation, inverse, seen, outputs, voltages)
    return _command(plant[5], current_noise[period], voltages, waiting) or held


@njit(**PLAIN_INLINED)
def _move_currents(plant, field, commands, currents, watch):
    """One step of the currents, and the weights if any moved; whether a supply held one back, and whether any moved."""
    iron, coils = plant[3], plant[4]
    held, moved = advance_currents(coils, commands, currents)
    if moved:
        watch[WITHIN] = find_weights(iron[0], iron[1], iron[2], currents, field[1])
        forget(field)
    return held, moved


@njit(**PLAIN)
def _mechanics(first, timing, plant, field, sensing, scans, asked, ending, moving, watch, points):
    """The steps of one control period, of which the first has number `first`: (event, steps done, whether a supply held
    a current back). asked: commands now, the last and those before, (n,) each; moving: state, currents, load."""
    h, per_period, delay, _ = timing
    block, body, seen_at, _, _, _ = plant
    commands, waiting, late = asked
    state, currents, load = moving
    before, point = points
    held, scanning = False, sensing[4][0] > 0.0
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
            if ending[0] & BEYOND:
                return BEYOND_CURRENTS, step, held
        if scanning:
            sensed_point(state, seen_at, before)
        status, touched = step_of_two(field, body, state, load, h)
        watch[EVER] |= touched
        if status != INSIDE:
            return way_out(block, status, state[POSITION + 2]), step + 1, held
        event = hit(touched, ending[0])
        if event != NOTHING:
            return event, step + 1, held
        if scanning:
            sensed_point(state, seen_at, point)
            start = (first + step) * h
            into, shift, scan = sensing[0], sensing[1], sensing[4]
            watch[SCAN] = add_scans(scan, before, point, start, h, watch[SCAN], scans, into, shift)
    return NOTHING, per_period, held


@njit(**PLAIN)
def _begin(timing, plant, field, sensing, scans, moving, watch, points):
    """The load at the start and the first scan; the status of the map."""
    _, body, seen_at, iron, coils, _ = plant
    state, currents, load = moving
    watch[AT_ONCE] = 1
    for k in range(currents.shape[0]):
        watch[AT_ONCE] &= coils[k, WINDING] == 0.0 and coils[k, AMPLIFIER] == 0.0
    into, shift, scan = sensing[0], sensing[1], sensing[4]
    sensed_point(state, seen_at, points[1])
    if scan[0] > 0.0:
        watch[SCAN] = add_scans(scan, points[1], points[1], 0.0, timing[0] * 1e-9, 0, scans, into, shift)
    watch[WITHIN] = find_weights(iron[0], iron[1], iron[2], currents, field[1])
    return find_load(field, body, state, load)[0]


@njit(**WHOLE)
def _room(plant, currents, memory, m):
    """What a run writes to: the kept field; commands now, the last, those before; two points; what `_sample` takes."""
    field = keep_field(plant[0], np.empty(int(plant[0][SETS])), int(plant[1][MAGNETS]))
    asked = (currents.copy(), currents.copy(), currents.copy())
    points = (np.empty(3), np.empty(3))
    scratch, voltages = np.empty(memory.shape[0] + m), np.empty(currents.shape[0])
    room = (points[1], np.empty(3), np.empty(3), np.ones(SIGNALS), scratch, np.zeros(m), voltages)
    return field, asked, points, room


@njit(**WHOLE)
def closed_loop(timing, plant, sensing, controller, allocation, inverse, ending, signals, start, rows):
    """Run until the end or an event; (event, mechanical steps done, rows filled, what was ever touched)."""
    h, per_period, _, every = timing
    block, body, loads, scans = plant[0], plant[1], signals[2], signals[6]
    state, currents, memory = start
    field, asked, points, room = _room(plant, currents, memory, signals[1].shape[1])
    moving, control_law = (state, currents, np.empty(6)), (controller, allocation, inverse)
    watch, row, saturated = np.zeros(4, np.int64), 0, 0
    body[FORCE : FORCE + 6] = loads[0]
    status = _begin(timing, plant, field, sensing, scans, moving, watch, points)
    if status != INSIDE:
        return way_out(block, status, state[POSITION + 2]), 0, 0, 0
    for period in range(signals[0].shape[0]):
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
        if ending[1] > 0 and saturated >= ending[1]:
            return SATURATED, first + per_period, row, watch[EVER]
    return NOTHING, signals[0].shape[0] * per_period, row, watch[EVER]
