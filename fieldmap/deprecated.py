"""Names that have changed: the old one works for one release and warns."""

import sys
import warnings
from collections.abc import Callable, Mapping
from functools import wraps
from importlib import import_module
from typing import Any, ParamSpec, TypeVar

REMOVAL = "the next release"
P = ParamSpec("P")
R = TypeVar("R")


def renamed(module: str, names: Mapping[str, str]) -> Callable[[str], Any]:
    """The `__getattr__` of a module some of whose names have changed.

    module: its `__name__`. names: old name -> new name; a new name that lies in another module is written
    "package.module:name", a whole module "package.module:". Using an old name gives the new object and warns with
    DeprecationWarning. Other names raise AttributeError as usual.

    At the end of the module::

        __getattr__ = renamed(__name__, {"Trim": "OperatingPoint", "trim": "find_operating_point"})
    """

    def find(name: str) -> Any:
        if name not in names:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        place, _, new = names[name].rpartition(":")
        shown = f"{place}.{new}" if place and new else place or f"{module}.{new}"
        warn_renamed(f"{module}.{name}", shown)
        found = sys.modules[module] if not place else import_module(place)
        return getattr(found, new) if new else found

    return find


def warn_renamed(old: str, new: str, level: int = 2) -> None:
    """Warn that `old` is now `new`. level: as `stacklevel` of `warnings.warn` has it in the function that calls this:
    2 points to the line that used the old name."""
    message = f"{old} is now {new}; the old name goes with {REMOVAL}"
    warnings.warn(message, DeprecationWarning, stacklevel=level + 1)


def renamed_argument(old: str, new: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorator of a function whose argument `old` is now `new`: by its old name it works, and warns."""

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        @wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            if old in kwargs:
                warn_renamed(f"{function.__name__}({old})", f"{function.__name__}({new})")
                kwargs[new] = kwargs.pop(old)
            return function(*args, **kwargs)

        return call

    return decorate
