"""Maps for callers that hold only an address: fieldmap/core/caller.h."""

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
"""Indices in the words of a caller: of the number of currents n, and of the length of the array `numbers` of
call_wrench and call_linkages. This array begins with the arguments currents (n,), place (3,) and rotation (9,); the
results wrench (6,) and slopes (6, n), or linkages (n,) and inductances (n, n), follow, then room."""


def caller(
    of: CoreMap,
    weights: IronState | CoreTable | None = None,
    body: CoreBody | None = None,
    linkage: Any = None,
) -> NDArray[np.int64]:
    """Return the words (4,) that describe a map to compiled code. The array keeps the map alive, but its copies do
    not.

    weights: computes the weights of the map's fields from the currents; None if the currents are the weights. With an
    `IronState` only one thread at a time may use the words. body: the magnetic body for wrench and linkages. linkage:
    inductance (n, n) and constant (n,) of the coils, as in `fieldmap.store.StoredLinkage`.
    """
    solver = None
    if weights is not None:
        solver = weights.state if isinstance(weights, IronState) else weights.table
    return LIBRARY.caller(of.map, solver, None if body is None else body.body, linkage)


def functions() -> Mapping[str, int]:
    """Return the addresses of the C functions, by name.

    double *call_field_of(const int64_t *words, const double *currents, double x, double y, double z): three numbers
    of the field and nine of its gradient, valid until the next call in the thread. double *call_field(const int64_t
    *words, double x, double y, double z): of a map at fixed currents. int call_wrench(const int64_t *words, double
    *numbers): 0, or an error status with NaN in wrench and slopes; numbers: see `ROOM`. int call_linkages(...): the
    same.
    """
    return LIBRARY.caller_functions()
