"""Fields of maps inside functions that numba compiles: calls of the C core by its addresses.

Only these functions need numba: no other module of `fieldmap.lookup` imports it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fieldmap.core.caller import COILS, ROOM, functions
from fieldmap.extras import needs

with needs("make", "compiled()", module="numba"):
    import numba
    from llvmlite.binding import add_symbol
    from numba import types

for _name, _address in functions().items():
    add_symbol(f"fieldmap_{_name}", _address)
_WORDS, _NUMBERS, _POINT = types.CPointer(types.int64), types.CPointer(types.float64), 3 * (types.float64,)
_call_field: Any = types.ExternalFunction("fieldmap_call_field", _NUMBERS(_WORDS, *_POINT))
_call_field_of: Any = types.ExternalFunction("fieldmap_call_field_of", _NUMBERS(_WORDS, _NUMBERS, *_POINT))
_call_wrench: Any = types.ExternalFunction("fieldmap_call_wrench", types.intc(_WORDS, _NUMBERS))
_call_linkages: Any = types.ExternalFunction("fieldmap_call_linkages", types.intc(_WORDS, _NUMBERS))
_WRONG_COUNT = "one current for each coil of the map is needed"


@numba.njit(cache=True, nogil=True)
def at(data, x, y, z):  # type: ignore[no-untyped-def]
    """((Bx, By, Bz), ((dBx/dx, dBx/dy, dBx/dz), ...)), T and T/m, at a point, m, of a map at fixed currents.

    data: the words of a caller (`fieldmap.core.caller`).
    """
    v = numba.carray(_call_field(data.ctypes, x, y, z), (12,))
    return (v[0], v[1], v[2]), ((v[3], v[4], v[5]), (v[6], v[7], v[8]), (v[9], v[10], v[11]))


@numba.njit(cache=True, nogil=True)
def at_currents(data, currents, x, y, z):  # type: ignore[no-untyped-def]
    """As `at`, for currents (n_coils,), A, that change from call to call. Raises ValueError for a wrong number."""
    if currents.size != data[COILS]:
        raise ValueError(_WRONG_COUNT)
    # The core needs contiguous numbers; an array that is contiguous is not copied.
    row = np.ascontiguousarray(currents)
    v = numba.carray(_call_field_of(data.ctypes, row.ctypes, x, y, z), (12,))
    return (v[0], v[1], v[2]), ((v[3], v[4], v[5]), (v[6], v[7], v[8]), (v[9], v[10], v[11]))


@numba.njit(cache=True, nogil=True)
def _asked(data, currents, place, turn):  # type: ignore[no-untyped-def]
    """The input of a wrench or of linkages as contiguous numbers, for arrays of any layout."""
    coils, numbers = currents.size, np.empty(data[ROOM])
    for k in range(coils):
        numbers[k] = currents[k]
    for i in range(3):
        numbers[coils + i] = place[i]
        for j in range(3):
            numbers[coils + 3 + 3 * i + j] = turn[i, j]
    return numbers


@numba.njit(cache=True, nogil=True)
def linkages_at(data, currents, place, turn, linkages, inductance):  # type: ignore[no-untyped-def]
    """Fill linkages (n_coils,) and inductance (n_coils, n_coils): see `fieldmap.lookup.compiled_linkages`. Raises
    ValueError for a wrong number of currents."""
    coils = data[COILS]
    if currents.size != coils or linkages.size != coils or inductance.shape != (coils, coils):
        raise ValueError(_WRONG_COUNT)
    numbers = _asked(data, currents, place, turn)
    status = _call_linkages(data.ctypes, numbers.ctypes)
    found = coils + 12
    for k in range(coils):
        linkages[k] = numbers[found + k]
        for j in range(coils):
            inductance[k, j] = numbers[found + coils + k * coils + j]
    return status == 0


@numba.njit(cache=True, nogil=True)
def wrench_at(data, currents, place, turn, wrench, slopes):  # type: ignore[no-untyped-def]
    """Fill wrench (6,) and slopes (6, n_coils): see `fieldmap.lookup.compiled_wrench`. Raises ValueError for a wrong
    number of currents."""
    coils = data[COILS]
    if currents.size != coils or slopes.shape[1] != coils:
        raise ValueError(_WRONG_COUNT)
    numbers = _asked(data, currents, place, turn)
    status = _call_wrench(data.ctypes, numbers.ctypes)
    found = coils + 12
    for i in range(6):
        wrench[i] = numbers[found + i]
        for k in range(coils):
            slopes[i, k] = numbers[found + 6 + i * coils + k]
    return status == 0
