"""Progress on stderr: a bar on a terminal, a plain line now and then elsewhere; the time left where it can be told.

A time left is told where the share that is done is a share of the time (`timed`), after some seconds, and as long as
the whole run and its later half agree on it. The steps of one solve are no shares of its time, and a run that compiles
kernels has no time that others have.
"""

import logging
import math
import os
import sys
import time
from bisect import bisect_right
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.progress import Progress as RichProgress
    from rich.progress import TaskID

_LOG = logging.getLogger("fieldmap")
_LINE_EVERY_SECONDS = 10.0
_LINE_EVERY_FRACTION = 0.25
# A share that falls to less than this part of itself is that of another piece of work.
_SAME_RUN = 0.4
# A time left is told after so many seconds, and where two estimates are within this factor.
_TOLD_AFTER_SECONDS, _AGREE = 5.0, 1.5
_BETWEEN_SECONDS = 0.1
_ENTERED: "list[Progress]" = []
"""One within the other."""


class Progress:
    """Callable as progress(message, fraction); a context manager that leaves the terminal as it was.

    with Progress("solving") as progress:
        solve_linear(device, progress=progress)

    Nothing is shown while `shown` is False (`fieldmap --quiet`). Of several, one within the other, the innermost prints
    lines: a search tells how far it is, not each solve in it. compiles: whether a first run waits for kernels to be
    compiled. timed: whether the share that is done is a share of the time.
    """

    shown = True

    def __init__(self, title: str, compiles: bool = False, timed: bool = False) -> None:
        self.title = title
        self._compiles = compiles and must_compile()
        self._left = TimeLeft() if timed and not self._compiles else None
        self._logged = ""
        self.started = time.monotonic()
        self._bar: RichProgress | None = None
        self._task: TaskID | None = None
        self._printed = -math.inf
        self._fraction = self._told = -1.0
        self._again = False

    def __enter__(self) -> "Progress":
        _ENTERED.append(self)
        if self.shown and self._compiles:
            print("first run: kernels are compiled on the way; later runs start at once", file=sys.stderr)
        if self.shown and sys.stderr.isatty():
            try:
                self._bar = _bar()
            except ImportError:  # without the extra `cli`: plain lines
                return self
            self._bar.start()
            self._task = self._bar.add_task(self.title, total=1.0, left="")
        return self

    def __call__(self, message: str, fraction: float) -> None:
        """Show that `fraction` (0 to 1) of the work is done."""
        if message != self._logged:
            _LOG.info("%s: %3.0f %% %s", self.title, 100 * fraction, message)
            self._logged = message
        now = time.monotonic()
        seconds = None if self._left is None else self._left.at(now, fraction)
        left = "" if seconds is None else f"about {seconds:.0f} s left"
        if self._bar is not None and self._task is not None:
            words = f"{self.title}: {message}"
            self._bar.update(self._task, completed=fraction, description=words, left=left)
            return
        if not self.shown or self in _ENTERED[:-1]:
            return
        if fraction < _SAME_RUN * self._fraction:
            # Another state or another solve: of the first all is told, of the others a line now and then.
            self.started, self._fraction, self._again = now, -1.0, True
        elif fraction < self._fraction:
            # There is more to do than it seemed.
            self._fraction, self._told = -1.0, fraction
        rested = now >= self._printed + _LINE_EVERY_SECONDS
        further = not self._again and fraction >= self._told + _LINE_EVERY_FRACTION
        if (rested or further) and fraction > self._fraction:
            spent = now - self.started
            times = f"{spent:.0f} s, {left}" if left else f"{spent:.0f} s"
            print(f"{self.title}: {100 * fraction:3.0f} % {message} ({times})", file=sys.stderr)
            self._printed, self._told = now, fraction
        self._fraction = fraction

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        _ENTERED.remove(self)
        if self._bar is not None:
            self._bar.stop()


class TimeLeft:
    """The seconds that are left of a run, by the times at which shares of it were done."""

    def __init__(self) -> None:
        self._seen: list[tuple[float, float]] = []

    def at(self, now: float, fraction: float) -> float | None:
        """When this share is done: the larger of two estimates, by the whole run and by its later half; None where they
        do not agree, at the beginning, and at the end."""
        if self._seen and fraction < self._seen[-1][1]:
            self._seen.clear()
        if not self._seen or now > self._seen[-1][0] + _BETWEEN_SECONDS:
            self._seen.append((now, fraction))
        begin, first = self._seen[0]
        if now < begin + _TOLD_AFTER_SECONDS or fraction >= 1.0:
            return None
        middle = self._seen[bisect_right(self._seen, ((begin + now) / 2, math.inf)) - 1]
        if middle[1] >= fraction:
            return None
        estimates = [(now - t) / (fraction - f) * (1.0 - fraction) for t, f in ((begin, first), middle)]
        return max(estimates) if max(estimates) <= _AGREE * min(estimates) else None


def shown_or_silent(
    title: str, progress: "Callable[[str, float], None] | bool | None", timed: bool = False
) -> "AbstractContextManager[Callable[[str, float], None]]":
    """What a function calls as progress(message, fraction), as a context: `progress` itself, a `Progress` for True, one
    on a terminal for None, and nothing for False.

    >>> with shown_or_silent("map", False) as say:
    ...     say("solving", 0.5)
    """
    if callable(progress):
        return nullcontext(progress)
    if sys.stderr.isatty() if progress is None else progress:
        return Progress(title, compiles=timed, timed=timed)
    return nullcontext(_silent)


def _silent(message: str, fraction: float) -> None:
    pass


def _bar() -> "RichProgress":
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
    )
    from rich.progress import Progress as RichProgress

    return RichProgress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]}", markup=False),
        console=Console(stderr=True),
        transient=True,
    )


def must_compile() -> bool:
    """Whether no kernel has been compiled yet, so that a first run has to wait.

    False where compiled kernels lie elsewhere: NUMBA_CACHE_DIR is set, or the package's folder cannot be written.
    """
    folder = Path(__file__).parent / "kernels"
    if os.environ.get("NUMBA_CACHE_DIR") or not os.access(folder, os.W_OK):
        return False
    return next(folder.rglob("*.nbi"), None) is None
