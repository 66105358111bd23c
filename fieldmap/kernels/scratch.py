"""Room for the coefficients of one cell on the stack.

An array from the heap costs 50 ns, a third of what a lookup at one point computes. Numba has no arrays on the stack, so
this takes the memory with LLVM's alloca and looks at it as an array. It lives as long as the function that called
`cell_scratch`; both decorators below make sure that this is the caller and not a function in between.
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import carray, types
from numba.core import cgutils
from numba.extending import intrinsic, overload

from fieldmap.kernels.cell_harmonics import SIZE


@intrinsic
def _on_stack(_: Any) -> Any:
    signature = types.CPointer(types.float64)()

    def generate(_context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        return cgutils.alloca_once(builder, ir.DoubleType(), size=SIZE)

    return signature, generate


def cell_scratch() -> Any:
    """An array (36,) of anything, not to be returned."""
    return np.empty(SIZE)


@overload(cell_scratch, inline="always")
def _cell_scratch() -> Any:
    return lambda: carray(_on_stack(), (SIZE,))  # type: ignore[call-arg]
