"""Gain of lookups by a second thread, separated from the gain of the machine's second processor.

The processors of a virtual machine may be two halves of one core of its host at one moment and two cores at the next.
Arithmetic in registers shows which: two copies take twice as long as one on one core, and just as long on two cores.
The arithmetic runs before and after every call on two threads, and the calls are classified by its result.
"""

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fieldmap.lookup import interpolate
from fieldmap.store import MapData

Array = NDArray[np.float64]
Work = Callable[[], object]

STEPS = 4_000_000
OWN_CORES, ONE_CORE = 1.8, 1.2
ROUNDS, CALLS = 40, 4


@njit(nogil=True, fastmath=True)  # type: ignore[untyped-decorator]
def arithmetic(steps: int) -> float:
    """Twelve independent chains of multiplications and additions: enough to fill a core's units, no memory."""
    a, b, c, d, e, f = 0.1, 0.2, 0.3, 0.4, 0.5, 0.6
    g, h, i, j, k, m = 0.7, 0.8, 0.9, 1.0, 1.1, 1.2
    for _ in range(steps):
        a, b, c, d = a * 0.999 + 0.01, b * 0.999 + 0.01, c * 0.999 + 0.01, d * 0.999 + 0.01
        e, f, g, h = e * 0.999 + 0.01, f * 0.999 + 0.01, g * 0.999 + 0.01, h * 0.999 + 0.01
        i, j, k, m = i * 0.999 + 0.01, j * 0.999 + 0.01, k * 0.999 + 0.01, m * 0.999 + 0.01
    return a + b + c + d + e + f + g + h + i + j + k + m


def elapsed(work: Work) -> float:
    """Wall seconds of the work."""
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


class Processors:
    """Gain of arithmetic by two processors at this moment: 2 on two cores, 1 on one core."""

    def __init__(self, callers: ThreadPoolExecutor) -> None:
        arithmetic(1)
        self.callers = callers
        self.alone = min(elapsed(lambda: arithmetic(STEPS)) for _ in range(20))

    def worth(self) -> float:
        """Speed of two copies of the arithmetic at once, relative to one copy."""
        return 2 * self.alone / elapsed(lambda: list(self.callers.map(arithmetic, [STEPS, STEPS])))

    def timed(self, work: Work) -> tuple[float, float, float]:
        """Seconds of the work, and the smaller and the larger gain of the processors before and after the work."""
        before, seconds, after = self.worth(), elapsed(work), self.worth()
        return seconds, min(before, after), max(before, after)


def threads_gain(data: MapData, points: Array, rounds: int = ROUNDS) -> dict[str, Any]:
    """Speed-up of field and gradient at the points by two threads ("threads"), and by two callers that share nothing
    and take half of the points each ("callers"). Medians over all calls ("all"), over calls with the processors on two
    cores ("own") and on one core ("one"), with the number of calls. None: no such call.
    """
    count = len(points)
    out = (np.empty((count, 3)), np.empty((count, 3, 3)))
    one, two = (interpolate(data, "harmonic", threads=threads).at(np.ones(6)) for threads in (1, 2))
    halves = [slice(None, count // 2), slice(count // 2, None)]
    with ThreadPoolExecutor(2) as callers:

        def apart() -> None:
            list(callers.map(lambda h: one.field_and_gradient(points[h], (out[0][h], out[1][h])), halves))

        def alone() -> None:
            one.field_and_gradient(points, out)

        ways: dict[str, Work] = {"threads": lambda: two.field_and_gradient(points, out), "callers": apart}
        processors = Processors(callers)
        single: list[float] = []
        double: dict[str, list[tuple[float, float, float]]] = {way: [] for way in ways}
        for _ in range(rounds):
            alone()
            single += [elapsed(alone) for _ in range(CALLS)]
            for way, work in ways.items():
                work()
                double[way] += [processors.timed(work) for _ in range(CALLS)]
    return {way: gains(float(np.median(single)), np.array(calls)) for way, calls in double.items()}


def gains(single: float, calls: Array) -> dict[str, Any]:
    """Speed-ups from rows of seconds, smaller and larger gain of the processors."""
    seconds, smaller, larger = calls.T
    kinds = {"all": smaller > 0, "own": smaller >= OWN_CORES, "one": larger <= ONE_CORE}
    return {
        kind: {
            "calls": int(of_kind.sum()),
            "gain": single / float(np.median(seconds[of_kind])) if of_kind.any() else None,
        }
        for kind, of_kind in kinds.items()
    }


def sentences(result: dict[str, Any]) -> list[str]:
    """The result in sentences."""
    names = {"threads": "two threads", "callers": "two callers that share nothing"}
    where = {
        "own": "with both processors on cores of their own",
        "one": "with both on one core",
        "all": "altogether",
    }
    return [
        f"{names[way]}: "
        + "; ".join(f"{spoken(kinds[kind])} {words}" for kind, words in where.items() if kinds[kind]["calls"])
        for way, kinds in result.items()
    ]


def spoken(gain: dict[str, Any]) -> str:
    """One gain with the number of calls behind it."""
    return f"{gain['gain']:.2f} times as fast ({gain['calls']} calls)"
