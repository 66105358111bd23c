"""Compute the parts of a plan, with progress that moves while a part is at work."""

import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial

from fieldmap.thesis.computation import PartResult, attempt_rows
from fieldmap.thesis.plan import Plan
from fieldmap.thesis.report import minutes
from fieldmap.typing import Progress

MOVED_EVERY = 1.0
"""Seconds after which progress moves while a part is at work."""
TOLD_EVERY = 10.0
"""Seconds after which the time that a part has taken is told anew."""


def computed(plan: Plan, attempt: Callable[[str], PartResult], progress: Progress) -> Iterator[PartResult]:
    """The parts of a plan, one by one; the maps that it asks for are made before the first part that needs one."""
    begun = 0.0
    for stage in plan.stages:
        what = f"map {stage.recipe}: " if stage.recipe else ""
        share = partial(_told, progress, what, begun / plan.whole, stage.seconds / plan.whole)
        if stage.recipe:
            # Rows without a map need no kernels.
            from fieldmap.maps import generate

            stage.target.parent.mkdir(parents=True, exist_ok=True)
            generate(stage.recipe, stage.target, progress=share)
        else:
            with moving(share, stage.expected) as moved:
                yield from attempt_rows(stage.expected, moved, attempt)
        begun += stage.seconds


def _told(progress: Progress, what: str, begun: float, of: float, message: str, fraction: float) -> None:
    """Tell progress in a step that is the share `of` of all and began at the share `begun`."""
    progress(f"{what}{message}", begun + fraction * of)


@contextmanager
def moving(progress: Progress, expected: Mapping[str, float]) -> Iterator[Progress]:
    """Progress for `attempt_rows` that moves while a part is at work, by the seconds that are expected of it.

    A part that takes longer moves on ever more slowly and never passes its end.
    """
    whole, stopped = sum(expected.values()), threading.Event()
    at_work: list[tuple[str, float, float]] = []

    def begins(part: str, share: float) -> None:
        at_work[:] = [(part, share, time.monotonic())]
        progress(part, share)

    def ticks() -> None:
        while not stopped.wait(MOVED_EVERY):
            for part, share, since in tuple(at_work):
                took, usual = time.monotonic() - since, expected[part]
                inside = usual * (1.0 - math.exp(-took / usual)) / whole
                if took > TOLD_EVERY:
                    told = TOLD_EVERY * (took // TOLD_EVERY)
                    progress(f"{part}, {minutes(told)} of about {minutes(usual)}", share + inside)

    clock = threading.Thread(target=ticks, daemon=True)
    clock.start()
    try:
        yield begins
    finally:
        stopped.set()
        clock.join()
