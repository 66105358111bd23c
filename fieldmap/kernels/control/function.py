"""A controller that is a C function, called from compiled loops by its address.

    int control(double time, const double measured[3], const double reference[3], double *state, double *outputs)

It fills the outputs, may change its state, and returns 0; any other number ends the run.
"""

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

NO_FUNCTION, GIVEN = 0, -1
"""In the place of an address: the controller is a block; outputs are given from outside, sample by sample."""
DONE = 0
"""What a function returns at a sample that is to be followed by others (fieldmap.core.controller)."""


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
