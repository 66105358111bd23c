"""Work in other processes by dask, with our own scheduler on this machine or an existing one."""

import itertools
import logging
import math
import os
import signal
import threading
import uuid
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from time import monotonic
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import dask.config
import dask.utils
import distributed
from tornado.ioloop import PeriodicCallback

from fieldmap.errors import InputError
from fieldmap.parallel.work import Common, Outcome, SchedulerLost, WorkerDied, attempt
from fieldmap.threads import use_threads

R = TypeVar("R")
# Pieces of work submitted ahead, per process: enough for this many seconds, within the two limits. An adaptive cluster
# of dask starts processes until the submitted work takes five seconds.
_SECONDS_AHEAD, _LEAST_AHEAD, _MOST_AHEAD = 10.0, 2, 100
# Least number of submitted pieces in all: an adaptive cluster may have no process before it has work.
_LEAST_UNDER_WAY = 16
# Time after which processes are counted again, and time between replacements of our processes that died.
_COUNTED_FOR_SECONDS = 1.0
_SCALED_EVERY_MILLISECONDS = 2000
# Time between warnings that the work waits for a first process: an adaptive cluster begins without one.
_NO_PROCESS_TOLD_EVERY_MILLISECONDS = 60_000
_LOG = logging.getLogger("fieldmap.parallel")
# Limit for the connection to a scheduler. A running scheduler answers sooner.
_ANSWERS_WITHIN_SECONDS = 20
# Kernels have one set of threads per process, so pieces of work take turns, even if a worker accepts several.
_TURN = threading.Lock()
# Processor time of this process for making a `Common`. The next piece of work includes it.
_UNCOUNTED: list[float] = []


class Pool:
    """A client of the scheduler, and our own cluster unless the scheduler is an existing one."""

    def __init__(self, count: int, scheduler: str | None) -> None:
        self._cluster: distributed.LocalCluster | None = None
        self._threads: int | None = None
        # Futures of objects that were sent. Dask recomputes a future when the last worker that holds it dies, and drops
        # the futures with this client.
        self._sent: WeakKeyDictionary[Common[Any], distributed.Future] = WeakKeyDictionary()
        self._counted, self._processes = -math.inf, 0
        if scheduler is None:
            self._threads = max(1, (os.cpu_count() or 1) // count)
            with _without_interrupt():
                self._cluster = _cluster_of(count)
            try:
                self._client = distributed.Client(self._cluster, set_as_default=False)
            except BaseException:
                self._cluster.close()
                raise
            # Dask replaces a process that dies, but not one that dies while it starts. `scale` starts that one again.
            self._again = PeriodicCallback(partial(self._cluster.scale, count), _SCALED_EVERY_MILLISECONDS)
            self._client.loop.add_callback(self._again.start)  # type: ignore[union-attr]
        else:
            self._client = _client_of(scheduler)

    def close(self) -> None:
        """Cancel unfinished work, and end our own processes."""
        if self._cluster is not None:
            self._client.loop.add_callback(self._again.stop)  # type: ignore[union-attr]
        # Dask would print a traceback if the scheduler has ended.
        with distributed.utils.silence_logging_cmgr(logging.CRITICAL):
            self._client.close()
        if self._cluster is not None:
            self._cluster.close()

    def prepare(self, common: Common[Any]) -> None:
        """Begin to make `common` in every present process."""
        sent = self._send(common)
        for address in self._client.nthreads():
            made = self._client.submit(_make, sent, self._threads, workers=[address], pure=False)
            distributed.fire_and_forget(made)

    def _send(self, common: Common[Any]) -> distributed.Future:
        """A future of `common`, which processes copy from each other. Unlike scattered data, dask can recompute it when
        the processes that hold it die."""
        if common not in self._sent:
            # The object travels once, so dask need not warn of its size.
            with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 TiB"}):
                self._sent[common] = self._client.submit(_itself, common, pure=False)
        return self._sent[common]

    def map(
        self, function: Callable[..., R], items: Sequence[Any], common: Common[Any] | None
    ) -> Iterator[Outcome[R]]:
        """Outcomes in the order in which they are done."""
        told = PeriodicCallback(self._tell_of_no_process, _NO_PROCESS_TOLD_EVERY_MILLISECONDS)
        loop = self._client.loop
        loop.add_callback(told.start)  # type: ignore[union-attr]
        try:
            yield from self._map(function, items, common)
        except Exception as error:
            if self._client.status == "running" and not isinstance(error, CancelledError):
                raise
            remedy = "start a scheduler and do the same again: what is finished and kept is not done again"
            must_hold = "the dask scheduler must stay there until the work is done"
            raise SchedulerLost.of("workers", must_hold, "no connection to it", remedy) from error
        finally:
            loop.add_callback(told.stop)  # type: ignore[union-attr]

    async def _tell_of_no_process(self) -> None:
        if self._client.status == "running" and not await self._client.scheduler.ncores():  # type: ignore[union-attr]
            where = self._client.scheduler.address  # type: ignore[union-attr]
            _LOG.warning("the dask scheduler at %s has no worker: the work waits until one comes", where)

    def _map(
        self, function: Callable[..., R], items: Sequence[Any], common: Common[Any] | None
    ) -> Iterator[Outcome[R]]:
        sent = None if common is None else self._send(common)
        name, numbers = f"{dask.utils.funcname(function)}-{uuid.uuid4().hex}", itertools.count()
        waiting = enumerate(items)
        under_way: dict[distributed.Future, int] = {}
        suspects, done_so_far, seconds = [], 0, 0.0

        def begun(index: int, item: Any) -> distributed.Future:
            key = (name, next(numbers))
            future = self._client.submit(_work, index, function, sent, item, self._threads, key=key)
            under_way[future] = index
            return future

        def more() -> list[distributed.Future]:
            room = self._room(seconds / done_so_far if done_so_far else None) - len(under_way)
            return [begun(index, item) for index, item in itertools.islice(waiting, max(0, room))]

        try:
            done = distributed.as_completed(more(), loop=self._client.loop)
            for future in done:
                index = under_way[future]
                outcome = _outcome(future, index)
                del under_way[future]
                done_so_far, seconds = done_so_far + 1, seconds + outcome.seconds
                done.update(more())
                if isinstance(outcome.error, WorkerDied):
                    suspects.append(index)
                    continue
                yield outcome
            # A piece may also have died with a process that another piece killed, so each is tried again alone.
            for index in suspects:
                future = begun(index, items[index])
                outcome = _outcome(future, index)
                del under_way[future]
                yield outcome
        finally:
            if self._client.status == "running":
                self._client.cancel(list(under_way))

    def _room(self, seconds: float | None) -> int:
        """Number of pieces to submit ahead. seconds: mean duration of a piece; None if not known."""
        ahead = 0.0 if seconds is None else _SECONDS_AHEAD / max(seconds, 1e-9)
        each = min(max(_LEAST_AHEAD, math.ceil(ahead)), _MOST_AHEAD)
        return max(_LEAST_UNDER_WAY, each * self.processes())

    def processes(self) -> int:
        """Number of processes, at most `_COUNTED_FOR_SECONDS` old."""
        if monotonic() - self._counted > _COUNTED_FOR_SECONDS:
            self._counted, self._processes = monotonic(), len(self._client.nthreads())
        return self._processes


@contextmanager
def _without_interrupt() -> Iterator[None]:
    """Ctrl-C has no effect in the block, nor in the processes that begin in it.

    A terminal sends Ctrl-C to all processes. Only the first process handles it, and ends the others. An interrupt
    during the start would leave a half-started cluster.
    """
    main = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGINT, signal.SIG_IGN) if main else None
    try:
        yield
    finally:
        if main:
            signal.signal(signal.SIGINT, before)


