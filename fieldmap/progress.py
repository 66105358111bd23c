"""Progress on stderr: a bar on a terminal, elsewhere a line with the time of day every ten seconds or more.

Both show the present work with its rate and the number of workers (`Forecast`), the share that is done, the time spent
and left, and the memory of this process with its peak. The time left is shown only if the share is a share of time
(`timed`) and no kernels are compiled, because compilation makes the run untypical.
"""

import logging
import math
import os
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress as RichProgress
    from rich.progress import TaskID

_LOG = logging.getLogger("fieldmap")
_LINE_EVERY_SECONDS = 10.0
# Lines are also at least this share of the time spent apart, so that the log of a night stays short.
_LINE_EVERY_SHARE = 0.01
# The time left is shown once this share of the run is over.
_TOLD_FROM = 0.05
# Least time left of an unfinished stage, as a share of the time since its last progress.
_MORE = 0.1
_ENTERED: "list[Progress]" = []
"""Nested displays, outermost first."""


class Progress:
    """Callable as progress(message, fraction); a context manager that leaves the terminal as it was.

    with Progress("solving") as progress:
        solve_linear(device, progress=progress)

    Nothing is shown while `shown` is False (`fieldmap --quiet`). Of nested displays only the innermost prints lines.
    compiles: whether a first run compiles kernels. timed: whether the share that is done is a share of the time.
    """

    shown = True

    def __init__(self, title: str, compiles: bool = False, timed: bool = False) -> None:
        self.title = title
        self._compiles = compiles and must_compile()
        self._timed = timed and not self._compiles
        self._logged = self._waiting = ""
        self._began = self._nothing_done = time.monotonic()
        self._printed = -math.inf
        self._bar: RichProgress | None = None
        self._task: TaskID | None = None

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
        if fraction == 0.0:
            self._nothing_done = now
        left = self._left(now, fraction)
        if self._bar is not None and self._task is not None:
            words = f"{self.title}: {message}"
            self._bar.update(self._task, completed=fraction, description=words, left=_joined(left, memory()))
            return
        if not self.shown or self in _ENTERED[:-1]:
            return
        spent = now - self._began
        about = _joined(_in_words(spent), left, memory())
        clock = time.strftime("%Y-%m-%d %H:%M:%S")
        self._waiting = f"{clock} {self.title}: {100 * fraction:3.0f} % {message} ({about})"
        if now >= self._printed + max(_LINE_EVERY_SECONDS, _LINE_EVERY_SHARE * spent):
            self._print(now)

    def _left(self, now: float, fraction: float) -> str:
        if not self._timed or not _TOLD_FROM <= fraction < 1.0:
            return ""
        return f"about {_in_words((now - self._nothing_done) * (1.0 / fraction - 1.0))} left"

    def _print(self, now: float) -> None:
        print(self._waiting, file=sys.stderr, flush=True)
        self._waiting, self._printed = "", now

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        _ENTERED.remove(self)
        if self._waiting:
            self._print(time.monotonic())
        if self._bar is not None:
            self._bar.stop()


