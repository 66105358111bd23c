"""Other processes, by dask: a scheduler of our own on this machine, or one that is there already."""

import itertools
import logging
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, TypeVar

import distributed

from fieldmap.errors import InputError
from fieldmap.parallel.work import Common, Outcome, WorkerDied, attempt
from fieldmap.threads import use_threads

R = TypeVar("R")
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
        # A process of ours has one piece in hand, so that its death costs one. Somebody else's scheduler is given all:
        # it may start workers by how many pieces wait.
        self._at_once = count if scheduler is None else None
        if scheduler is None:
            self._threads = max(1, (os.cpu_count() or 1) // count)
            with _without_interrupt():
                self._cluster = _cluster_of(count)
            try:
                self._client = distributed.Client(self._cluster, set_as_default=False)
            except BaseException:
                self._cluster.close()
                raise
        else:
            self._client = _client_of(scheduler)

    def close(self) -> None:
        """Withdraw what is not done, and end our own processes."""
        self._client.close()
        if self._cluster is not None:
            self._cluster.close()

    def prepare(self, common: Common[Any]) -> None:
        """Begin to make `common` in every process that is there now."""
        for address in self._client.scheduler_info(n_workers=-1)["workers"]:
            made = self._client.submit(_make, common, self._threads, workers=[address], pure=False)
            distributed.fire_and_forget(made)

    def map(
        self, function: Callable[..., R], items: Sequence[Any], common: Common[Any] | None
    ) -> Iterator[Outcome[R]]:
        """Outcomes, as they come."""
        shared = () if common is None else (common,)
        waiting = enumerate(items)
        under_way: dict[distributed.Future, int] = {}
        suspects = []

        def begun(index: int, item: Any) -> distributed.Future:
            future = self._client.submit(_work, index, function, shared, item, self._threads, pure=False)
            under_way[future] = index
            return future

        def submit(count: int | None) -> list[distributed.Future]:
            return [begun(index, item) for index, item in itertools.islice(waiting, count)]

        try:
            done = distributed.as_completed(submit(self._at_once), loop=self._client.loop)
            for future in done:
                error = future.exception()
                index = under_way.pop(future)
                done.update(submit(1))
                if isinstance(error, distributed.scheduler.KilledWorker):
                    suspects.append(index)
                    continue
                yield _outcome(future, index)
            # A piece also dies with a process that another one killed: each gets one to itself.
            for index in suspects:
                future = begun(index, items[index])
                outcome = _outcome(future, index)
                del under_way[future]
                yield outcome
        finally:
            self._client.cancel(list(under_way))


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
    """What a piece came to; waits for its end."""
    error = future.exception()
    return future.result() if error is None else Outcome(index, None, _died(error))


def _work(
    index: int, function: Callable[..., Any], shared: tuple[Common[Any], ...], item: Any, threads: int | None
) -> Outcome[Any]:
    """One item, in the process that got it."""
    with _TURN:
        _set_threads(threads)
        outcome = attempt(index, _with_common, function, shared, item)
        spent = outcome.processor_seconds + sum(_UNCOUNTED)
        _UNCOUNTED.clear()
        return replace(outcome, processor_seconds=spent)


def _with_common(function: Callable[..., Any], shared: tuple[Common[Any], ...], item: Any) -> Any:
    return function(*(common.here() for common in shared), item)


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
