"""How kernels are compiled: `njit` of numba with what all want, and `inlined` for parts of kernels."""

from collections.abc import Callable
from functools import partial, update_wrapper
from typing import Any

from fieldmap.extras import needs

with needs("make", "the field of coils and iron", module="numba"):
    import numba

# Kept in files. A function takes what it does not say from the kernel that calls it first, and its last digits with it:
# all say whether sums may be reordered and whether they are inlined. Without numba's wrapper for callers in C, which
# took a seventh of the time of compiling: no kernel has such a caller. A division by zero gives what IEEE 754 says, as
# in numpy: to raise an error, as Python does, numba adds a branch to each division and the way out to all callers.
_KEPT = {"cache": True, "error_model": "numpy"}
njit: Any = partial(numba.njit, no_cfunc_wrapper=True, fastmath=False, forceinline=False, **_KEPT)


class Inlined:
    """A compiled function that is inlined into each kernel that calls it, and that Python cannot call.

    numba's wrapper for callers in Python would hold the function once more, to be optimised and to be made machine code
    of. numba takes this object for the compiled function.

    dispatcher: what `numba.njit` made of the function. py_func: the function.
    """

    def __init__(self, dispatcher: Any) -> None:
        update_wrapper(self, dispatcher.py_func)
        self.dispatcher, self.py_func = dispatcher, dispatcher.py_func
        self._numba_type_ = dispatcher._numba_type_

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """Raise TypeError: there is no code that Python could call."""
        raise TypeError(
            f"{self.py_func.__module__}.{self.py_func.__qualname__} is a part of kernels and has no code for Python; "
            "call it in a compiled function, or compile it with njit(forceinline=True)"
        )


def inlined(function: Callable[..., Any] | None = None, /, **options: Any) -> Any:
    """Compile a function as a part of the kernels that call it. As a decorator, with options of `numba.njit` or none.

    With NUMBA_DISABLE_JIT it stays the function that it is.
    """
    if function is None:
        return partial(inlined, **options)
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        return function
    return Inlined(njit(forceinline=True, no_cpython_wrapper=True, **options)(function))
