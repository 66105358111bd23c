"""Serial kernels in several threads, each on some rows of the result.

Such a kernel is a compiled function that releases the interpreter's lock. Its first two arguments are the first row and
the last row + 1. It writes to these rows only.
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
"""Least work of one thread, in units of about five nanoseconds: waking a thread for less does not pay."""
# More pieces than threads: a thread that is slow leaves the remaining pieces to the others.
_PIECES_PER_THREAD = 4


def most_threads() -> int:
    """Number of threads: OMP_NUM_THREADS if it is set, otherwise one for each processor that this process may use."""
    asked = os.environ.get("OMP_NUM_THREADS", "")
    if asked.isdigit() and int(asked) > 0:
        return int(asked)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def thread_count() -> int:
    """Number of threads for calls from this thread: `most_threads`, or less if `use_threads` was called in it."""
    return int(getattr(_own, "count", None) or most_threads())


def use_threads(count: int) -> None:
    """Set the number of threads for later calls from this thread; `most_threads` is the upper limit."""
    _own.count = min(count, most_threads())


def over_rows(kernel: Callable[..., Any], rows: int, *arguments: Any, work: float = 1.0) -> None:
    """Call kernel(first, last + 1, *arguments) on pieces of all rows, in `thread_count` threads.

    The result of a row must not depend on the piece in which it lies. Then results have the same bits for any number of
    threads.

    Parameters
    ----------
    kernel
        Function that releases the interpreter's lock.
    rows
        Number of rows.
    arguments
        Further arguments of the kernel.
    work
        Work of one row, in units of about five nanoseconds (one pair of far triangles). A small total is done
        in one thread.
    """
    least = max(1, round(_LEAST_WORK / max(work, 1.0)))
    in_pieces(lambda start, stop: kernel(start, stop, *arguments), rows, least, thread_count())


def in_pieces(part: Callable[[int, int], Any], count: int, least: int, threads: int) -> list[Any]:
    """Call part(start, stop) on pieces of 0..count, in several threads if there are several pieces.

    Threads are kept between calls, and the caller waits while they work. A new thread, or one that is woken by a thread
    that goes on running, would begin on the processor of that thread and wait there for milliseconds.

    Parameters
    ----------
    part
        Function that releases the interpreter's lock and does not call `in_pieces`.
    count
        Number of items.
    least
        Smallest number of items in a piece.
    threads
        Most threads.

    Returns
    -------
    list[Any]
        The results of the pieces, in no particular order.
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
            # The other threads stop as well: the caller may be waiting for one of them.
            leave_the_rest()
            raise

    waiting = [_pool().submit(work) for _ in range(workers)]
    try:
        return [value for future in waiting for value in future.result()]
    except BaseException:
        # After an error or an interruption no further piece begins, and every thread ends before the caller gets the
        # exception: none may still write to its arrays.
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
