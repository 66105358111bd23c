"""A map's field along a path: what a point needs is superposed once and kept while neither cell nor weights change.

field: (block, weights, places, numbers): a map's coefficients, the weights of its sets, and for each of q points the
cell whose coefficients lie in its row of numbers (q, n), -1 for none. `forget` after any change of the weights.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fieldmap.kernels.compilation import njit
from fieldmap.kernels.map.lookup import KERNELS, of_kind
from fieldmap.kernels.map.map_block import (
    INSIDE,
    PLAIN_INLINED,
    WHOLE,
    InterpolantKernels,
    cell_number,
    locate,
)

NAN = np.nan
_cell_size = of_kind("cell_size")


@njit
def keep_field(block, weights, count):
    """A field of `count` points, nothing kept yet."""
    places = np.empty(count, np.int64)
    places[:] = -1
    return block, weights, places, np.empty((count, _cell_size(block, ())))


@njit(**PLAIN_INLINED, forceinline=True)
def forget(field):
    """The weights have changed."""
    places = field[2]
    for p in range(places.shape[0]):
        places[p] = -1


def kept_in(kernels: Sequence[InterpolantKernels]) -> Callable[..., Any]:
    """`kept_at` of these interpolants."""
    gather, gathered = of_kind("gather", kernels), of_kind("gathered", kernels)

    # Without caches of their own: they are compiled into what calls them.
    @njit(**WHOLE, cache=False)
    def superpose_all(block, weights, i, j, k, out):
        gather(block, (weights, i, j, k, out))

    @njit(**PLAIN_INLINED, cache=False, forceinline=True)
    def kept(field, p, x, y, z):
        block, weights, places, numbers = field
        status, i, j, k, tx, ty, tz = locate(block, x, y, z)
        if status != INSIDE:
            return status, (NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN)
        place = cell_number(block, i, j, k)
        kept = numbers[p]
        if places[p] != place:
            superpose_all(block, weights, i, j, k, kept)
            places[p] = place
        return status, gathered(block, (kept, tx, ty, tz))

    return kept


kept_at = kept_in(KERNELS)
"""`kept_at(field, p, x, y, z)`: (status, the three of the field, the nine of its gradient), for point number p at x, y,
z, of any interpolant."""
