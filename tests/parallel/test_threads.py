"""Rows of results, filled by several threads."""

import os
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from fieldmap import threads
from fieldmap.threads import in_pieces, over_rows


def add_one(begin, end, out):
    for i in range(begin, end):
        out[i] += i


@pytest.fixture
def two_threads():
    """Two threads, even with one processor."""
    switch = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    yield 2
    sys.setswitchinterval(switch)


@pytest.mark.parametrize("count", [0, 1, 7, 8, 9, 100, 1001])
@pytest.mark.parametrize("least", [1, 4, 10_000])
def test_every_row_is_filled_once(count, least, two_threads):
    out = np.zeros(count)
    in_pieces(lambda begin, end: add_one(begin, end, out), count, least, two_threads)
    assert out.tolist() == list(range(count))


def test_pieces_are_no_smaller_than_asked(two_threads):
    sizes = in_pieces(lambda begin, end: end - begin, 103, 10, two_threads)
    assert sum(sizes) == 103
    assert min(sizes) >= 10
    assert len(sizes) == 8


def test_few_rows_of_little_work_stay_in_the_thread_of_the_caller(monkeypatch):
    monkeypatch.setattr(threads, "thread_count", lambda: 2)

    def names(rows, work):
        found = []
        over_rows(lambda *_: found.append(threading.current_thread().name), rows, work=work)
        return found

    own = threading.current_thread().name
    assert names(100, 10.0) == [own]
    assert names(1, 1e9) == [own]
    assert own not in names(100, 1e6)
    assert len(names(100, 1e6)) == 8


def test_no_more_threads_than_allowed(monkeypatch):
    inside, most, lock = [0], [0], threading.Lock()

    def part(begin, end):
        with lock:
            inside[0] += 1
            most[0] = max(most[0], inside[0])
        time.sleep(0.002)
        with lock:
            inside[0] -= 1

    with ThreadPoolExecutor(8) as pool:
        monkeypatch.setattr(threads, "_pool", lambda: pool)
        in_pieces(part, 64, 1, 3)
    assert most[0] == 3


@pytest.mark.parametrize("fails", [0, 10])
def test_an_error_is_raised_and_the_rest_is_left(fails, two_threads):
    """In either thread, because the caller waits for one after the other."""
    begun, raised = [], threading.Event()

    def part(begin, end):
        begun.append(begin)
        if begin == fails:
            raised.set()
            raise ZeroDivisionError
        # Only the error may keep the other thread from the remaining pieces.
        raised.wait(60)
        time.sleep(0.05)

    with pytest.raises(ZeroDivisionError):
        in_pieces(part, 80, 1, two_threads)
    left = len(begun)
    assert left < 8
    time.sleep(0.1)
    assert len(begun) == left


def test_several_callers_at_once(two_threads):
    outs = [np.zeros(500) for _ in range(4)]

    def call(out):
        for _ in range(20):
            in_pieces(lambda begin, end: add_one(begin, end, out), len(out), 5, two_threads)

    callers = [threading.Thread(target=call, args=(out,)) for out in outs]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join(60)
    for out in outs:
        np.testing.assert_array_equal(out, 20.0 * np.arange(500))


def test_a_thread_counts_for_itself_and_takes_no_more_than_there_are(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    found = []

    def other():
        found.append(threads.thread_count())
        threads.use_threads(1)
        found.append(threads.thread_count())

    one = threading.Thread(target=other)
    one.start()
    one.join()
    assert found == [3, 1]
    with ThreadPoolExecutor(1, initializer=threads.use_threads, initargs=(99,)) as pool:
        assert pool.submit(threads.thread_count).result() == 3
    monkeypatch.setenv("OMP_NUM_THREADS", "many")
    assert threads.most_threads() == len(os.sched_getaffinity(0))
