"""Numbers at an address, for compiled code that is given addresses in the place of arrays."""

from typing import Any

from numba import types
from numba.extending import intrinsic


def _to_reals(_: Any, address: Any) -> Any:
    """A pointer to float64 at an address."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

    return types.CPointer(types.float64)(types.intp), generate


def _to_words(_: Any, address: Any) -> Any:
    """A pointer to int64 at an address."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

    return types.CPointer(types.int64)(types.intp), generate


reals: Any = intrinsic(_to_reals)
"""`reals(address)`: a pointer to float64, in compiled code only."""
words: Any = intrinsic(_to_words)
"""`words(address)`: a pointer to int64, in compiled code only."""
