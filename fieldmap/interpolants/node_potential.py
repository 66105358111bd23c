"""The scalar potential at the nodes of a map, by integrating the field along the grid's lines."""

import numpy as np

from fieldmap.store import MapData
from fieldmap.typing import Array


def node_potential(data: MapData) -> Array:
    """V (n_coils, nx, ny, nz) in T m/A with grad V = B, zero at the middle node.

    Along x through the first node, along y from there, then along z: trapezoid with the correction of its end
    slopes (Euler and Maclaurin; docs/theory/lookup.md (10)), error O(spacing^4). Different ways round a cell
    agree to that order because B is curl-free.
    """
    steps = [_steps(data, axis) for axis in range(3)]
    along_x = _sums(steps[0][:, :, :1, :1], 1)
    along_y = _sums(steps[1][:, :, :, :1], 2)
    potential = along_x + along_y + _sums(steps[2], 3)
    nx, ny, nz = (n // 2 for n in data.grid.shape)
    return potential - potential[:, nx : nx + 1, ny : ny + 1, nz : nz + 1]


def _steps(data: MapData, axis: int) -> Array:
    """Integral of B over every edge along an axis."""
    h = data.grid.spacing[axis]
    value = np.moveaxis(data.flux_density[..., axis], 1 + axis, 0)
    slope = np.moveaxis(data.gradient[..., axis, axis], 1 + axis, 0)
    step = h / 2 * (value[:-1] + value[1:]) + h * h / 12 * (slope[:-1] - slope[1:])
    return np.moveaxis(step, 0, 1 + axis)


def _sums(steps: Array, axis: int) -> Array:
    """Running sums that start at zero."""
    zero = np.zeros_like(np.take(steps, [0], axis=axis))
    return np.concatenate([zero, np.cumsum(steps, axis=axis)], axis=axis)
