"""The name that `fieldmap.interop` had before version 0.2. It goes with the next one."""

import warnings

from fieldmap import interop


def __getattr__(name: str) -> object:
    if name.startswith("__"):
        raise AttributeError(name)
    value = getattr(interop, name)
    warnings.warn(
        f"fieldmap.adapters.{name} is now fieldmap.interop.{name}", DeprecationWarning, stacklevel=2
    )
    return value
