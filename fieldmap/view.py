"""The name that `fieldmap.plot` had before version 0.2. It goes with the next one."""

import warnings

from fieldmap import plot


def __getattr__(name: str) -> object:
    if name.startswith("__"):
        raise AttributeError(name)
    value = getattr(plot, name)
    warnings.warn(f"fieldmap.view.{name} is now fieldmap.plot.{name}", DeprecationWarning, stacklevel=2)
    return value
