"""Compilation of kernels: numba's `njit` with common options, and `inlined` for parts of kernels."""

from collections.abc import Callable
from functools import partial, update_wrapper
from typing import Any

from fieldmap.extras import needs

with needs("make", "the field of coils and iron", module="numba"):
    import numba

# Compiled code is kept in files. A function takes options that it does not set from the kernel that calls it first, and
# its last digits depend on them: so all set fastmath and forceinline. No kernel has a caller in C: numba's wrapper for
# these would take a seventh of the time of compiling. A division by zero gives the value of IEEE 754, as in numpy: for
# an error, as in Python, numba would add a branch to each division and an error path to all callers.
_KEPT = {"cache": True, "error_model": "numpy"}
njit: Any = partial(numba.njit, no_cfunc_wrapper=True, fastmath=False, forceinline=False, **_KEPT)


class Inlined:
    """A compiled function that is inlined into each kernel that calls it, and that Python cannot call.

    numba's wrapper for callers in Python would contain the function once more, and take time to optimise and compile.
    numba takes this object for the compiled function.

    dispatcher: the result of `numba.njit`. py_func: the function.
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

    With NUMBA_DISABLE_JIT the function is returned unchanged.
    """
    if function is None:
        return partial(inlined, **options)
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        return function
    return Inlined(njit(forceinline=True, no_cpython_wrapper=True, **options)(function))
