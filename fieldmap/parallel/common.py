"""What all pieces of a work need, such as an assembled solver: made once in every process, never sent."""

import uuid
from collections.abc import Callable
from typing import Any, Generic, TypeVar, cast

T = TypeVar("T")
# The one that this process made last. A worker outlives a piece of work, so it must not keep them all.
_KEPT: "dict[str, Any]" = {}


class Common(Generic[T]):
    """`make(*arguments)`, made where and when it is first asked for, then kept.

    What travels to a worker is `make` and `arguments`, which must be picklable; what they make need not be.
    """

    def __init__(self, make: Callable[..., T], *arguments: Any) -> None:
        self._make, self._arguments, self._made = make, arguments, cast("T | None", None)
        self._key = uuid.uuid4().hex

    @classmethod
    def of(cls, value: T) -> "Common[T]":
        """Something that can travel itself."""
        return cls(_itself, value)

    def use(self, made: T) -> T:
        """What this process has made already, in its own way; returned."""
        self._made = made
        return made

    def here(self) -> T:
        """This process's own."""
        if self._made is None:
            if self._key not in _KEPT:
                _KEPT.clear()
                _KEPT[self._key] = self._make(*self._arguments)
            self._made = _KEPT[self._key]
        return self._made

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_made": None}


def _itself(value: T) -> T:
    return value
