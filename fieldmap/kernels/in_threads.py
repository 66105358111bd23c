"""Kernels that fill rows of their results, in several threads.

numba divides loops among threads itself (`parallel=True`), but compiles each of them twice for it, and some of its
layers may not be entered from two threads at once or after a fork. A kernel here is a serial one that lets go of the
interpreter's lock: it takes the first row and the last + 1 before its other arguments, and writes to no other rows.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from typing import Any

import numba

_LEAST_WORK = 20_000
"""Units of work, some five nanoseconds each, for which it pays to wake a thread."""
# More pieces than threads, which each takes when it has done one: who is held up leaves the rest to the others.
_PIECES_PER_THREAD = 4


def over_rows(kernel: Callable[..., Any], rows: int, *arguments: Any, work: float = 1.0) -> None:
    """kernel(first, last + 1, *arguments) for all of `rows` rows, in as many threads as `numba.get_num_threads` says.

    work: of one row, in units of some five nanoseconds (one pair of far triangles): few rows of little work are done
    in one thread. A row must not depend on the piece that it lies in: then the number of threads changes no bit of
    the results.
    """
    least = max(1, round(_LEAST_WORK / max(work, 1.0)))
    # Not compiled, a kernel holds the lock.
    threads = 1 if numba.config.DISABLE_JIT else numba.get_num_threads()  # type: ignore[attr-defined]
    in_pieces(lambda start, stop: kernel(start, stop, *arguments), rows, least, threads)


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
