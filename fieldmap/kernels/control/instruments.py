"""A position through sensor and converter, and a voltage through converter and amplifier, one sample at a time.

Each chain is a row of numbers, so that chains of several axes and drives of n coils are arrays. A step of 0 does not
round. docs/theory/control.md (8)..(10).
"""

import math

from fieldmap.kernels.compilation import njit

# A measuring chain (10,): position at 0 V (m), scale (m/V), step and limits of the sensor's output (V), gain and offset
# error of the converter (relative, V), its step and limits (V).
ZERO, SCALE, SENSOR_STEP, SENSOR_LOWER, SENSOR_UPPER = 0, 1, 2, 3, 4
GAIN_ERROR, OFFSET_ERROR, INPUT_STEP, INPUT_LOWER, INPUT_UPPER = 5, 6, 7, 8, 9
CHAIN = 10
# A drive (7,): step and limits of the converter (V), gain (A/V) and offset (A) of the amplifier, limits of the
# current (A).
OUTPUT_STEP, LOWER, UPPER, GAIN, OFFSET, CURRENT_LOWER, CURRENT_UPPER = 0, 1, 2, 3, 4, 5, 6
DRIVE = 7


@njit
def round_to_step(value, step):
    """The nearest multiple of a step; halves up."""
    return value if step == 0.0 else step * math.floor(value / step + 0.5)


@njit
def convert(value, step, lower, upper):
    """An ideal converter: limits, then rounds."""
    return round_to_step(min(max(value, lower), upper), step)


@njit
def measure(position, voltage_noise, chain):
    """The position that the controller sees. Noise of the sensor is in `position` already."""
    volts = (position - chain[ZERO]) / chain[SCALE]
    sensed = convert(volts, chain[SENSOR_STEP], chain[SENSOR_LOWER], chain[SENSOR_UPPER])
    disturbed = sensed * (1.0 + chain[GAIN_ERROR]) + chain[OFFSET_ERROR] + voltage_noise
    return chain[ZERO] + chain[SCALE] * convert(
        disturbed, chain[INPUT_STEP], chain[INPUT_LOWER], chain[INPUT_UPPER]
    )


@njit
def drive(voltage, current_noise, numbers):
    """The current that flows for a voltage of the controller."""
    shown = convert(voltage, numbers[OUTPUT_STEP], numbers[LOWER], numbers[UPPER])
    current = numbers[GAIN] * shown + numbers[OFFSET] + current_noise
    return min(max(current, numbers[CURRENT_LOWER]), numbers[CURRENT_UPPER])


@njit
def measure_all(positions, voltage_noise, chain, out):
    """`measure` for every sample."""
    for n in range(positions.shape[0]):
        out[n] = measure(positions[n], voltage_noise[n], chain)


@njit
def drive_all(voltages, current_noise, numbers, out):
    """`drive` for every sample."""
    for n in range(voltages.shape[0]):
        out[n] = drive(voltages[n], current_noise[n], numbers)


@njit
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
