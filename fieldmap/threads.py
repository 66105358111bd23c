"""Compiled functions that fill rows of their results, in several threads.

Such a function is a serial one that lets go of the interpreter's lock. It takes the first row and the last + 1 before
its other arguments, and writes to no other rows.
"""

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from typing import Any

_own = threading.local()
_LEAST_WORK = 20_000
"""Units of work, some five nanoseconds each, for which it pays to wake a thread."""
# More pieces than threads: a thread that is slow leaves the remaining pieces to the others.
_PIECES_PER_THREAD = 4


def most_threads() -> int:
    """One for each processor that this process may use, or as many as OMP_NUM_THREADS says."""
    asked = os.environ.get("OMP_NUM_THREADS", "")
    if asked.isdigit() and int(asked) > 0:
        return int(asked)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def thread_count() -> int:
    """How many threads a call from this thread takes: `most_threads`, unless `use_threads` was told otherwise here."""
    return int(getattr(_own, "count", None) or most_threads())


def use_threads(count: int) -> None:
    """Calls from this thread take so many threads from now on, and no more than `most_threads`."""
    _own.count = min(count, most_threads())


def over_rows(kernel: Callable[..., Any], rows: int, *arguments: Any, work: float = 1.0) -> None:
    """kernel(first, last + 1, *arguments) for all of `rows` rows, in as many threads as `thread_count` says.

    work: of one row, in units of some five nanoseconds (one pair of far triangles): few rows of little work are done
    in one thread. A row must not depend on the piece that it lies in: then the number of threads changes no bit of
    the results.
    """
    least = max(1, round(_LEAST_WORK / max(work, 1.0)))
    in_pieces(lambda start, stop: kernel(start, stop, *arguments), rows, least, thread_count())


def in_pieces(part: Callable[[int, int], Any], count: int, least: int, threads: int) -> list[Any]:
    """part(start, stop) over 0..count in pieces of at least `least`, by so many threads, if there are several pieces;
    what they return, in no order.

    `part` must let go of the interpreter's lock, and must not come here itself. Threads are kept between calls, and the
    caller sleeps meanwhile: a thread that is new, or woken by one that goes on running, begins on the same processor
    and waits there for milliseconds.
    """
    most = count // least
    workers = min(threads, most)
    if workers <= 1:
        return [part(0, count)]
    pieces = min(_PIECES_PER_THREAD * workers, most)
    bounds = iter(list(pairwise(count * piece // pieces for piece in range(pieces + 1))))

    def leave_the_rest() -> None:
        for _ in bounds:
            pass

    def work() -> list[Any]:
        try:
            return [part(*both) for both in bounds]
        except BaseException:
            # The caller may be waiting for another thread.
            leave_the_rest()
            raise

    waiting = [_pool().submit(work) for _ in range(workers)]
    try:
        return [value for future in waiting for value in future.result()]
    except BaseException:
        # An interruption: no further pieces, and nothing that still writes when the caller is told.
        leave_the_rest()
        for future in waiting:
            future.cancel() or future.exception()
        raise


@cache
def _pool() -> ThreadPoolExecutor:
    """The threads of all kernels of this process; made when first needed."""
    return ThreadPoolExecutor(os.cpu_count(), "fieldmap kernels")


# Threads do not survive a fork: the child makes its own.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)
