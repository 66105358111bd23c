"""Force and torque on a point dipole at one point of a map, docs/theory/wrench.md (1) and (2), in one call from Python.

A call from Python costs as much as what it computes, most of it for its arrays: these kernels take no more than they
need, and write nothing but the wrench.
"""

from typing import Any

import numpy as np

from fieldmap.kernels.compilation import njit
from fieldmap.kernels.map.lookup import contracted_at, superposed_at
from fieldmap.kernels.map.map_block import OUTER, SETS, WRONG_SHAPE

# Without contraction of products and sums: the same bits as the array code of fieldmap.field.dipole_wrench.
_EXACT: dict[str, Any] = {"_nrt": False}
# The interpreter's lock is kept, as in `fieldmap.kernels.map.lookup.evaluate_one`.
_ALONE: dict[str, Any] = {**OUTER, "nogil": False}


@njit(**_EXACT)
def _store_wrench(values, moment, wrench):
    """F = (grad B)^T m and T = m x B from the three of the field and the nine of its gradient."""
    a, b, c = moment[0], moment[1], moment[2]
    for j in range(3):
        wrench[j] = values[3 + j] * a + values[6 + j] * b + values[9 + j] * c
    wrench[3] = b * values[2] - c * values[1]
    wrench[4] = c * values[0] - a * values[2]
    wrench[5] = a * values[1] - b * values[0]


@njit(**_ALONE)
def sum_wrench_at(block, point, moment, wrench):
    """Fill wrench (6,) at one point (3,) of a block at given currents, on a moment (3,); the status."""
    if point.shape[0] != 3 or moment.shape[0] != 3 or wrench.shape[0] != 6:
        return WRONG_SHAPE
    status, values = contracted_at(block, point[0], point[1], point[2])
    _store_wrench(values, moment, wrench)
    return status


@njit(**_ALONE)
def wrench_at(block, known, currents, point, moment, wrench):
    """As `sum_wrench_at`, at currents (n_coils,) of a block with several sets.

    known: what the weights of the sets are. Empty: the currents. One number: the currents, and this for the last set.
    More: the currents for which they are known and then the weights; WRONG_SHAPE for other currents.
    """
    if point.shape[0] != 3 or moment.shape[0] != 3 or wrench.shape[0] != 6:
        return WRONG_SHAPE
    coils, beside = currents.shape[0], known.shape[0]
    weights = currents
    if beside == 1:
        weights = np.empty(coils + 1)
        for k in range(coils):
            weights[k] = currents[k]
        weights[coils] = known[0]
    elif beside > 1:
        if beside <= coils:
            return WRONG_SHAPE
        for k in range(coils):
            if currents[k] != known[k]:
                return WRONG_SHAPE
        weights = known[coils:]
    if weights.shape[0] != int(block[SETS]):
        return WRONG_SHAPE
    status, values = superposed_at(block, weights, point[0], point[1], point[2])
    _store_wrench(values, moment, wrench)
    return status
