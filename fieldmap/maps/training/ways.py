"""Ways of the currents through a domain, on which iron that remembers is solved: to train a model and to test it."""

from dataclasses import dataclass

import numpy as np

from fieldmap.currents import CurrentDomain
from fieldmap.histories import history_of_currents
from fieldmap.records import Record
from fieldmap.typing import Array

STEPS = 30
"""Steps of a random way."""
# Amplitudes of the cycles of one signal, as shares of the distance to the nearer end of its range, and their places.
_AMPLITUDES = (0.05, 0.25, 1.0)
_CYCLE = np.array([0.5, 1.0, 0.5, 0.0, -0.5, -1.0, -0.5, 0.0])
# Of the steps of a random way this share goes anywhere; the others are local, of sizes between these powers of ten, as
# shares of the ranges.
_ANYWHERE, _LOCAL = 0.4, (-2.5, -0.5)
# One random way in so many begins in iron that was never magnetised.
_FROM_NOTHING = 4
_SEED = 57


@dataclass(frozen=True, eq=False, repr=False)
class Way(Record):
    """Currents (s, c), A, one straight step after the other, after a history (fieldmap.histories)."""

    history: str
    currents: Array


def planned_ways(domain: CurrentDomain, level: Array) -> list[Way]:
    """The history "shaken" about currents `level` (c,), and cycles of each signal about it, larger and larger."""
    rest = domain.parametrisation.nearest(level).values
    ways = [Way("demagnetised", history_of_currents("shaken", level))]
    for k, place in enumerate(rest):
        reach = min(domain.upper[k] - place, place - domain.lower[k])
        signals = np.tile(rest, (len(_AMPLITUDES) * len(_CYCLE), 1))
        signals[:, k] += reach * np.outer(_AMPLITUDES, _CYCLE).ravel()
        ways.append(Way("shaken", domain.parametrisation.currents(signals)))
    return ways


def random_way(domain: CurrentDomain, level: Array, number: int) -> Way:
    """A way from currents `level` (c,) through the domain, the same for the same number. Far steps and short ones, so
    that it has loops of many widths."""
    random = np.random.default_rng((_SEED, number))
    of, span = domain.parametrisation, domain.upper - domain.lower
    place = (of.nearest(level).values - domain.lower) / span
    shares = np.empty((STEPS, len(span)))
    for row in shares:
        if random.random() < _ANYWHERE:
            place = random.random(len(span))
        else:
            step = 10.0 ** random.uniform(*_LOCAL) * random.standard_normal(len(span))
            # Reflected at the faces of the domain.
            place = 1.0 - np.abs(1.0 - np.abs(place + step) % 2.0)
        row[:] = place
    history = "demagnetised" if number % _FROM_NOTHING == _FROM_NOTHING - 1 else "shaken"
    return Way(history, domain.at(shares))
