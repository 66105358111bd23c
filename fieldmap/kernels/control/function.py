"""A controller that is a C function, called from compiled loops by its address.

    int control(double time, const double measured[3], const double reference[3], double *state, double *outputs)

It fills the outputs, may change its state, and returns 0; any other number ends the run.
"""

from typing import Any

from llvmlite import ir
from numba import carray, cfunc, jit, literal_unroll, types
from numba.extending import intrinsic

NO_FUNCTION, GIVEN = 0, -1
"""In the place of an address: the controller is a block; outputs are given from outside, sample by sample."""
DONE, FAILED, WRONG_LENGTH = 0, 1, 2
"""What a function returns: an exception, and outputs of another number, are reported by numbers of their own."""

_POINTER = types.CPointer(types.float64)
C_SIGNATURE = types.intc(types.float64, _POINTER, _POINTER, _POINTER, _POINTER)
"""Of the function above, as `numba.cfunc` takes it."""
_VECTOR = types.Array(types.float64, 1, "C")
ARGUMENTS = (types.float64, _VECTOR, _VECTOR, _VECTOR)
"""What a jitted function is called with: time, measured (3,), reference (3,), state (n,)."""


@intrinsic
def _call_function(context, address, time, measured, reference, state, outputs):
    """What the function at an address returns; measured, reference (3,), state (n,), outputs (m,): contiguous."""
    arrays = (measured, reference, state, outputs)
    signature = types.intc(address, time, *arrays)

    def generate(target, builder, signature, arguments):
        real = ir.DoubleType()
        kind = ir.FunctionType(ir.IntType(32), [real] + [real.as_pointer()] * len(arrays))
        function = builder.inttoptr(arguments[0], kind.as_pointer())
        places = [
            target.make_array(array)(target, builder, value=value).data
            for array, value in zip(arrays, arguments[2:], strict=True)
        ]
        return builder.call(function, [arguments[1], *places])

    return signature, generate


call_function: Any = _call_function
"""As above: `call_function(address, time, measured, reference, state, outputs)`, in compiled code only."""


def with_checked_indices(function: Any) -> Any:
    """A jitted function compiled anew from its Python source, with an IndexError for an index out of range; itself if
    it says by `boundscheck` what it wants. What it calls is compiled as it was."""
    options = dict(function.targetoptions)
    if options.pop("boundscheck", None) is not None:
        return function
    # Of a function with signatures of its own no others are compiled.
    signatures = None if function._can_compile else function.nopython_signatures
    return jit(signatures, boundscheck=True, locals=function.locals, **options)(function.py_func)


def returned_type(function: Any) -> types.Type:
    """What a jitted function returns for `ARGUMENTS`. Raises numba's own errors where it does not compile for them."""
    if ARGUMENTS not in function.overloads:
        function.compile(ARGUMENTS)
    return function.overloads[ARGUMENTS].signature.return_type


def number_of(returned: types.Type) -> int | None:
    """How many outputs a type holds: None for an array, of any length; 0 for what holds none."""
    number = (types.Float, types.Integer)
    if isinstance(returned, types.Array) and returned.ndim == 1 and isinstance(returned.dtype, number):
        return None
    if isinstance(returned, types.BaseTuple):
        members: Any = returned
        return len(members) if all(isinstance(each, number) for each in members) else 0
    return 1 if isinstance(returned, number) else 0


def compiled_function(function: Any, outputs: int, states: int) -> Any:
    """The C function (`numba.core.ccallback.CFunc`) of a jitted one that returns so many outputs."""
    returned = returned_type(function)
    if isinstance(returned, types.Array):

        @cfunc(C_SIGNATURE)
        def entry(time, measured, reference, state, out):
            answer = FAILED
            try:
                found = function(time, carray(measured, 3), carray(reference, 3), carray(state, states))
                answer = DONE
                if found.size != outputs:
                    answer = WRONG_LENGTH
                else:
                    for k in range(outputs):
                        out[k] = found[k]
            except Exception:
                answer = FAILED
            return answer

    elif isinstance(returned, types.BaseTuple):

        @cfunc(C_SIGNATURE)
        def entry(time, measured, reference, state, out):
            answer = FAILED
            try:
                found = function(time, carray(measured, 3), carray(reference, 3), carray(state, states))
                k = 0
                for value in literal_unroll(found):
                    out[k] = value
                    k += 1  # noqa: SIM113 - numba unrolls no enumerate
                answer = DONE
            except Exception:
                answer = FAILED
            return answer

    else:

        @cfunc(C_SIGNATURE)
        def entry(time, measured, reference, state, out):
            answer = FAILED
            try:
                out[0] = function(time, carray(measured, 3), carray(reference, 3), carray(state, states))
                answer = DONE
            except Exception:
                answer = FAILED
            return answer

    return entry
