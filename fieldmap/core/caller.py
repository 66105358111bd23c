"""Maps for callers that hold an address and nothing else: fieldmap/core/caller.h."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from fieldmap.core.body import CoreBody
from fieldmap.core.current_table import CoreTable
from fieldmap.core.iron import IronState
from fieldmap.core.library import LIBRARY
from fieldmap.core.map import CoreMap

COILS: int = LIBRARY.CALLER_COILS
ROOM: int = LIBRARY.CALLER_ROOM
"""Positions in the words of a caller: how many currents it takes; how many numbers a wrench is asked with,
answers in and works with: currents (n,), place (3,), rotation (9,), wrench (6,), slopes (6, n), and others."""


def caller(
    of: CoreMap, weights: IronState | CoreTable | None = None, body: CoreBody | None = None
) -> NDArray[np.int64]:
    """The words (4,) by which compiled code knows a map; the array keeps alive what they lead to, its copies do not.

    weights: what gives those of the map's fields from the currents, or None where these are the weights; with an
    `IronState` for one thread at a time. body: what a wrench is asked of.
    """
    solver = None
    if weights is not None:
        solver = weights.state if isinstance(weights, IronState) else weights.table
    return LIBRARY.caller(of.map, solver, None if body is None else body.body)


def functions() -> Mapping[str, int]:
    """The addresses of the functions in C, by name.

    double *call_field_of(const int64_t *words, const double *currents, double x, double y, double z): the three of the
    field and the nine of its gradient, which lie there until the thread's next call. double *call_field(const int64_t
    *words, double x, double y, double z): of a map at fixed currents. int call_wrench(const int64_t *words, double
    *numbers): 0, or why not, with NaN in wrench and slopes; numbers as `ROOM` says.
    """
    return LIBRARY.caller_functions()
