"""What making a map costs."""

from time import monotonic, process_time

from fieldmap.parallel import Workers

# Names under which a map's report states it.
SPENT = ("generation_seconds", "generation_processor_seconds")


class Stopwatch:
    """Seconds of the clock and of all processors, workers' too, since it was made, and what earlier runs took."""

    def __init__(self, workers: Workers, seconds: float = 0.0, processor_seconds: float = 0.0) -> None:
        self._workers = workers
        self._seconds = seconds - monotonic()
        self._processor_seconds = processor_seconds - self._processors()

    def add(self, seconds: float, processor_seconds: float) -> None:
        """Count what another run took."""
        self._seconds += seconds
        self._processor_seconds += processor_seconds

    def read(self) -> dict[str, float]:
        """The seconds so far, named by `SPENT`."""
        now = (self._seconds + monotonic(), self._processor_seconds + self._processors())
        return dict(zip(SPENT, now, strict=True))

    def _processors(self) -> float:
        return process_time() + self._workers.processor_seconds
