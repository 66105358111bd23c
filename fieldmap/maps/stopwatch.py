"""What making a map costs."""

from time import monotonic, process_time

# Names under which a map's report states it.
SPENT = ("generation_seconds", "generation_processor_seconds")


class Stopwatch:
    """Seconds of the clock and of all processors since it was made, and what earlier runs took."""

    def __init__(self, seconds: float = 0.0, processor_seconds: float = 0.0) -> None:
        self._seconds, self._processor_seconds = seconds - monotonic(), processor_seconds - process_time()

    def add(self, seconds: float, processor_seconds: float) -> None:
        """Count what another run took."""
        self._seconds += seconds
        self._processor_seconds += processor_seconds

    def read(self) -> dict[str, float]:
        """The seconds so far, named by `SPENT`."""
        now = (self._seconds + monotonic(), self._processor_seconds + process_time())
        return dict(zip(SPENT, now, strict=True))
