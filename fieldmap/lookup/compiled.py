"""Kernels made ready for callers who cannot wait for a compiler."""

from collections.abc import Callable
from typing import Any


def closed_to_new_types(kernel: Callable[..., Any], *example: object) -> Callable[..., Any]:
    """The kernel, compiled for arguments like the example and for no others.

    Other types then raise TypeError at once instead of costing seconds of compilation, whoever called the kernel
    before. Without a just-in-time compiler (NUMBA_DISABLE_JIT) there is nothing to do.
    """
    if hasattr(kernel, "disable_compile"):
        kernel(*example)
        kernel.disable_compile()
    return kernel
