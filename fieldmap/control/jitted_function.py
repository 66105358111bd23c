"""Functions jitted by numba, and C functions that numba compiled, as controllers: docs/own_controller.md.

This module is imported only if numba is already imported, as no other module here needs it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numba import carray, cfunc, jit, literal_unroll, types
from numba.core.ccallback import CFunc as CFunc
from numba.core.errors import NumbaError
from numba.extending import is_jitted as is_jitted

from fieldmap.control.bound_function import CALL, WHERE, BoundFunction, guarded, reason, wrong_outputs
from fieldmap.core.controller import DONE, FAILED, WRONG_LENGTH
from fieldmap.errors import InputError
from fieldmap.typing import Array

_POINTER = types.CPointer(types.float64)
C_SIGNATURE = types.intc(types.float64, _POINTER, _POINTER, _POINTER, _POINTER)
"""Signature of a C function as controller, for `numba.cfunc`."""
_VECTOR = types.Array(types.float64, 1, "C")
ARGUMENTS = (types.float64, _VECTOR, _VECTOR, _VECTOR)
"""Types of a jitted function's arguments: time, measured, reference (3,), state (n,)."""


class JittedFunction(BoundFunction):
    """A function jitted by numba with checked indices, compiled for the loop. Raises InputError if it does not compile,
    or does not return one number for each of the names."""

    def __init__(self, function: Any, measured: int, names: Sequence[str], states: int) -> None:
        self._function = checked = with_checked_indices(function)
        try:
            if ARGUMENTS not in checked.overloads:
                checked.compile(ARGUMENTS)
            returned = checked.overloads[ARGUMENTS].signature.return_type
        except (NumbaError, RuntimeError) as error:
            must = f"must compile as {CALL}: a float and three arrays of float64"
            correct = "correct the line that numba names, or give the function without numba"
            remedy = f"{correct}; use @numba.njit alone"
            raise InputError.of(WHERE, must, reason(error), remedy) from error
        (fill, number), outputs = _filling(returned), len(names)
        if number not in (None, outputs):
            raise InputError(wrong_outputs(WHERE, names, f"{returned}"))

        @cfunc(C_SIGNATURE)
        def entry(time, seen, reference, state, out):
            answer = FAILED
            try:
                found = checked(time, carray(seen, measured), carray(reference, 3), carray(state, states))
                answer = fill(found, carray(out, outputs))
            except Exception:
                answer = FAILED
            return answer

        address: Any = entry.address
        super().__init__(int(address), entry)

    def cause(self, time: float, measured: Array, reference: Array, state: Array) -> BaseException | None:
        """Compiled code cannot keep an exception. The function is called again to get it, and then its Python source,
        which also gives the line and the index."""
        given = (measured, reference, state)
        compiled = _raised_by(self._function, time, *given)
        if compiled is None:
            return None
        source = _raised_by(self._function.py_func, time, *given)
        return source if type(source) is type(compiled) else compiled

    def shape(self, time: float, measured: Array, reference: Array, state: Array) -> str:
        found = self._function(time, guarded(measured), guarded(reference), guarded(state))
        return f"an array {np.shape(found)}"


def _raised_by(
    function: Callable[..., Any], time: float, measured: Array, reference: Array, state: Array
) -> Exception | None:
    try:
        with np.errstate(all="ignore"):
            function(time, guarded(measured), guarded(reference), guarded(state))
    except Exception as error:
        return error
    return None


def with_checked_indices(function: Any) -> Any:
    """A jitted function compiled anew from its Python source, with an IndexError for an index out of range; the same
    function if it sets `boundscheck`. Functions that it calls are not compiled anew."""
    options = dict(function.targetoptions)
    if options.pop("boundscheck", None) is not None:
        return function
    # A function with explicit signatures is compiled for these only.
    signatures = None if function._can_compile else function.nopython_signatures
    return jit(signatures, boundscheck=True, locals=function.locals, **options)(function.py_func)


@jit
def _fill_from_array(found, out):
    if found.size != out.size:
        return WRONG_LENGTH
    out[:] = found
    return DONE


@jit
def _fill_from_tuple(found, out):
    k = 0
    for value in literal_unroll(found):
        out[k] = value
        k += 1  # noqa: SIM113 - numba unrolls no enumerate
    return DONE


@jit
def _fill_from_number(found, out):
    out[0] = found
    return DONE


def _filling(returned: types.Type) -> tuple[Any, int | None]:
    """The function that copies a return value of this type to the outputs, and its number of values: None for an array,
    which has any length; 0 for a type without numbers."""
    number = (types.Float, types.Integer)
    if isinstance(returned, types.Array) and returned.ndim == 1 and isinstance(returned.dtype, number):
        return _fill_from_array, None
    if isinstance(returned, types.BaseTuple):
        members: Any = returned
        return _fill_from_tuple, len(members) if all(isinstance(each, number) for each in members) else 0
    return _fill_from_number, 1 if isinstance(returned, number) else 0
