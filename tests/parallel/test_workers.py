"""Pieces of work in this process and in others: the same outcomes despite failures and killed processes."""

import json
import logging
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from fieldmap.errors import InputError, NotConverged, Problem
from fieldmap.parallel import Common, SchedulerLost, WorkerDied, Workers, in_threads, same_arithmetic


@pytest.fixture(scope="module")
def two():
    with Workers(2) as workers:
        yield workers


@pytest.fixture(scope="module")
def one():
    with Workers() as workers:
        yield workers


# Functions are made inside functions, so that they are pickled by value: workers cannot import this file.
def tricky():
    from fieldmap.errors import NotConverged, Problem

    def work(offset, item):
        if item == "bug":
            raise TypeError("not meant")
        if item == "hard":
            raise NotConverged(Problem("here", "a", "b", "c"), residuals=(1.0, 0.5))
        return offset + item

    return work


@pytest.mark.parametrize("workers", ["one", "two"])
def test_every_item_has_its_outcome(workers, request):
    items = [1, "hard", 3, "bug", 5]
    found = list(request.getfixturevalue(workers).map(tricky(), items, Common(float, 10)))
    assert sorted(outcome.index for outcome in found) == [0, 1, 2, 3, 4]
    by_index = {outcome.index: outcome for outcome in found}
    assert [by_index[k].result() for k in (0, 2, 4)] == [11.0, 13.0, 15.0]
    hard, bug = by_index[1], by_index[3]
    assert hard.error.problems == (Problem("here", "a", "b", "c"),)
    assert hard.error.residuals == (1.0, 0.5)
    assert hard.reason == "here: a; received b; c"
    assert bug.reason.startswith("TypeError: ")
    # The place of the mistake is kept, also from another process.
    assert "in work" in bug.error.__notes__[0]
    with pytest.raises(NotConverged):
        hard.result()
    assert by_index[0].reason == ""


def test_other_processes_do_the_work_and_results_come_in_order(two):
    def where(item):
        import time

        time.sleep(0.2)
        return item, os.getpid()

    found = two.results(where, list(range(8)))
    assert [item for item, _ in found] == list(range(8))
    processes = {process for _, process in found}
    assert len(processes) == 2
    assert os.getpid() not in processes


def test_other_processes_leave_ctrl_c_to_the_first(two):
    """Otherwise each worker would print its own traceback."""
    import signal

    def ignored(_):
        import signal

        return signal.getsignal(signal.SIGINT) is signal.SIG_IGN

    assert all(two.results(ignored, list(range(6))))
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_what_is_common_is_made_once_in_every_process_and_never_sent(two):
    def make(size):
        # A lock cannot be pickled, like a factorisation.
        import threading

        return threading.Lock(), size, object()

    def work(made, item):
        import os
        import time

        time.sleep(0.05)
        return os.getpid(), id(made[2]), made[1] + item

    common = Common(make, 100)
    two.prepare(common)
    found = two.results(work, list(range(12)), common)
    assert [number for *_, number in found] == list(range(100, 112))
    made = {(process, identity) for process, identity, _ in found}
    assert len(made) == len({process for process, _ in made}) == 2
    assert common.use("mine") == common.here() == "mine"


def test_a_killed_process_costs_only_its_piece(two, tmp_path):
    log = tmp_path / "log"

    def work(item):
        import os
        import signal
        import time

        with open(log, "a") as file:
            file.write(f"{item}\n")
        if item == 3 and log.read_text().split().count("3") == 1:
            os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(0.1)
        return item**2

    assert two.results(work, list(range(8))) == [item**2 for item in range(8)]
    begun = log.read_text().split()
    assert begun.count("3") == 2
    # The killed process had one piece in work, and perhaps a result that had not been fetched.
    assert len(begun) <= 8 + 2


def test_a_piece_that_kills_every_process_is_an_outcome_too(two):
    def work(item):
        import os
        import signal
        import time

        time.sleep(0.2)
        if item == 1:
            os.kill(os.getpid(), signal.SIGKILL)
        return item

    # Other pieces die with it, some as often as it does.
    by_index = {outcome.index: outcome for outcome in two.map(work, range(8))}
    assert {k: outcome.value for k, outcome in by_index.items() if k != 1} == {
        k: k for k in range(8) if k != 1
    }
    assert isinstance(by_index[1].error, WorkerDied)


