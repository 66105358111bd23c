"""What the controller sees of a moving body: sensors along their own axes, scanned, with noise, through converters.

docs/theory/control.md has the equations of the measuring chain.
"""

import math
from typing import Any, NamedTuple

from fieldmap.kernels.compilation import njit
from fieldmap.kernels.control.instruments import measure
from fieldmap.kernels.map.map_block import PLAIN
from fieldmap.kernels.motion.layout import POSITION
from fieldmap.kernels.motion.rotation import to_map, turn_matrix

# Of scan (5,): time from scan to scan, s (0: no scanning, the sensor shows what is at the moment of sampling), scans by
# which a mean comes late, scans whose mean each of the three shows.
SCAN_TIME, LATENCY, AVERAGES = 0, 1, 2


class Sensing(NamedTuple):
    """into (3, 3), shift (3,): an ideal sensor reads into p + shift; chains (3, 10): as in
    fieldmap.kernels.control.instruments, positions in readings; back (3, 3): the inverse of into; scan (5,)."""

    into: Any
    shift: Any
    chains: Any
    back: Any
    scan: Any


@njit(**PLAIN)
def sensed_point(state, seen_at, out):
    """out (3,): where the point of the body that is seen lies in the map."""
    arm = to_map(turn_matrix(state), seen_at[0], seen_at[1], seen_at[2])
    for k in range(3):
        out[k] = state[POSITION + k] + arm[k]


@njit(**PLAIN)
def add_scans(scan, before, after, start, h, first, scans, into, shift):
    """Add to scans (m, 3), which hold noise, what sensors see between start and start + h; the number of the next.

    before, after (3,): the sensed point at both ends; first: number of the next scan. Number k is taken at
    k scan[SCAN_TIME].
    """
    k = first
    while k < scans.shape[0] and k * scan[SCAN_TIME] <= start + h + 1e-12:
        share = (k * scan[SCAN_TIME] - start) / h
        for i in range(3):
            value = shift[i]
            for j in range(3):
                value += into[i, j] * (before[j] + share * (after[j] - before[j]))
            scans[k, i] += value
        k += 1
    return k


@njit(**PLAIN)
def shown(scan, time, scans, axis):
    """What a scanning sensor shows at a time: as fieldmap.kernels.control.instruments.held_scans."""
    averages, latency = int(scan[AVERAGES + axis]), int(scan[LATENCY])
    last = math.floor(time / scan[SCAN_TIME] + 1e-9) - latency
    last = min(last - (last + 1) % averages, scans.shape[0] - 1)
    if last < averages - 1:
        return scans[0, axis]
    total = 0.0
    for n in range(last - averages + 1, last + 1):
        total += scans[n, axis]
    return total / averages


@njit(**PLAIN)
def see(sensing, point, time, noise, voltage_noise, scans, read, out):
    """out (3,): the position that the controller sees of the sensed point (3,). noise, voltage_noise (3,)."""
    into, shift, chains, back, scan = sensing
    for i in range(3):
        if scan[SCAN_TIME] > 0.0:
            value = shown(scan, time, scans, i)
        else:
            value = shift[i] + noise[i]
            for j in range(3):
                value += into[i, j] * point[j]
        read[i] = measure(value, voltage_noise[i], chains[i]) - shift[i]
    for i in range(3):
        out[i] = back[i, 0] * read[0] + back[i, 1] * read[1] + back[i, 2] * read[2]
