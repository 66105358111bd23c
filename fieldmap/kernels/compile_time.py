"""How long this process has compiled kernels."""

from functools import cache
from typing import Any

from numba.core import event


@cache
def _listener() -> Any:
    listener = event.TimingListener()
    event.register("numba:compile", listener)
    return listener


def seconds_compiling() -> float:
    """Seconds that numba has compiled since the first call of this function, kernels read from files not counted.

    >>> seconds_compiling() >= 0.0
    True
    """
    listener = _listener()
    return float(listener.duration) if listener.done else 0.0
