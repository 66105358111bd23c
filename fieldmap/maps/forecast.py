"""How far a run is, by the time that it has taken and the time that what is left will take.

A share of the states, or of the points, is no measure: how many there are, and how long one takes, shows only on the
way. Each stage of a run has the seconds expected of it, first from what is known before, then from its own pieces.
"""

from collections.abc import Mapping
from time import monotonic

from fieldmap.typing import Progress

# Of a stage without pieces that takes longer than was expected of it, this share of what it has taken is still to come.
_MORE = 0.1


class Forecast:
    """Tells a run's progress: stages one after the other, each of pieces that take about the same time.

    stages: seconds expected of each, in their order. The share that is told never falls, unless the run goes back to
    an earlier stage: what comes after that is to be done again.
    """

    def __init__(self, say: Progress, stages: Mapping[str, float]) -> None:
        self._say = say
        self._expected = dict(stages)
        self._began = monotonic()
        self._stage_began = monotonic()
        self._stage, self._told = "", 0.0
        # Pieces of the stage that were done, and when.
        self._pieces: list[tuple[float, float]] = []

    def expect(self, stage: str, seconds: float) -> None:
        """Set the seconds in all that a stage will take."""
        self._expected[stage] = seconds

    def expected(self, stage: str) -> float:
        """Seconds in all that are expected of a stage now."""
        return self._expected[stage]

    def taken(self) -> float:
        """Seconds since the stage began."""
        return monotonic() - self._stage_began

    def at(self, stage: str, message: str, done: float = 0.0, count: float = 1.0) -> None:
        """Tell that `done` of about `count` pieces of a stage are done; stages before it are over."""
        now = monotonic()
        names = list(self._expected)
        if stage != self._stage:
            if self._stage and names.index(stage) < names.index(self._stage):
                self._told = 0.0
            self._stage, self._stage_began, self._pieces = stage, now, [(0.0, now)]
        taken = now - self._stage_began
        if done > 0:
            self._expected[stage] = taken + (max(count, done) - done) * self._per_piece(done, now)
        later = sum(self._expected[name] for name in names[names.index(stage) + 1 :])
        own = self._expected[stage] - taken
        left = later + (own if done > 0 else max(own, _MORE * taken))
        # As long as nothing is expected, nothing is known.
        if self._expected[stage] + later > 0.0:
            run = monotonic() - self._began
            self._told = max(self._told, run / (run + left))
        self._say(message, self._told)

    def _per_piece(self, done: float, now: float) -> float:
        """Seconds of a piece, from the later half of those done: the first may have waited for what is compiled."""
        first, since = [piece for piece in self._pieces if piece[0] <= done / 2][-1]
        self._pieces.append((done, now))
        return (now - since) / (done - first)

    def note(self, message: str) -> None:
        """Tell something that is no progress."""
        self._say(message, self._told)
