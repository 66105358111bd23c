"""Progress and time of the steps of a long computation."""

import time
from collections.abc import Callable

Progress = Callable[[str, float], None]


class Stages:
    """Tells `progress(message, fraction)` when a step begins and keeps the wall time of each."""

    def __init__(self, progress: Progress | None) -> None:
        self._progress = progress
        self._start = time.perf_counter()
        self._name = ""
        self.seconds: dict[str, float] = {}

    def next(self, name: str, fraction: float) -> None:
        """End the current step and begin another."""
        self._end()
        self._name = name
        self._tell(name, fraction)

    def done(self, message: str = "solved") -> None:
        """End the last step."""
        self._end()
        self._name = ""
        self._tell(message, 1.0)

    def _end(self) -> None:
        now = time.perf_counter()
        if self._name:
            self.seconds[self._name] = now - self._start
        self._start = now

    def _tell(self, message: str, fraction: float) -> None:
        if self._progress is not None:
            self._progress(message, fraction)
