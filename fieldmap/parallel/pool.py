"""Other processes, by dask: a scheduler of our own on this machine, or one that is there already."""

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
# Pieces of work under way for each process: enough for so many seconds, since a cluster of dask that adapts starts
# processes until what was submitted takes five; at least and at most so many. At least so many in all: a cluster may
# have no process before it has work.
_SECONDS_AHEAD, _LEAST_AHEAD, _MOST_AHEAD = 10.0, 2, 100
_LEAST_UNDER_WAY = 16
# Processes are counted again after so many seconds, and ours that are gone for good are replaced.
_COUNTED_FOR_SECONDS = 1.0
_SCALED_EVERY_MILLISECONDS = 2000
# Work that waits for a first process says so this often: a cluster that adapts begins without one.
_NO_PROCESS_TOLD_EVERY_MILLISECONDS = 60_000
_LOG = logging.getLogger("fieldmap.parallel")
# A scheduler that is there answers sooner.
_ANSWERS_WITHIN_SECONDS = 20
# Kernels have one set of threads per process: pieces of work take turns there, whatever number a worker accepts.
_TURN = threading.Lock()
# Processor time that this process took to make what is common; its next piece of work counts it.
_UNCOUNTED: list[float] = []


class Pool:
    """A client of the scheduler, and our own cluster where there is one."""

    def __init__(self, count: int, scheduler: str | None) -> None:
        self._cluster: distributed.LocalCluster | None = None
        self._threads: int | None = None
        # Futures of what was sent once. Dask computes them anew where a worker takes the last copy with it, and drops
        # them with this client.
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
            # Dask replaces a process that dies, but gives up one that dies while it starts. To scale opens it again.
            self._again = PeriodicCallback(partial(self._cluster.scale, count), _SCALED_EVERY_MILLISECONDS)
            self._client.loop.add_callback(self._again.start)  # type: ignore[union-attr]
        else:
            self._client = _client_of(scheduler)

    def close(self) -> None:
        """Withdraw what is not done, and end our own processes."""
        if self._cluster is not None:
            self._client.loop.add_callback(self._again.stop)  # type: ignore[union-attr]
        # Dask would print a traceback where the scheduler is gone.
        with distributed.utils.silence_logging_cmgr(logging.CRITICAL):
            self._client.close()
        if self._cluster is not None:
            self._cluster.close()

    def prepare(self, common: Common[Any]) -> None:
        """Begin to make `common` in every process that is there now."""
        sent = self._send(common)
        for address in self._client.nthreads():
            made = self._client.submit(_make, sent, self._threads, workers=[address], pure=False)
            distributed.fire_and_forget(made)

    def _send(self, common: Common[Any]) -> distributed.Future:
        """A result of dask: a piece of work that names it gets it from another process that has it. To scatter it
        would do so too, but could not replace it where the processes that have it die."""
        if common not in self._sent:
            # It is as large as it is, and travels once.
            with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 TiB"}):
                self._sent[common] = self._client.submit(_itself, common, pure=False)
        return self._sent[common]

    def map(
        self, function: Callable[..., R], items: Sequence[Any], common: Common[Any] | None
    ) -> Iterator[Outcome[R]]:
        """Outcomes, as they come."""
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
            # A piece also dies with a process that another one killed: each gets one to itself.
            for index in suspects:
                future = begun(index, items[index])
                outcome = _outcome(future, index)
                del under_way[future]
                yield outcome
        finally:
            if self._client.status == "running":
                self._client.cancel(list(under_way))

    def _room(self, seconds: float | None) -> int:
        """Pieces that may be under way, where one takes so many seconds; None where no one knows."""
        ahead = 0.0 if seconds is None else _SECONDS_AHEAD / max(seconds, 1e-9)
        each = min(max(_LEAST_AHEAD, math.ceil(ahead)), _MOST_AHEAD)
        return max(_LEAST_UNDER_WAY, each * self.processes())

    def processes(self) -> int:
        """How many there are, counted a moment ago."""
        if monotonic() - self._counted > _COUNTED_FOR_SECONDS:
            self._counted, self._processes = monotonic(), len(self._client.nthreads())
        return self._processes


@contextmanager
def _without_interrupt() -> Iterator[None]:
    """Ctrl-C has no effect in the block, nor in the processes that begin in it.

    A terminal sends it to all of them: the first process ends the others, which say nothing about it. A cluster that
    was interrupted while it starts would be left half started.
    """
    main = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGINT, signal.SIG_IGN) if main else None
    try:
        yield
    finally:
        if main:
            signal.signal(signal.SIGINT, before)


def dask_setup(_: distributed.Worker) -> None:
    """What dask calls in a process of ours: one that takes the place of a dead one begins outside the block."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _cluster_of(count: int) -> distributed.LocalCluster:
    return distributed.LocalCluster(
        n_workers=count,
        threads_per_worker=1,
        # No web page; what dask opens in its place takes any port, where its own one could be taken.
        scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
        # States of the iron may take what memory there is.
        memory_limit=0,
        silence_logs=logging.CRITICAL,
        preload=[__name__],
    )


def _outcome(future: distributed.Future, index: int) -> Outcome[Any]:
    """What a piece came to; waits for its end. Raises CancelledError where the scheduler is gone."""
    error = future.exception()
    # A future that is cancelled has no exception, but its result is one.
    return future.result() if error is None else Outcome(index, None, _died(error))


def _itself(common: Common[Any]) -> Common[Any]:
    return common


def _work(
    index: int, function: Callable[..., Any], common: Common[Any] | None, item: Any, threads: int | None
) -> Outcome[Any]:
    """One item, in the process that got it."""
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
    """As many as we have for each of our own processes, or as a worker of somebody else's scheduler was given."""
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
    """Not the default of the process: one that does not connect would be left behind as the default."""
    return distributed.Client(**where, timeout=_ANSWERS_WITHIN_SECONDS, set_as_default=False)


def _died(error: BaseException) -> Exception:
    if isinstance(error, distributed.scheduler.KilledWorker):
        remedy = "see the workers' own messages: most often one needs more memory than it was given"
        received = "the death of every process that tried"
        return WorkerDied.of("a piece of work", "a worker that survives it", received, remedy)
    return error if isinstance(error, Exception) else RuntimeError(repr(error))