def test_workers_of_a_scheduler_that_is_there_are_used_and_left_alone():
    with Workers(2) as own:
        client = own._pool._client
        with Workers(scheduler=client.scheduler.address) as workers:
            found = workers.results(lambda item: os.getpid(), range(8))
        assert set(found) <= set(client.run(os.getpid).values())
        assert own.results(abs, [-1]) == [1]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"count": 0}, "1 or more; received 0"),
        ({"count": 2, "scheduler": "tcp://127.0.0.1:8786"}, "either workers or a scheduler"),
        ({"scheduler": "nonsense://x"}, "address of a dask scheduler; received 'nonsense"),
    ],
)
def test_arguments_that_make_no_sense(arguments, words):
    with pytest.raises(InputError, match=words), Workers(**arguments):
        pass


def test_without_dask_the_remedy_is_named(monkeypatch):
    monkeypatch.delitem(sys.modules, "fieldmap.parallel.pool", raising=False)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"\[cluster\]"), Workers(2):
        pass


def test_errors_of_ours_survive_a_pickle():
    error = NotConverged(Problem("a", "b", "c", "d"), residuals=(0.1,))
    again = pickle.loads(pickle.dumps(error))
    assert (again.problems, again.residuals, str(again)) == (error.problems, error.residuals, str(error))


def test_the_arithmetic_has_one_thread_and_then_as_many_as_before():
    from threadpoolctl import threadpool_info

    def threads():
        np.ones(2) @ np.ones(2)
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    before = threads()
    with same_arithmetic():
        assert set(threads()) == {1}
    assert threads() == before


LOADED_LATER = """
from threadpoolctl import threadpool_info, threadpool_limits
from fieldmap.parallel import same_arithmetic, threads_of_linear_algebra

def threads():
    return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

with same_arithmetic():
    first = threads()
import scipy.linalg
assert len(threads()) > len(first), "scipy has no BLAS of its own here"
threadpool_limits(2, user_api="blas")
assert set(threads()) == {threads_of_linear_algebra()} == {2}, threads()
with same_arithmetic():
    assert set(threads()) == {threads_of_linear_algebra()} == {1}, threads()
assert set(threads()) == {2}, threads()
"""


def test_a_library_that_is_loaded_later_has_one_thread_as_well():
    subprocess.run([sys.executable, "-c", LOADED_LATER], check=True)


INTERRUPTED = """
import os, signal, time
from fieldmap.parallel import Workers

# Ignored where the tests themselves run in the background of a shell.
signal.signal(signal.SIGINT, signal.default_int_handler)

def work(folder):
    open(os.path.join(folder, str(os.getpid())), "w").close()
    time.sleep(60)

if __name__ == "__main__":
    import sys
    with Workers(2) as workers:
        list(workers.map(work, [sys.argv[1]] * 4))
"""


def alive(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    with open(f"/proc/{process}/stat") as file:
        return file.read().rsplit(")", 1)[1].split()[0] != "Z"


@pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc")
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL], ids=["interrupted", "killed"])
def test_no_process_is_left_behind(tmp_path, how):
    script, marks = tmp_path / "script.py", tmp_path / "marks"
    script.write_text(INTERRUPTED)
    marks.mkdir()
    # A process group, because Ctrl-C on a terminal goes to the group.
    main = subprocess.Popen([sys.executable, script, marks], start_new_session=True, stderr=subprocess.PIPE)
    wait_until(lambda: len(list(marks.iterdir())) == 2)
    begin = time.monotonic()
    (os.killpg if how == signal.SIGINT else os.kill)(main.pid, how)
    main.communicate(timeout=30)
    workers = [int(mark.name) for mark in marks.iterdir()]
    wait_until(lambda: not any(alive(process) for process in workers))
    assert time.monotonic() - begin < 30


def wait_until(true):
    end = time.monotonic() + 60
    while not true():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_threads_give_outcomes_in_order_and_several_items_are_under_way():
    barrier = threading.Barrier(2, timeout=20)

    def work(offset, item):
        if item < 2:
            # Both items pass the barrier only if they are in work at the same time.
            barrier.wait()
        if item == 4:
            raise NotConverged(Problem("here", "a", "b", "c"), residuals=(1.0,))
        return offset + item, threading.get_ident()

    found = list(in_threads(work, range(8), 2, 10))
    assert [outcome.index for outcome in found] == list(range(8))
    assert found[4].error.problems == (Problem("here", "a", "b", "c"),)
    good = [outcome.value for outcome in found if outcome.index != 4]
    assert [value for value, _ in good] == [10, 11, 12, 13, 15, 16, 17]
    assert threading.get_ident() not in {thread for _, thread in good}


def test_whoever_stops_early_waits_for_what_is_under_way_and_no_more():
    begun = []
    outcomes = in_threads(begun.append, range(100), 2)
    next(outcomes)
    outcomes.close()
    assert len(begun) <= 4


def test_an_interruption_leaves_at_once():
    def work(item):
        if item == 1:
            raise KeyboardInterrupt
        return item

    outcomes = in_threads(work, range(4), 2)
    assert next(outcomes).value == 0
    with pytest.raises(KeyboardInterrupt):
        next(outcomes)


