"""A position through sensor and converter, and a voltage through converter and amplifier, one sample at a time.

chain: zero (m at 0 V), scale (m/V), sensor step, lower and upper limit (V), gain and offset error of the converter
(relative, V), converter step, lower and upper limit (V). drive: converter step, lower and upper limit (V), gain (A/V),
offset (A), lower and upper limit (A). A step of 0 does not round.
"""

import math

from numba import njit


@njit(cache=True)
def round_to_step(value, step):
    """The nearest multiple of a step; halves up."""
    return value if step == 0.0 else step * math.floor(value / step + 0.5)


@njit(cache=True)
def convert(value, step, lower, upper):
    """An ideal converter: limits, then rounds."""
    return round_to_step(min(max(value, lower), upper), step)


@njit(cache=True)
def measure(position, voltage_noise, chain):
    """The position that the controller sees. Noise of the sensor is in `position` already."""
    sensed = convert((position - chain[0]) / chain[1], chain[2], chain[3], chain[4])
    disturbed = sensed * (1.0 + chain[5]) + chain[6] + voltage_noise
    return chain[0] + chain[1] * convert(disturbed, chain[7], chain[8], chain[9])


@njit(cache=True)
def drive(voltage, current_noise, numbers):
    """The current that flows for a voltage of the controller."""
    current = numbers[3] * convert(voltage, numbers[0], numbers[1], numbers[2]) + numbers[4] + current_noise
    return min(max(current, numbers[5]), numbers[6])


@njit(cache=True)
def measure_all(positions, voltage_noise, chain, out):
    """`measure` for every sample."""
    for n in range(positions.shape[0]):
        out[n] = measure(positions[n], voltage_noise[n], chain)


@njit(cache=True)
def drive_all(voltages, current_noise, numbers, out):
    """`drive` for every sample."""
    for n in range(voltages.shape[0]):
        out[n] = drive(voltages[n], current_noise[n], numbers)


@njit(cache=True)
def held_scans(scans, averages, latency, ratio, out):
    """What a scanning sensor shows at each sample: the mean of its last scans, known `latency` scans late, held.

    scans (n,): readings, one per scan. ratio: scans per sample; sample m is taken at scan time m * ratio. Before the
    first mean is known, the first scan is shown.
    """
    for m in range(out.shape[0]):
        last = math.floor(m * ratio + 1e-9) - latency
        last = min(last - (last + 1) % averages, scans.shape[0] - 1)
        if last < averages - 1:
            out[m] = scans[0]
            continue
        total = 0.0
        for n in range(last - averages + 1, last + 1):
            total += scans[n]
        out[m] = total / averages
