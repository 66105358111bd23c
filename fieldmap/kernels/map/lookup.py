"""Lookups in a map's block: the interpolants, by the kind of the block, and loops over points.

An interpolant is a module with `KERNELS`; one line here makes it known. The number of its line is the KIND of its
blocks: it must not change, because files for C programs hold it. After an edit here numba must compile again what was
compiled with the old list: remove the __pycache__ of fieldmap/kernels/map and fieldmap/kernels/motion.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.map import cell_harmonics, global_harmonics, hermite
from fieldmap.kernels.map.map_block import (
    INLINED,
    INLINED_EARLY,
    INSIDE,
    KIND,
    OUTER,
    OUTSIDE,
    InterpolantKernels,
    locate,
)

KERNELS: tuple[InterpolantKernels, ...] = (
    hermite.KERNELS,
    cell_harmonics.KERNELS,
    global_harmonics.KERNELS,
)
NAN = np.nan


def of_kind(name: str, among: Sequence[InterpolantKernels] = KERNELS) -> Callable[..., Any]:
    """A kernel (block, given) that calls the kernel `name` of the block's interpolant with the block and `given`, a
    tuple. Inlined before types are known: its kernels are compiled in what calls it, and not here before."""
    chosen = _first_kind(getattr(among[0], name))
    for kind in range(len(among) - 1, 0, -1):
        chosen = _if_kind(kind, getattr(among[kind], name), chosen)
    return chosen


def _first_kind(kernel: Callable[..., Any]) -> Callable[..., Any]:
    # Without a cache of its own: it is compiled into what calls it.
    @njit(**INLINED_EARLY, cache=False)
    def chosen(block, given):
        return kernel(block, *given)

    return chosen


def _if_kind(kind: int, kernel: Callable[..., Any], other: Callable[..., Any]) -> Callable[..., Any]:
    @njit(**INLINED_EARLY, cache=False)
    def chosen(block, given):
        if block[KIND] == kind:
            return kernel(block, *given)
        return other(block, given)

    return chosen


def _superposed_of_kind() -> Callable[..., Any]:
    """As `of_kind("superposed")`, its arguments spelled out: numba does not inline what is called with *arguments, and
    `fieldmap.kernels.map.map_block.INLINED_EARLY` asks for it."""
    chosen = KERNELS[0].superposed
    for kind in range(len(KERNELS) - 1, 0, -1):
        chosen = _if_kind_superposed(kind, KERNELS[kind].superposed, chosen)
    return chosen


def _if_kind_superposed(
    kind: int, kernel: Callable[..., Any], other: Callable[..., Any]
) -> Callable[..., Any]:
    @njit(**INLINED_EARLY, cache=False)
    def chosen(block, weights, i, j, k, tx, ty, tz):
        if block[KIND] == kind:
            return kernel(block, weights, i, j, k, tx, ty, tz)
        return other(block, weights, i, j, k, tx, ty, tz)

    return chosen


_contracted, _superposed, _unit = of_kind("contracted"), _superposed_of_kind(), of_kind("unit")


@inlined(**INLINED)
def contracted_at(block, x, y, z):
    """(status, the three of the field, the nine of its gradient) from a block at given currents."""
    status, i, j, k, tx, ty, tz = locate(block, x, y, z)
    if status != INSIDE:
        return status, (NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN)
    return status, _contracted(block, (i, j, k, tx, ty, tz))


@njit(**INLINED_EARLY)
def superposed_at(block, currents, x, y, z):
    """As `contracted_at`, from a block with a set per coil and the currents (n_coils,)."""
    status, i, j, k, tx, ty, tz = locate(block, x, y, z)
    if status != INSIDE:
        return status, (NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN)
    return status, _superposed(block, currents, i, j, k, tx, ty, tz)


@inlined(**INLINED)
def _store(values, flux, slope):
    """Write the three and, unless slope is empty, the nine."""
    flux[0], flux[1], flux[2] = values[0], values[1], values[2]
    if slope.shape[0]:
        slope[0, 0], slope[0, 1], slope[0, 2] = values[3], values[4], values[5]
        slope[1, 0], slope[1, 1], slope[1, 2] = values[6], values[7], values[8]
        slope[2, 0], slope[2, 1], slope[2, 2] = values[9], values[10], values[11]


@njit(**OUTER)
def evaluate_units(block, points, flux, slope):
    """flux (n, n_coils, 3) and slope (n, n_coils, 3, 3) of every set by itself. Returns how many lie outside."""
    outside = 0
    for p in range(points.shape[0]):
        status, i, j, k, tx, ty, tz = locate(block, points[p, 0], points[p, 1], points[p, 2])
        outside += status == OUTSIDE
        if status != INSIDE:
            flux[p] = NAN
            slope[p] = NAN
            continue
        for s in range(flux.shape[1]):
            _store(_unit(block, (s, i, j, k, tx, ty, tz)), flux[p, s], slope[p, s])
    return outside


@njit(**OUTER)
def at(data, x, y, z):
    """((Bx, By, Bz), ((dBx/dx, dBx/dy, dBx/dz), ...)) at one point: for compiled callers."""
    v = contracted_at(data, x, y, z)[1]
    return (v[0], v[1], v[2]), ((v[3], v[4], v[5]), (v[6], v[7], v[8]), (v[9], v[10], v[11]))


@njit(**OUTER)
def at_currents(data, currents, x, y, z):
    """As `at`, for currents (n_coils,) that change from call to call."""
    v = superposed_at(data, currents, x, y, z)[1]
    return (v[0], v[1], v[2]), ((v[3], v[4], v[5]), (v[6], v[7], v[8]), (v[9], v[10], v[11]))