@contextmanager
def scheduler_of(folder, workers):
    """Address of a scheduler in a process of its own, the process, and a function that starts a worker for it."""
    file, started = folder / "scheduler.json", []

    def start(*arguments):
        command = [sys.executable, "-m", *arguments, "--no-dashboard", "--scheduler-file", str(file)]
        started.append(subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL))
        return started[-1]

    def worker():
        return start("distributed.cli.dask_worker", "--nthreads", "1", "--no-nanny")

    scheduler = start("distributed.cli.dask_scheduler", "--port", "0")
    try:
        wait_until(file.exists)
        for _ in range(workers):
            worker()
        yield str(file), scheduler, worker
    finally:
        for process in started:
            process.kill()
            process.wait()


def test_what_is_common_passes_client_and_scheduler_once(two):
    """Sent with each of 200 pieces, a megabyte would be 600 MB of traffic; here it is read and written four times for
    the first worker, and not again."""
    from scripts.benchmarks.traffic import counted

    def work(data, item):
        import time

        time.sleep(0.01)
        return float(data[item])

    data = np.random.default_rng(3).random(125_000)
    with counted() as passed:
        found = two.results(work, range(200), Common.of(data))
    assert found == data[:200].tolist()
    assert passed[0] < 8 * data.nbytes


def test_pieces_wait_here_until_there_is_room(two):
    """Of ten thousand pieces only the first few are taken from the iterator."""

    class Items(list):
        looked_at = 0

        def __iter__(self):
            for item in super().__iter__():
                Items.looked_at += 1
                yield item

    outcomes = two.map(slowly(), Items(range(10_000)))
    assert {next(outcomes).error for _ in range(4)} == {None}
    outcomes.close()
    # A piece takes 0.1 s, so 100 pieces per process are ten seconds of work.
    assert Items.looked_at <= 2 * 100 + 4


def slowly():
    def work(item):
        import time

        time.sleep(0.1)
        return item

    return work


def test_a_worker_that_comes_later_takes_part_with_what_is_common(tmp_path):
    def work(made, item):
        import os
        import time

        time.sleep(0.05)
        return os.getpid(), float(made[item])

    data = np.random.default_rng(4).random(150)
    with scheduler_of(tmp_path, 1) as (file, _, worker), Workers(scheduler=file) as workers:
        outcomes = workers.map(work, range(150), Common.of(data))
        found = [next(outcomes)]
        first, second = found[0].value[0], worker()
        while found[-1].value[0] == first:
            found.append(next(outcomes))
        # All workers that have the data die.
        os.kill(first, signal.SIGKILL)
        second.kill()
        third = worker()
        found += outcomes
    assert [one.value[1] for one in sorted(found, key=lambda one: one.index)] == data.tolist()
    assert {one.value[0] for one in found} == {first, second.pid, third.pid}


def test_a_scheduler_without_workers_is_told_of_and_waited_for(tmp_path, monkeypatch):
    from fieldmap.parallel import pool

    monkeypatch.setattr(pool, "_NO_PROCESS_TOLD_EVERY_MILLISECONDS", 100)
    told, handler = [], logging.Handler()
    handler.emit = lambda record: told.append((record.levelno, record.getMessage()))
    log = logging.getLogger("fieldmap")
    log.addHandler(handler)
    try:
        with scheduler_of(tmp_path, 0) as (file, _, worker), Workers(scheduler=file) as workers:
            address = json.loads(Path(file).read_text())["address"]
            threading.Thread(target=lambda: (time.sleep(1), worker())).start()
            assert workers.results(abs, [-3, 4]) == [3, 4]
            before = len(told)
            assert workers.results(abs, [-5]) == [5]
            time.sleep(0.5)
            # One more message may have been on its way when the worker came; with a worker or without work none comes.
            assert len(told) <= before + 1
    finally:
        log.removeHandler(handler)
    assert len(told) >= 5
    assert {level for level, _ in told} == {logging.WARNING}
    assert all(address in message for _, message in told)


def test_a_scheduler_that_dies_ends_the_run_with_an_error_at_once(tmp_path):
    found = []

    def interrupted(file, scheduler):
        with Workers(scheduler=file) as workers:
            for outcome in workers.map(slowly(), range(10_000)):
                found.append(outcome.result())
                if len(found) == 5:
                    scheduler.kill()

    with scheduler_of(tmp_path, 2) as (file, scheduler, _):
        begin = time.monotonic()
        with pytest.raises(SchedulerLost):
            interrupted(file, scheduler)
        # Ten thousand pieces would take minutes.
        assert time.monotonic() - begin < 15
    assert len(found) >= 5
