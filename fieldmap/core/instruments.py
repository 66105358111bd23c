"""Sensors, converters and amplifiers as the C core simulates them (fieldmap/core/instruments.h), sample by sample.

The numbers of an instrument are one of these tuples, or an array in the order of its fields. Signals are float64
vectors in C order; any other array raises TypeError.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.core.library import LIBRARY
from fieldmap.typing import Array


class Chain(NamedTuple):
    """From a position to the position that the controller reads; ideal unless given. A step of 0 does not round.

    zero: position at 0 V, m; scale: m/V; step and limits of the sensor's output, V; gain error (relative) and offset
    error (V) of the converter, its step and limits, V.
    """

    zero: float = 0.0
    scale: float = 1.0
    sensor_step: float = 0.0
    sensor_lower: float = -math.inf
    sensor_upper: float = math.inf
    gain_error: float = 0.0
    offset_error: float = 0.0
    input_step: float = 0.0
    input_lower: float = -math.inf
    input_upper: float = math.inf


class Drive(NamedTuple):
    """From a voltage of the controller to a current; ideal unless given. A step of 0 does not round.

    step and limits of the converter, V; gain, A/V, and offset, A, of the amplifier, and limits of the current, A.
    """

    output_step: float = 0.0
    lower: float = -math.inf
    upper: float = math.inf
    gain: float = 1.0
    offset: float = 0.0
    current_lower: float = -math.inf
    current_upper: float = math.inf


def measure_all(positions: Array, voltage_noise: Array, chain: ArrayLike, out: Array) -> None:
    """Fill out (n,): the positions that a controller reads. Noise of the sensor, m, is in `positions` already."""
    LIBRARY.measure_all(positions, voltage_noise, np.array(chain, float), out)


def drive_all(voltages: Array, current_noise: Array, drive: ArrayLike, out: Array) -> None:
    """Fill out (n,): the currents that flow for voltages of a controller."""
    LIBRARY.drive_all(voltages, current_noise, np.array(drive, float), out)


def held_scans(scans: Array, averages: int, latency: int, ratio: float, out: Array) -> None:
    """Fill out (n,) with the reading of a scanning sensor at each sample: the mean of its last `averages` scans,
    delayed by `latency` scans, and held.

    scans (m,): readings, one per scan. ratio: scans per sample; sample k is taken k * ratio scan times after the
    start. Before the first mean is available, the reading is the first scan.
    """
    LIBRARY.held_scans(scans, averages, latency, ratio, out)
