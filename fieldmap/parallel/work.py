"""One piece of work: the arithmetic that it is done in, what it shares with the others, and how it ends.

Whoever computes, the last bits are the same: linear algebra sums in an order that does not follow the number of cores.
"""

import itertools
import sys
import traceback
import uuid
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from time import monotonic, process_time, thread_time
from typing import Any, Generic, TypeVar, cast

from threadpoolctl import ThreadpoolController

from fieldmap.errors import FieldmapError
from fieldmap.records import Record
from fieldmap.threads import thread_count, use_threads


@contextmanager
def same_arithmetic() -> Iterator[None]:
    """Linear algebra in one thread: a BLAS divides its sums by the number of its threads, and so rounds otherwise.

    Our own kernels keep theirs: each of their threads has its own rows of the result, in whatever number. A state of
    the drive unit takes no longer for it (docs/cluster.md).
    """
    with _thread_pools().limit(limits=1, user_api="blas"):
        yield


# The modules that were loaded when the thread pools were looked for, and what was found.
_FOUND: "tuple[tuple[str, ...], ThreadpoolController] | None" = None


def _thread_pools() -> ThreadpoolController:
    """The BLAS and OpenMP libraries that are loaded now. To look through all libraries takes a hundred times as long as
    to limit those found; a further one comes with a module that needs it."""
    global _FOUND
    # Before the look: what is loaded meanwhile is looked for next time.
    modules = tuple(sys.modules)
    if _FOUND is None or _FOUND[0] != modules:
        _FOUND = (modules, ThreadpoolController())
    return _FOUND[1]


T = TypeVar("T")
# The one that this process made last. A worker outlives a piece of work, so it must not keep them all.
_CACHED: "dict[str, Any]" = {}


class Common(Generic[T]):
    """`make(*arguments)`, made where and when it is first asked for, then cached.

    What travels to a worker is `make` and `arguments`, which must be picklable; what they make need not be.
    """

    def __init__(self, make: Callable[..., T], *arguments: Any) -> None:
        self._make, self._arguments, self._made = make, arguments, cast("T | None", None)
        self._key = uuid.uuid4().hex

    @classmethod
    def of(cls, value: T) -> "Common[T]":
        """Something that can travel itself.

        Parameters
        ----------
        value
            It.

        Returns
        -------
        'Common[T]'
            It, as a common thing.
        """
        return cls(_itself, value)

    def use(self, made: T) -> T:
        """Take what this process has made already, in its own way.

        Parameters
        ----------
        made
            It.

        Returns
        -------
        T
            It.
        """
        self._made = made
        return made

    def here(self) -> T:
        """This process's own."""
        if self._made is None:
            if self._key not in _CACHED:
                _CACHED.clear()
                _CACHED[self._key] = self._make(*self._arguments)
            self._made = _CACHED[self._key]
        return self._made

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_made": None}


def _itself(value: T) -> T:
    return value


R = TypeVar("R")


class WorkerDied(FieldmapError):  # noqa: N818 - reads as what happened
    """Every process that was given a piece of work died on it."""


class SchedulerLost(FieldmapError):  # noqa: N818 - reads as what happened
    """The dask scheduler ended, or cannot be reached any more, before the work was done."""


@dataclass(frozen=True, eq=False, repr=False)
class Outcome(Record, Generic[R]):
    """index: of the item; value: what the function returned, or error: what it raised; seconds of the clock and of the
    processors that it took."""

    index: int
    value: R | None
    error: Exception | None = None
    seconds: float = 0.0
    processor_seconds: float = 0.0

    def result(self) -> R:
        """The value; raises the error where there is one."""
        if self.error is not None:
            raise self.error
        return self.value  # type: ignore[return-value]

    @property
    def reason(self) -> str:
        """Why there is no value, in words; "" where there is one."""
        if self.error is None:
            return ""
        if isinstance(self.error, FieldmapError):
            return str(self.error)
        return f"{type(self.error).__name__}: {self.error}"


def attempt(index: int, function: Callable[..., R], *arguments: Any) -> Outcome[R]:
    """Call the function; an error becomes part of the outcome, unless it is an interruption."""
    with same_arithmetic():
        return _attempt(index, function, arguments, process_time)


def in_threads(
    function: Callable[..., R], items: Sequence[Any], count: int, *shared: Any
) -> Iterator[Outcome[R]]:
    """function(*shared, item) for every item, in threads of this process.

    Kernels use one thread in each of them. One thread is the caller's own: to hand each item to another and
    wait for it takes longer than a small one.

    Parameters
    ----------
    function
        The function.
    items
        The items.
    count
        How many threads.
    *shared
        First arguments of every call.

    Yields
    ------
    Outcome[R]
        Outcomes in the order of the items.
    """
    if count == 1:
        with same_arithmetic():
            yield from _in_this_thread(function, items, shared)
        return
    with same_arithmetic(), ThreadPoolExecutor(count, initializer=use_threads, initargs=(1,)) as executor:
        tasks = (
            executor.submit(_attempt, index, function, (*shared, item), thread_time)
            for index, item in enumerate(items)
        )
        under_way = deque(itertools.islice(tasks, count))
        try:
            while under_way:
                outcome = under_way.popleft().result()
                # Not all at once: whoever stops early must not wait for the others.
                under_way.extend(itertools.islice(tasks, 1))
                yield outcome
        finally:
            for future in under_way:
                future.cancel()


def _in_this_thread(
    function: Callable[..., R], items: Sequence[Any], shared: tuple[Any, ...]
) -> Iterator[Outcome[R]]:
    for index, item in enumerate(items):
        threads = thread_count()
        use_threads(1)
        try:
            outcome = _attempt(index, function, (*shared, item), thread_time)
        finally:
            # Whoever takes the outcome has all of its threads again.
            use_threads(threads)
        yield outcome


def threads_of_kernels() -> int:
    """How many threads may call kernels at the same time: the processors of this process, or what
    `fieldmap.threads.use_threads` has left of them."""
    return thread_count()


def results_of(function: Callable[..., R], items: Sequence[Any]) -> Iterator[R]:
    """function(item) of every item, in as many threads as may call kernels.

    Parameters
    ----------
    function
        The function.
    items
        The items.

    Yields
    ------
    R
        Results in the order of the items.
    """
    return (outcome.result() for outcome in in_threads(function, items, threads_of_kernels()))


def threads_of_linear_algebra() -> int:
    """How many threads BLAS and LAPACK take for one product, here and now."""
    return max(
        (pool["num_threads"] for pool in _thread_pools().info() if pool["user_api"] == "blas"), default=1
    )


def _attempt(
    index: int, function: Callable[..., R], arguments: tuple[Any, ...], clock: Callable[[], float]
) -> Outcome[R]:
    begin, processor = monotonic(), clock()
    value, failed = None, None
    try:
        value = function(*arguments)
    except Exception as error:
        if not isinstance(error, FieldmapError):
            # Tracebacks do not travel between processes; where to look for the mistake should.
            error.add_note(traceback.format_exc())
        failed = error
    return Outcome(index, value, failed, monotonic() - begin, clock() - processor)
