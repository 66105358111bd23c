"""The interpolants, by the kind of a map's block.

An interpolant is a module with `KERNELS`; one line here makes it known. The number of its line is the KIND of its
blocks: it must not change, because files for C programs hold it. After an edit here numba must compile again what was
compiled with the old list: remove the __pycache__ of fieldmap/kernels/map and fieldmap/kernels/motion.
"""

from collections.abc import Callable, Sequence
from typing import Any

from fieldmap.kernels.compilation import njit
from fieldmap.kernels.map import cell_harmonics, global_harmonics, hermite
from fieldmap.kernels.map.map_block import INLINED_EARLY, KIND, InterpolantKernels

KERNELS: tuple[InterpolantKernels, ...] = (
    hermite.KERNELS,
    cell_harmonics.KERNELS,
    global_harmonics.KERNELS,
)


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
