"""One compared number, and the measures of errors."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Result = TypeVar("Result")


@dataclass(frozen=True)
class Row:
    """A measured number with its bound (None: for information) and the source of its reference.

    faces: of the iron's surface; steps: of the solver; seconds, cpu_seconds: wall and processor time of the solve.
    value is NaN if it could not be measured; `note` says why. skipped: whether a requirement is missing here, which is
    no failure. figures: by heading, for rows with more than one number, which are printed in a separate table.
    """

    case: str
    quantity: str
    value: float
    bound: float | None
    source: str
    faces: int = 0
    steps: int = 0
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    note: str = ""
    study: str = ""
    skipped: bool = False
    figures: dict[str, str] = field(default_factory=dict)

    @property
    def verdict(self) -> str:
        """ "pass", "FAIL", "NOT RUN", "skipped", or "-" without a bound."""
        if self.skipped:
            return "skipped"
        if not np.isfinite(self.value):
            return "NOT RUN"
        return "-" if self.bound is None else ("pass" if abs(self.value) <= self.bound else "FAIL")


def largest_error(ours: Array, exact: Array) -> float:
    """Largest length of the difference over the largest length of the exact values; (n, 3) or (n, 3, 3)."""
    axes = tuple(range(1, exact.ndim))
    size = np.sqrt((exact**2).sum(axis=axes)).max()
    return float(np.sqrt(((ours - exact) ** 2).sum(axis=axes)).max() / size)


def timed(work: Callable[[], Result]) -> tuple[Result, float, float]:
    """Result, wall seconds, processor seconds of all threads."""
    wall, cpu = time.perf_counter(), time.process_time()
    result = work()
    return result, time.perf_counter() - wall, time.process_time() - cpu
