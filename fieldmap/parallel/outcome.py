"""How a piece of work ended."""

import traceback
from collections.abc import Callable
from dataclasses import dataclass
from time import monotonic, process_time
from typing import Any, Generic, TypeVar

from fieldmap.errors import FieldmapError
from fieldmap.parallel.arithmetic import same_arithmetic

R = TypeVar("R")


class WorkerDied(FieldmapError):  # noqa: N818 - reads as what happened
    """Every process that was given a piece of work died on it."""


@dataclass(frozen=True, eq=False)
class Outcome(Generic[R]):
    """index: of the item; value: what the function returned, or error: what it raised; seconds of the clock and of the
    processors that it took."""

    index: int
    value: R | None
    error: Exception | None = None
    seconds: float = 0.0
    processor_seconds: float = 0.0

    def result(self) -> R:
        """The value; raises the error where there is one."""
        if self.error is not None:
            raise self.error
        return self.value  # type: ignore[return-value]

    @property
    def reason(self) -> str:
        """Why there is no value, in words; "" where there is one."""
        if self.error is None:
            return ""
        if isinstance(self.error, FieldmapError):
            return str(self.error)
        return f"{type(self.error).__name__}: {self.error}"


def attempt(index: int, function: Callable[..., R], *arguments: Any) -> Outcome[R]:
    """Call the function; an error becomes part of the outcome, unless it is an interruption."""
    begin, processor = monotonic(), process_time()
    value, failed = None, None
    try:
        with same_arithmetic():
            value = function(*arguments)
    except Exception as error:
        if not isinstance(error, FieldmapError):
            # Tracebacks do not travel between processes; where to look for the mistake should.
            error.add_note(traceback.format_exc())
        failed = error
    return Outcome(index, value, failed, monotonic() - begin, process_time() - processor)
