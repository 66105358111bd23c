"""One interface for many independent pieces of work, in this process or in others."""

from collections.abc import Callable, Iterator, Sequence
from types import TracebackType
from typing import Any, TypeVar

from fieldmap.arguments import check_count
from fieldmap.errors import InputError
from fieldmap.parallel.work import Common, Outcome, attempt, in_threads, threads_of_kernels

R = TypeVar("R")
_REMEDY = 'install it: pip install "fieldmap[cluster]"'


class Workers:
    """Processes that do the work: this one (count 1), `count` processes of this machine, or those of a dask scheduler.

    A context manager: it starts the processes on entering and ends them on leaving. The processes of a `scheduler`
    ("tcp://host:port", or the path of its scheduler file) keep running; only our unfinished work is cancelled. A script
    that starts processes must begin them below `if __name__ == "__main__":`. Raises InputError for arguments that do
    not fit, if dask.distributed is not installed, or if no scheduler answers.

    >>> with Workers() as workers:
    ...     for outcome in workers.map(abs, [-3, 4]):
    ...         print(outcome.index, outcome.value)
    0 3
    1 4
    """

    def __init__(self, count: int = 1, scheduler: str | None = None) -> None:
        check_count("workers", count=count)
        if count > 1 and scheduler is not None:
            received = f"workers = {count} and scheduler = {scheduler!r}"
            remedy = "leave workers out: the scheduler knows its own"
            raise InputError.of("workers", "either workers or a scheduler", received, remedy)
        self._count, self._scheduler = count, scheduler
        self._pool: Any = None
        self._processor_seconds = 0.0

    def __enter__(self) -> "Workers":
        if not self.alone:
            try:
                from fieldmap.parallel.pool import Pool
            except ModuleNotFoundError as error:
                received = f"no module {error.name}"
                raise InputError.of(
                    "workers", "dask.distributed must be installed", received, _REMEDY
                ) from error
            self._pool = Pool(self._count, self._scheduler)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pool is not None:
            self._pool.close()
            self._pool = None

    def __str__(self) -> str:
        if self._scheduler is not None:
            return "workers of a dask scheduler"
        return "one process" if self._count == 1 else f"{self._count} processes of one machine"

    @property
    def alone(self) -> bool:
        """Whether this process does the work itself."""
        return self._count == 1 and self._scheduler is None

    def processes(self) -> int:
        """Number of processes that do the work now; for a dask scheduler the processes that have joined it."""
        return 1 if self._pool is None else self._pool.processes()

    @property
    def processor_seconds(self) -> float:
        """Processor time of finished pieces of work in other processes, s."""
        return self._processor_seconds

    def prepare(self, common: Common[Any]) -> None:
        """Let other processes make an object for a later `map`, while this process does something else.

        Parameters
        ----------
        common
            The object.
        """
        if self._pool is not None:
            self._pool.prepare(common)

    def map(
        self,
        function: Callable[..., R],
        items: Sequence[Any],
        common: Common[Any] | None = None,
        threads: bool = False,
    ) -> Iterator[Outcome[R]]:
        """function(item), or function(common.here(), item), for every item: one outcome each, as they are done.

        In this process the outcomes are in the order of the items, from other processes in any order. An item whose
        process dies is given to another process. After four deaths the item is tried again, alone, when all others are
        done; if that fails too, its outcome is an error. For other processes, function, items and results must be
        picklable: a function of a module, not a lambda.

        Parameters
        ----------
        function
            The function.
        items
            The items.
        common
            Object that every call needs, and that each process makes once.
        threads
            Whether this process does several items at a time; the function must allow it.

        Yields
        ------
        Outcome[R]
            The outcomes.
        """
        if self._pool is not None:
            for outcome in self._pool.map(function, items, common):
                self._processor_seconds += outcome.processor_seconds
                yield outcome
            return
        if not items:
            return
        shared = () if common is None else (common.here(),)
        count = min(threads_of_kernels(), len(items)) if threads else 1
        if count > 1:
            yield from in_threads(function, items, count, *shared)
            return
        for index, item in enumerate(items):
            yield attempt(index, function, *shared, item)

    def results(
        self, function: Callable[..., R], items: Sequence[Any], common: Common[Any] | None = None
    ) -> list[R]:
        """Results of `map` in the order of the items. Raises the first error that occurs.

        Parameters
        ----------
        function
            The function.
        items
            The items.
        common
            As for `map`.

        Returns
        -------
        list[R]
            The results.
        """
        found = {outcome.index: outcome.result() for outcome in self.map(function, items, common)}
        return [found[index] for index in range(len(items))]
