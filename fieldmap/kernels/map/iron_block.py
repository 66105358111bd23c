"""The weights of saturating iron, from compiled loops: a call of the C core by an address (fieldmap/core/iron_array.h).

    int weights(double *array, const double *currents, double *weights)

fills the weights of the fields of a map: the currents, those of the iron's fields, and 1 for a background if any.
"""

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

# Positions in the array: the address, and how often currents lay beyond the domain.
ADDRESS, OUTSIDE = 0, 5


@intrinsic
def _call_weights(context, address, array, currents, weights):
    """The status of the function at an address, of contiguous arrays."""
    arrays = (array, currents, weights)
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
"""`call_weights(address, array, currents, weights)`, in compiled code only."""