def dask_setup(_: distributed.Worker) -> None:
    """Called by dask in each of our processes. A process that replaces a dead one begins outside the block above."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _cluster_of(count: int) -> distributed.LocalCluster:
    return distributed.LocalCluster(
        n_workers=count,
        threads_per_worker=1,
        # No web page. Dask still opens a server, which takes any free port instead of its fixed one.
        scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
        # States of the iron may take all of the memory.
        memory_limit=0,
        silence_logs=logging.CRITICAL,
        preload=[__name__],
    )


def _outcome(future: distributed.Future, index: int) -> Outcome[Any]:
    """The outcome of a piece, after its end. Raises CancelledError if the scheduler has ended."""
    error = future.exception()
    # `exception` of a cancelled future is None, but `result` raises CancelledError.
    return future.result() if error is None else Outcome(index, None, _died(error))


def _itself(common: Common[Any]) -> Common[Any]:
    return common


def _work(
    index: int, function: Callable[..., Any], common: Common[Any] | None, item: Any, threads: int | None
) -> Outcome[Any]:
    """Do one item in a worker process."""
    with _TURN:
        _set_threads(threads)
        outcome = attempt(index, _with_common, function, common, item)
        spent = outcome.processor_seconds + sum(_UNCOUNTED)
        _UNCOUNTED.clear()
        return replace(outcome, processor_seconds=spent)


def _with_common(function: Callable[..., Any], common: Common[Any] | None, item: Any) -> Any:
    return function(item) if common is None else function(common.here(), item)


def _make(common: Common[Any], threads: int | None) -> None:
    with _TURN:
        _set_threads(threads)
        _UNCOUNTED.append(attempt(0, common.here).processor_seconds)


def _set_threads(threads: int | None) -> None:
    """Set the threads of the kernels: `threads` in our own processes; None for the number of a foreign dask worker."""
    wanted = distributed.get_worker().state.nthreads if threads is None else threads
    use_threads(wanted)


def _client_of(scheduler: str) -> distributed.Client:
    try:
        if os.path.isfile(scheduler):
            return _client(scheduler_file=scheduler)
        return _client(address=scheduler)
    except (OSError, ValueError) as error:
        remedy = "start one with   dask scheduler   and copy the address that it prints"
        received = f"{scheduler!r}: {str(error).splitlines()[0] if str(error) else type(error).__name__}"
        raise InputError.of("scheduler", "the address of a dask scheduler", received, remedy) from error


def _client(**where: str) -> distributed.Client:
    """A client that is not the default of the process: a failed connection would leave its client as the default."""
    return distributed.Client(**where, timeout=_ANSWERS_WITHIN_SECONDS, set_as_default=False)


def _died(error: BaseException) -> Exception:
    if isinstance(error, distributed.scheduler.KilledWorker):
        remedy = "see the workers' own messages: most often one needs more memory than it was given"
        received = "the death of every process that tried"
        return WorkerDied.of("a piece of work", "a worker that survives it", received, remedy)
    return error if isinstance(error, Exception) else RuntimeError(repr(error))
