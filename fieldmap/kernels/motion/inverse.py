"""The inverse map: the outputs of a controller that put a wanted force on the magnet, by Newton's method.

docs/theory/dynamics.md (38).
"""

from typing import Any, NamedTuple

import numpy as np

from fieldmap.kernels.compilation import njit
from fieldmap.kernels.control.instruments import GAIN, OFFSET
from fieldmap.kernels.copy_vector import copy_vector
from fieldmap.kernels.map.cached_field import forget, keep_field
from fieldmap.kernels.map.map_block import INSIDE, PLAIN, SETS, WHOLE
from fieldmap.kernels.motion.currents import allocate, find_weights
from fieldmap.kernels.motion.layout import POSITION
from fieldmap.kernels.motion.magnet import field_points, magnet_wrench


class Inverse(NamedTuple):
    """rounds: how many a sample is given; limits (2, 3) of the outputs; signals (3,): those of the last sample, where
    the search begins and what it leaves behind; believed (13,): the state whose turn is taken for the body's, its
    place filled in."""

    rounds: int
    limits: Any
    signals: Any
    believed: Any


@njit(**PLAIN)
def _force(plant, field, allocation, signals, state, currents, load):
    """Fill load[:3] with the magnet's force, N; False outside the map."""
    drives, superposition = plant.drives, plant.superposition
    allocate(allocation, signals, currents)
    for k in range(currents.shape[0]):
        currents[k] = drives[k, GAIN] * currents[k] + drives[k, OFFSET]
    kind, scale, table, iron = superposition
    find_weights(kind, scale, table, iron, currents, field[1])
    forget(field)
    return magnet_wrench(field, plant.body, state, load) == INSIDE


@njit(**PLAIN)
def _solve(J, r, out):
    """out (3,) = J^-1 r by Cramer's rule; False for a matrix without inverse."""
    a = J[1, 1] * J[2, 2] - J[1, 2] * J[2, 1]
    b = J[1, 2] * J[2, 0] - J[1, 0] * J[2, 2]
    c = J[1, 0] * J[2, 1] - J[1, 1] * J[2, 0]
    d = J[0, 0] * a + J[0, 1] * b + J[0, 2] * c
    if d == 0.0:
        return False
    out[0] = (
        a * r[0]
        + (J[0, 2] * J[2, 1] - J[0, 1] * J[2, 2]) * r[1]
        + (J[0, 1] * J[1, 2] - J[0, 2] * J[1, 1]) * r[2]
    ) / d
    out[1] = (
        b * r[0]
        + (J[0, 0] * J[2, 2] - J[0, 2] * J[2, 0]) * r[1]
        + (J[0, 2] * J[1, 0] - J[0, 0] * J[1, 2]) * r[2]
    ) / d
    out[2] = (
        c * r[0]
        + (J[0, 1] * J[2, 0] - J[0, 0] * J[2, 1]) * r[1]
        + (J[0, 0] * J[1, 1] - J[0, 1] * J[1, 0]) * r[2]
    ) / d
    return True


@njit(**WHOLE)
def find_signals(plant, allocation, wanted, inverse):
    """Change signals (3,) so that the magnet at `believed` feels the force wanted (3,), N; what is left of it, N.

    Every round takes the slopes anew, by one-sided differences of 1e-4 of the limits' span. Signals stay within their
    limits; where those do not give the force, what is left says so. NaN outside the map.
    """
    rounds, limits, signals, believed = inverse
    field = keep_field(plant.block, np.empty(int(plant.block[SETS])), field_points(plant.body))
    currents = np.empty(plant.drives.shape[0])
    load, moved, left, step = np.empty(6), np.empty(3), np.empty(3), np.empty(3)
    J = np.empty((3, 3))
    for turn in range(rounds + 1):
        if not _force(plant, field, allocation, signals, believed, currents, load):
            return np.nan
        for i in range(3):
            left[i] = wanted[i] - load[i]
        if turn == rounds or max(abs(left[0]), abs(left[1]), abs(left[2])) < 1e-12:
            break
        for j in range(3):
            copy_vector(signals, moved)
            ds = 1e-4 * (limits[1, j] - limits[0, j])
            moved[j] += ds
            _force(plant, field, allocation, moved, believed, currents, load)
            for i in range(3):
                J[i, j] = (load[i] - wanted[i] + left[i]) / ds
        if not _solve(J, left, step):
            break
        for j in range(3):
            signals[j] = min(max(signals[j] + step[j], limits[0, j]), limits[1, j])
    return max(abs(left[0]), abs(left[1]), abs(left[2]))


@njit(**WHOLE)
def signals_along(plant, allocation, inverse, positions, forces, found, left):
    """Fill found (p, 3): the outputs at which the magnet of a body at positions (p, 3) feels forces (p, 3), N, each
    search beginning where the last ended; and left (p,), N."""
    signals, believed = inverse.signals, inverse.believed
    for p in range(positions.shape[0]):
        copy_vector(positions[p], believed[POSITION : POSITION + 3])
        left[p] = find_signals(plant, allocation, forces[p], inverse)
        copy_vector(signals, found[p])
