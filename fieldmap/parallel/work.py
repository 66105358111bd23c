"""One piece of work: its arithmetic, the objects that it shares with other pieces, and its outcome.

Results are the same in all processes, to the last bit: the order of sums is independent of the number of cores.
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
    """Linear algebra in one thread: the rounding of a BLAS depends on its number of threads.

    Our own kernels keep their threads, because each thread has its own rows of the result. A state of the drive unit
    takes no longer with this limit (docs/cluster.md).
    """
    with _thread_pools().limit(limits=1, user_api="blas"):
        yield


# The modules that were loaded at the last search for thread pools, and its result.
_FOUND: "tuple[tuple[str, ...], ThreadpoolController] | None" = None


def _thread_pools() -> ThreadpoolController:
    """The BLAS and OpenMP libraries that are loaded now. A search takes a hundred times as long as a limit, so it is
    repeated only after new modules were imported, which may have loaded further libraries."""
    global _FOUND
    # Listed before the search: modules imported during it cause another search.
    modules = tuple(sys.modules)
    if _FOUND is None or _FOUND[0] != modules:
        _FOUND = (modules, ThreadpoolController())
    return _FOUND[1]


T = TypeVar("T")
# The last object that this process made. A worker lives longer than a piece of work and must not keep all objects.
_CACHED: "dict[str, Any]" = {}


class Common(Generic[T]):
    """`make(*arguments)`, made in each process at its first use, then cached.

    `make` and `arguments` travel to a worker and must be picklable; the object that they make need not be.
    """

    def __init__(self, make: Callable[..., T], *arguments: Any) -> None:
        self._make, self._arguments, self._made = make, arguments, cast("T | None", None)
        self._key = uuid.uuid4().hex

    @classmethod
    def of(cls, value: T) -> "Common[T]":
        """A common object that travels itself.

        Parameters
        ----------
        value
            The object, which must be picklable.

        Returns
        -------
        'Common[T]'
            The common object.
        """
        return cls(_itself, value)

    def use(self, made: T) -> T:
        """Use an object that this process has made already.

        Parameters
        ----------
        made
            The object.

        Returns
        -------
        T
            The object.
        """
        self._made = made
        return made

    def here(self) -> T:
        """The object of this process, made at the first call."""
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
    """Outcome of one item. index: of the item; value: result of the function, or error: its exception; seconds,
    processor_seconds: wall-clock and processor time."""

    index: int
    value: R | None
    error: Exception | None = None
    seconds: float = 0.0
    processor_seconds: float = 0.0

    def result(self) -> R:
        """The value. Raises the error if there is one."""
        if self.error is not None:
            raise self.error
        return self.value  # type: ignore[return-value]

    @property
    def reason(self) -> str:
        """The error in words; "" if there is a value."""
        if self.error is None:
            return ""
        if isinstance(self.error, FieldmapError):
            return str(self.error)
        return f"{type(self.error).__name__}: {self.error}"


def attempt(index: int, function: Callable[..., R], *arguments: Any) -> Outcome[R]:
    """Call the function. An exception, except an interrupt, becomes part of the outcome."""
    with same_arithmetic():
        return _attempt(index, function, arguments, process_time)


def in_threads(
    function: Callable[..., R], items: Sequence[Any], count: int, *shared: Any
) -> Iterator[Outcome[R]]:
    """function(*shared, item) for every item, in threads of this process.

    Kernels use one thread in each of them. With `count` 1 the calling thread does the work, because handing over a
    small item takes longer than the item.

    Parameters
    ----------
    function
        The function.
    items
        The items.
    count
        Number of threads.
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
                # Submitted one by one: a caller that stops early must not wait for the remaining items.
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
            # The consumer of the outcome may use all threads again.
            use_threads(threads)
        yield outcome


def threads_of_kernels() -> int:
    """Number of threads that may call kernels at the same time: the processors of this process, or the limit set by
    `fieldmap.threads.use_threads`."""
    return thread_count()


def results_of(function: Callable[..., R], items: Sequence[Any]) -> Iterator[R]:
    """function(item) of every item, in `threads_of_kernels()` threads.

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
    """Number of threads that BLAS and LAPACK now use for one product."""
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
            # Tracebacks do not travel between processes, but notes do.
            error.add_note(traceback.format_exc())
        failed = error
    return Outcome(index, value, failed, monotonic() - begin, clock() - processor)
