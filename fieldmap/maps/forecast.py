"""How far a run is, by the time that it has taken and the time that what is left will take.

A share of the states, or of the points, is no measure: how many there are, and how long one takes, shows only on the
way. Each stage of a run has the seconds expected of it, first from what is known before, then from its own pieces.

What the stages of a training are expected to take before are ratios that were measured on the shipped devices; half or
twice of them does no harm, as each stage that runs replaces its own.
"""

from collections.abc import Mapping, Sequence
from time import monotonic

import numpy as np

from fieldmap.typing import Progress

STAGES = ("assembling", "training", "extremes", "points", "random", "search", "modes")
# One state, and the fields of the modes, over the assembly of the solver.
_STATE, _MODES = 0.17, 0.7
# Of the states that a plan allows, how many it is expected to take until the errors of some rounds tell.
_SHARE = 0.65
# States to try the model on begin from its prediction: over those that it is trained on.
_TRIED = 0.3
# Points times states times twice the square of the modes that the whole choice does in one second, and how many states
# of the trained model the choice of fewer modes and points takes, solved several times each.
_PRODUCTS, _CONDENSED = 1e10, 5000
# Extremes that are to be solved, of those that there may be: the others are images. What the search for the worst
# currents costs, as so many states to try.
_EXTREMES, _SEARCH = 25, 30
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


def expect_training(forecast: Forecast, states: int, held_out: int) -> None:
    """Before one of at most so many states is solved, by what the assembly is expected to take."""
    assembling = forecast.expected("assembling")
    forecast.expect("training", _SHARE * states * _STATE * assembling)
    forecast.expect("points", assembling)
    forecast.expect("modes", _MODES * assembling)
    expect_tried(forecast, held_out, _STATE * assembling)


def expect_tried(forecast: Forecast, held_out: int, state: float) -> None:
    """States to try the model on, so many of them at random, by the seconds that one takes to train on."""
    forecast.expect("extremes", _TRIED * state * _EXTREMES)
    forecast.expect("random", _TRIED * state * held_out)
    forecast.expect("search", _TRIED * state * _SEARCH)


def expect_points(forecast: Forecast, points: int, modes: int, states: int) -> None:
    """The choice of sample points, for so many points of the iron and states, images too."""
    forecast.expect("points", states * points * modes * 2.0 * modes / _PRODUCTS)


def expect_modes(forecast: Forecast, points: int, modes: int) -> None:
    """The fields of the modes, and the choice of those that are kept, for so many that were trained."""
    fields = _MODES * forecast.expected("assembling")
    forecast.expect("modes", fields + _CONDENSED * points * 2.0 * modes**2 / _PRODUCTS)


def states_needed(shares: Sequence[float], solved: Sequence[int], most: int, accuracy: float) -> int:
    """How many states a training will take, by the largest errors of its rounds and how many states each knew: their
    logarithms on a line."""
    if len(shares) < 2:
        return max(round(_SHARE * most), solved[-1] if solved else 0)
    slope, level = np.polyfit(solved, np.log(np.maximum(shares, 1e-12)), 1)
    if slope >= 0.0:
        return most
    reached = (np.log(accuracy) - level) / slope
    return round(float(np.clip(reached, solved[-1], most)))
