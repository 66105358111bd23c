"""A levitated magnet in closed loop: one run, from sensor to current to motion and back, at two rates.

Every control period: sense, compute, allocate, convert. `delay` mechanical steps later the new currents are asked for.
Every mechanical step: currents move, then the body. docs/theory/dynamics.md (30).

timing: (h, steps per control period, delay in steps, periods from row to row). plant: (block, body, seen_at, iron,
coils, drives): body as in layout, overwritten with disturbances; iron, a tuple, as find_weights takes it; drives (n, 7)
as in fieldmap.kernels.instruments. inverse: of a controller whose outputs are forces, as in fieldmap.kernels.motion.
ending: what ends the run (sum of contacts; longest saturation in periods, 0 for any). signals: references (p, 3),
feedforward (p, m), loads (p or 1, 6: disturbing force and torque), noise (p, 3), voltage_noise (p, 3), current_noise
(p, n), scans (k, 3). start: state (13,), currents (n,), memory of the controller; all are advanced.
rows (r, 13 + 2 n + 3 + m): state, currents, commanded currents, what is seen, outputs.
"""

import numpy as np
from numba import njit

from fieldmap.kernels.instruments import drive
from fieldmap.kernels.map_block import INSIDE, OUTER, SETS
from fieldmap.kernels.motion.allocation import allocate
from fieldmap.kernels.motion.coils import AMPLIFIER, WINDING, advance_currents
from fieldmap.kernels.motion.controller import SIGNALS, control
from fieldmap.kernels.motion.events import BEYOND, BEYOND_CURRENTS, NOTHING, SATURATED, hit, way_out
from fieldmap.kernels.motion.inverse import find_signals
from fieldmap.kernels.motion.layout import FORCE, POSITION, STATE
from fieldmap.kernels.motion.sensing import add_scans, see, sensed_point
from fieldmap.kernels.motion.step import find_load, step_of_two
from fieldmap.kernels.motion.weights import find_weights


@njit(**OUTER)
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


@njit(**OUTER)
def _command(drives, current_noise, voltages, commands):
    """Fill commands (n,), A; whether a converter or amplifier held a voltage back."""
    held = False
    for k in range(commands.shape[0]):
        held |= voltages[k] > drives[k, 2] or voltages[k] < drives[k, 1]
        commands[k] = drive(voltages[k], current_noise[k], drives[k])
    return held


@njit(**OUTER)
def _record(row, state, currents, commands, seen, outputs):
    n, m = currents.shape[0], outputs.shape[0]
    row[:STATE] = state
    row[STATE : STATE + n] = currents
    row[STATE + n : STATE + 2 * n] = commands
    row[STATE + 2 * n : STATE + 2 * n + 3] = seen
    row[STATE + 2 * n + 3 : STATE + 2 * n + 3 + m] = outputs


@njit(**OUTER)
def closed_loop(timing, plant, sensing, controller, allocation, inverse, ending, signals, start, rows):
    """Run until the end or an event; (event, mechanical steps done, rows filled, what was ever touched)."""
    h, per_period, delay, every = timing
    block, body, seen_at, iron, coils, drives = plant
    kind, scale, grid, values, slopes, exponent = iron
    into, shift, _, _, scan = sensing
    references, feedforward, loads, noise, voltage_noise, current_noise, scans = signals
    state, currents, memory = start
    n, m = currents.shape[0], feedforward.shape[1]
    weights, load = np.empty(int(block[SETS])), np.empty(6)
    commands, waiting, late, voltages = currents.copy(), currents.copy(), currents.copy(), np.empty(n)
    outputs, scratch = np.zeros(m), np.empty(memory.shape[0] + m)
    v, seen, read = np.ones(SIGNALS), np.empty(3), np.empty(3)
    point, before = np.empty(3), np.empty(3)
    near, room = np.empty(6), np.empty(6)
    scanning = scan[0] > 0.0
    at_once = True
    for k in range(n):
        at_once &= coils[k, WINDING] == 0.0 and coils[k, AMPLIFIER] == 0.0

    sensed_point(state, seen_at, point)
    next_scan, row, saturated, ever = 0, 0, 0, 0
    if scanning:
        next_scan = add_scans(scan, point, point, 0.0, h * 1e-9, 0, scans, into, shift)
    find_weights(kind, scale, grid, values, slopes, exponent, currents, near, room, weights)
    body[FORCE : FORCE + 6] = loads[0]
    status, touched = find_load(block, 0, weights, body, state, load)
    if status != INSIDE:
        return way_out(block, status, state[POSITION + 2]), 0, row, ever

    for period in range(references.shape[0]):
        first = period * per_period
        sensed_point(state, seen_at, point)
        see(sensing, point, first * h, noise[period], voltage_noise[period], scans, read, seen)
        v[:3], v[3:6] = references[period], seen
        late[:] = waiting
        held = control(controller, v, feedforward[period], memory, scratch, outputs)
        _to_coils(plant, allocation, inverse, seen, outputs, voltages)
        held |= _command(drives, current_noise[period], voltages, waiting)
        if loads.shape[0] > 1 and period > 0:
            for k in range(6):
                body[FORCE + k] = loads[period, k]
            find_load(block, 0, weights, body, state, load)
        if period % every == 0 and row < rows.shape[0]:
            _record(rows[row], state, currents, commands, seen, outputs)
            row += 1
        for step in range(per_period):
            if step == delay or (step == 0 and delay == per_period):
                commands[:] = late if delay == per_period else waiting
                if at_once:
                    advance_currents(coils, commands, currents)
                    find_weights(kind, scale, grid, values, slopes, exponent, currents, near, room, weights)
                    find_load(block, 0, weights, body, state, load)
            held |= advance_currents(coils, commands, currents)
            if not find_weights(kind, scale, grid, values, slopes, exponent, currents, near, room, weights):
                ever |= BEYOND
                if ending[0] & BEYOND:
                    return BEYOND_CURRENTS, first + step, row, ever
            if scanning:
                sensed_point(state, seen_at, before)
            status, touched = step_of_two(block, 0, weights, body, state, load, h)
            ever |= touched
            if status != INSIDE:
                return way_out(block, status, state[POSITION + 2]), first + step + 1, row, ever
            event = hit(touched, ending[0])
            if event != NOTHING:
                return event, first + step + 1, row, ever
            if scanning:
                sensed_point(state, seen_at, point)
                next_scan = add_scans(
                    scan, before, point, (first + step) * h, h, next_scan, scans, into, shift
                )
        saturated = saturated + 1 if held else 0
        if ending[1] > 0 and saturated >= ending[1]:
            return SATURATED, first + per_period, row, ever
    return NOTHING, references.shape[0] * per_period, row, ever