class Forecast:
    """Estimates the progress of a run with successive stages.

    The reported share is time passed / (time passed + time left). It falls when more work than expected appears.

    stages: expected work of each stage, in order, in seconds on a reference machine. The time left is the remaining
    work times the pace of this machine, which is measured on the work done. workers: returns the number of processes.
    """

    def __init__(
        self,
        say: Callable[[str, float], None],
        stages: Mapping[str, float],
        workers: Callable[[], int] = lambda: 1,
    ) -> None:
        self._say, self._workers = say, workers
        self._work, self._done = dict(stages), defaultdict[str, float](float)
        self._began = self._stage_began = time.monotonic()
        self._stage, self._anew = "", False
        self._begun: set[str] = set()
        # The pace is (_last - _since) / _over: the time until the last progress over the work done in it.
        self._since = self._last = self._began
        self._over = 0.0

    def expect(self, stage: str, work: float) -> None:
        """Set the total work of a stage.

        Parameters
        ----------
        stage
            Its name.
        work
            Seconds as in `stages`.
        """
        self._work[stage] = work

    def expected(self, stage: str) -> float:
        """Total work expected of a stage, in the seconds of `stages`."""
        return self._work[stage]

    def taken(self) -> float:
        """Seconds since the stage began."""
        return time.monotonic() - self._stage_began

    def afresh(self, seconds: float) -> None:
        """Forget the measured pace, because later work has another one.

        Parameters
        ----------
        seconds
            Work that counts as done at the expected pace, so that the time to load libraries weighs little.
        """
        self._last = time.monotonic()
        self._since, self._over = self._last - seconds, seconds

    def at(self, stage: str, message: str, done: float = 0.0, count: float = 1.0) -> None:
        """Report that `done` of `count` equal parts of a stage's work are done. The previous stage is then complete.

        A stage that begins a second time starts from zero, and so do all later stages.
        """
        now, whole = time.monotonic(), self._work[stage]
        work = whole * min(done / count, 1.0)
        first = not self._stage
        if first and not done:
            self._began = now
            self._since = now - self._over
        if stage != self._stage:
            self._begin(stage, now)
        if first or not self._anew:
            self._count(work - self._done[stage], now)
        self._anew = False
        self._done[stage] = work
        # The time since the last progress reduces the time left of this stage, but never to zero.
        pace = (self._last - self._since) / self._over if self._over > 0.0 else 1.0
        since = now - max(self._stage_began, self._last)
        own = max((whole - work) * pace - since, _MORE * since) if work < whole or not whole else 0.0
        others = sum(of - self._done[name] for name, of in self._work.items() if name != stage)
        left = own + pace * others
        # The share is 0 as long as no work is expected.
        run, processes = now - self._began, self._workers()
        share = run / (run + left) if run > 0.0 and any(self._work.values()) else 0.0
        self._say(f"{message}, {processes} workers" if processes > 1 else message, share)

    def note(self, message: str) -> None:
        """Show a message without progress."""
        if self._stage:
            self.at(self._stage, message, self._done[self._stage], self._work[self._stage] or 1.0)
        else:
            self._say(message, 0.0)

    def _begin(self, stage: str, now: float) -> None:
        if self._stage:
            self._count(self._work[self._stage] - self._done[self._stage], now)
            self._done[self._stage] = self._work[self._stage]
        if stage in self._begun:
            names = list(self._work)
            for name in names[names.index(stage) :]:
                self._done[name] = 0.0
        self._begun.add(stage)
        # Work that a stage reports when it begins took no time of this run.
        self._stage, self._stage_began, self._anew = stage, now, True

    def _count(self, work: float, now: float) -> None:
        if work > 0.0:
            self._over += work
            self._last = now


def rate(done: float, seconds: float, unit: str) -> str:
    """The rate of work, to be added to a message; "" at the beginning.

    >>> rate(3, 12.0, "state"), rate(8, 2.0, "map"), rate(0, 2.0, "map")
    (', 4.0 s a state', ', 4.0 maps/s', '')
    """
    if done <= 0 or seconds <= 0.0:
        return ""
    if seconds > done:
        return f", {seconds / done:.1f} s a {unit}"
    each = done / seconds
    return f", {each:.{1 if each < 10.0 else 0}f} {unit}s/s"


def shown_or_silent(
    title: str, progress: Callable[[str, float], None] | bool | None, timed: bool = False
) -> AbstractContextManager[Callable[[str, float], None]]:
    """Context that gives a function progress(message, fraction): `progress` itself if callable, a `Progress` for True,
    a `Progress` on a terminal only for None, and a function that shows nothing for False.

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
    """A line of words, and the bar with its numbers below it: both fit into 80 columns."""
    from rich.console import Console, RenderableType
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as RichProgress
    from rich.text import Text

    class Bar(RichProgress):
        def get_renderables(self) -> Iterator[RenderableType]:
            for task in self.tasks:
                yield Text(task.description, overflow="ellipsis", no_wrap=True)
            yield self.make_tasks_table(self.tasks)

    return Bar(
        BarColumn(bar_width=20),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]}", markup=False),
        console=Console(stderr=True),
        transient=True,
    )


def memory() -> str:
    """Present and peak memory of this process as text; "" without the extra `cli`."""
    try:
        import psutil
    except ImportError:
        return ""
    have = psutil.Process().memory_info()
    most = peak_memory() or getattr(have, "peak_wset", have.rss)
    return f"{have.rss / 1e9:.1f} GB, at most {most / 1e9:.1f} GB"


def peak_memory() -> int | None:
    """Peak memory of this process so far, bytes; None on Windows."""
    try:
        import resource
    except ImportError:
        return None
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # macOS gives bytes, other systems kibibytes.
    return most if sys.platform == "darwin" else 1024 * most


def _in_words(seconds: float) -> str:
    """A time to two digits or more.

    >>> _in_words(599.0), _in_words(601.0), _in_words(36001.0)
    ('599 s', '10 min', '10.0 h')
    """
    if seconds < 600.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 36000.0 else f"{seconds / 3600.0:.1f} h"


def _joined(*words: str) -> str:
    return ", ".join(filter(None, words))


def must_compile() -> bool:
    """Whether no kernel has been compiled yet, so that a first run has to wait.

    False where compiled kernels lie elsewhere: NUMBA_CACHE_DIR is set, or the package's folder cannot be written.
    """
    folder = Path(__file__).parent / "kernels"
    if os.environ.get("NUMBA_CACHE_DIR") or not os.access(folder, os.W_OK):
        return False
    return next(folder.rglob("*.nbi"), None) is None
