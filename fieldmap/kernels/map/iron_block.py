"""A model of saturating iron and what its solves remember in one flat array, for compiled loops that call an address.

A loop that took the arrays of `fieldmap.kernels.map.current_solver` would pay for thirty of them in every function on
the way, and be compiled together with the solver. It takes one array, and calls what the array names:

    int weights(double *iron, const double *currents, double *weights)

fills the weights of the fields of a map: the currents, those of the iron's fields, and 1 for a background if any.
"""

import functools
from typing import Any

import numpy as np
from llvmlite import ir
from numba import carray, types
from numba.extending import intrinsic

from fieldmap.kernels.compilation import cfunc, njit
from fieldmap.kernels.map.current_solver import (
    FOUND,
    NOT_CONVERGED,
    NOT_FINITE,
    STEPS,
    CompiledModel,
    SignalDomain,
    SolverState,
    signals_of,
    solve,
)

# The head of the array: the address of the function above; the array's length; what was done so far, solves, their
# Newton steps, those that did not converge, those beyond the domain; tolerance of a solve; numbers of the domain.
ADDRESS, LENGTH, SOLVES, NEWTON_STEPS, UNSOLVED, OUTSIDE, TOLERANCE = 0, 1, 2, 3, 4, 5, 6
KIND, EXPONENT, LIMIT, MISMATCH = 7, 8, 9, 10
# Behind it for every array its beginning, rows and columns (0 for a vector), in the order of MODEL and STATE; then the
# arrays. Whole numbers take a place each, two numbers of single precision one.
HEAD, PER_ARRAY = 12, 3
DOMAIN = ("matrix", "inverse", "lower", "upper")
MODEL = CompiledModel._fields[:13]
STATE = SolverState._fields
_OF_DOMAIN, _OF_STATE = len(MODEL), len(MODEL) + len(DOMAIN)
ARRAYS = _OF_STATE + len(STATE)

_SIGNATURE = types.intc(*[types.CPointer(types.float64)] * 3)


@njit(inline="always")
def _reals(iron, number):
    first, rows = int(iron[HEAD + PER_ARRAY * number]), int(iron[HEAD + PER_ARRAY * number + 1])
    return iron[first : first + rows]


@njit(inline="always")
def _words(iron, number):
    return _reals(iron, number).view(np.int64)


@njit(inline="always")
def _matrix(iron, number):
    first, rows = int(iron[HEAD + PER_ARRAY * number]), int(iron[HEAD + PER_ARRAY * number + 1])
    columns = int(iron[HEAD + PER_ARRAY * number + 2])
    return iron[first : first + rows * columns].reshape(rows, columns)


@njit(inline="always")
def _singles(iron, number):
    first, rows = int(iron[HEAD + PER_ARRAY * number]), int(iron[HEAD + PER_ARRAY * number + 1])
    columns = int(iron[HEAD + PER_ARRAY * number + 2])
    every = iron[first : first + (rows * columns + 1) // 2].view(np.float32)
    return every[: rows * columns].reshape(rows, columns)


@njit(inline="always")
def _terms(iron, number):
    every = _words(iron, number)
    return every.reshape(every.size // 3, 3)


@njit(inline="always")
def model_in(iron):
    """The model, whose domain refuses no currents."""
    domain = SignalDomain(
        int(iron[KIND]),
        iron[EXPONENT],
        _matrix(iron, _OF_DOMAIN),
        _matrix(iron, _OF_DOMAIN + 1),
        _reals(iron, _OF_DOMAIN + 2),
        _reals(iron, _OF_DOMAIN + 3),
        iron[LIMIT],
        iron[MISMATCH],
        False,
    )
    return CompiledModel(
        _matrix(iron, 0),
        _reals(iron, 1),
        _singles(iron, 2),
        _reals(iron, 3),
        _words(iron, 4),
        _words(iron, 5),
        _reals(iron, 6),
        _matrix(iron, 7),
        _matrix(iron, 8),
        _reals(iron, 9),
        _matrix(iron, 10),
        _terms(iron, 11),
        _singles(iron, 12),
        domain,
        iron[TOLERANCE],
    )


@njit(inline="always")
def state_in(iron):
    """What solves remember."""
    return SolverState(
        _matrix(iron, _OF_STATE),
        _matrix(iron, _OF_STATE + 1),
        _matrix(iron, _OF_STATE + 2),
        _reals(iron, _OF_STATE + 3),
        _words(iron, _OF_STATE + 4),
        _reals(iron, _OF_STATE + 5),
        _reals(iron, _OF_STATE + 6),
    )


def _weights(head, amperes, found):
    """As above. A solve that begins from the last states and fails begins anew; where that fails too, the iron stays as
    it was last. NaN for currents that are not finite. The status of `fieldmap.kernels.map.current_solver`."""
    iron = carray(head, (int(carray(head, (HEAD,))[LENGTH]),))
    model, state = model_in(iron), state_in(iron)
    coils = model.source.shape[1]
    currents, weights = carray(amperes, (coils,)), carray(found, (state.weights.size,))
    status = solve(model, state, currents, model.tolerance)
    iron[SOLVES] += 1.0
    iron[NEWTON_STEPS] += state.numbers[STEPS]
    if status == NOT_CONVERGED:
        status = solve(model, state, currents, model.tolerance)
        iron[NEWTON_STEPS] += state.numbers[STEPS]
    if status != FOUND:
        iron[UNSOLVED] += 1.0
    values = np.empty(model.domain.lower.size)
    if not signals_of(model.domain, currents, values):
        iron[OUTSIDE] += 1.0
    for f in range(weights.size):
        weights[f] = currents[f] if f < coils else state.weights[f]
        if status == NOT_FINITE:
            weights[f] = np.nan
    return status


@functools.cache
def address_of_weights() -> int:
    """Of the function above, compiled when it is first asked for."""
    return int(cfunc(_SIGNATURE)(_weights).address)


@intrinsic
def _call_weights(context, address, iron, currents, weights):
    """The status of the function at an address, of contiguous arrays."""
    arrays = (iron, currents, weights)
    signature = types.intc(address, *arrays)

    def generate(target, builder, signature, arguments):
        kind = ir.FunctionType(ir.IntType(32), [ir.DoubleType().as_pointer()] * len(arrays))
        function = builder.inttoptr(arguments[0], kind.as_pointer())
        places = [
            target.make_array(array)(target, builder, value=value).data
            for array, value in zip(arrays, arguments[1:], strict=True)
        ]
        return builder.call(function, places)

    return signature, generate


call_weights: Any = _call_weights
"""`call_weights(address, iron, currents, weights)`, in compiled code only."""
