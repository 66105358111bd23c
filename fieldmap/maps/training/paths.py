"""Paths of the currents through a domain, along which iron with hysteresis is solved for training and tests."""

from dataclasses import dataclass

import numpy as np

from fieldmap.currents import CurrentDomain
from fieldmap.histories import history_of_currents
from fieldmap.records import Record
from fieldmap.typing import Array

STEPS = 30
"""Steps of a random path."""
# Amplitudes of the cycles of one signal, as shares of the distance to the nearer end of its range, and their points.
_AMPLITUDES = (0.05, 0.25, 1.0)
_CYCLE = np.array([0.5, 1.0, 0.5, 0.0, -0.5, -1.0, -0.5, 0.0])
# The same of cycles beside another signal, which is held this share of the distance away from the middle.
_WIDE, _BESIDE = (0.75, 1.0), 0.4
# Share of the steps of a random path that go anywhere; sizes of the others, as powers of ten of the ranges.
_ANYWHERE, _LOCAL = 0.4, (-2.5, -0.5)
# One random path in so many begins in iron that was never magnetised.
_FROM_NOTHING = 4
_SEED = 57


@dataclass(frozen=True, eq=False, repr=False)
class CurrentPath(Record):
    """Currents (s, c), A, at the ends of straight steps after a history (fieldmap.histories)."""

    history: str
    currents: Array


def planned_paths(domain: CurrentDomain, level: Array) -> list[CurrentPath]:
    """The history "shaken" about currents `level` (c,), growing cycles of each signal about it, and wide cycles of each
    with another signal higher: a machine swings about many levels, and random paths pass each of them once."""
    rest = domain.parametrisation.nearest(level).values
    reach = np.minimum(domain.upper - rest, rest - domain.lower)

    def cycles(k: int, amplitudes: tuple[float, ...], middle: Array) -> CurrentPath:
        signals = np.tile(middle, (len(amplitudes) * len(_CYCLE), 1))
        signals[:, k] += reach[k] * np.outer(amplitudes, _CYCLE).ravel()
        return CurrentPath("shaken", domain.parametrisation.currents(signals))

    higher = rest + _BESIDE * np.diag(reach)
    count = range(len(rest))
    return [
        CurrentPath("demagnetised", history_of_currents("shaken", level)),
        *(cycles(k, _AMPLITUDES, rest) for k in count),
        *(cycles(k, _WIDE, higher[j]) for k in count for j in count if j != k),
    ]


def random_path(domain: CurrentDomain, level: Array, number: int) -> CurrentPath:
    """A path from currents `level` (c,) through the domain. The same number gives the same path. Its steps are far and
    short, so that it has loops of many widths."""
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
    return CurrentPath(history, domain.at(shares))
