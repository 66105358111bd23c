"""Maps for callers that hold an address and nothing else: fieldmap/core/caller.h."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fieldmap.core.body import CoreBody
from fieldmap.core.current_table import CoreTable
from fieldmap.core.iron import IronState
from fieldmap.core.library import LIBRARY
from fieldmap.core.map import CoreMap

COILS: int = LIBRARY.CALLER_COILS
ROOM: int = LIBRARY.CALLER_ROOM
"""Positions in the words of a caller: how many currents it takes; how many numbers a wrench, or linkages, are asked
with, answer in and work with: currents (n,), place (3,), rotation (9,), wrench (6,) and slopes (6, n), or linkages (n,)
and inductances (n, n), and others."""


def caller(
    of: CoreMap,
    weights: IronState | CoreTable | None = None,
    body: CoreBody | None = None,
    linkage: Any = None,
) -> NDArray[np.int64]:
    """The words (4,) by which compiled code knows a map; the array keeps alive what they lead to, its copies do not.

    weights: what gives those of the map's fields from the currents, or None where these are the weights; with an
    `IronState` for one thread at a time. body: what wrench and linkages are asked of. linkage: inductance (n, n) and
    constant (n,) of the coils, as `fieldmap.store.StoredLinkage`.
    """
    solver = None
    if weights is not None:
        solver = weights.state if isinstance(weights, IronState) else weights.table
    return LIBRARY.caller(of.map, solver, None if body is None else body.body, linkage)


def functions() -> Mapping[str, int]:
    """The addresses of the functions in C, by name.

    double *call_field_of(const int64_t *words, const double *currents, double x, double y, double z): the three of the
    field and the nine of its gradient, which lie there until the thread's next call. double *call_field(const int64_t
    *words, double x, double y, double z): of a map at fixed currents. int call_wrench(const int64_t *words, double
    *numbers): 0, or why not, with NaN in wrench and slopes; numbers as `ROOM` says. int call_linkages(...): the same.
    """
    return LIBRARY.caller_functions()
