"""The mutations of `make validate`: each planted fault of a reader is counted in its category."""

import os
import sys

import pytest

from tests.scripts.conftest import SCRIPTS

PLANTED = """
import os
import signal
import time
from pathlib import Path

import numpy as np

from fieldmap.errors import InputError, Problem
from validation.fuzzing.case import Case, Kind
from validation.fuzzing.mutations import decoys

def refuse():
    raise InputError(Problem("here", "must hold", "that", "do this"))

def say_little():
    raise InputError(Problem("here", "must hold", "", "do this"))

def idle():
    begin = time.process_time()
    while time.process_time() < begin + 1.1:
        pass
    return 1.0

def fall_silent():
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGALRM])
    time.sleep(600)

def prepare(folder):
    secret = decoys(folder) / "secret.toml"
    ways = [
        ("read", lambda: 1.0),
        ("refused", refuse),
        ("wrong", lambda: 2.0),
        ("traceback", lambda: [][0]),
        ("traceback", say_little),
        ("traceback", lambda: np.array([1e308]) * 10),
        ("memory", lambda: np.ones(2**23).sum() * 0 + 1),
        ("memory", lambda: np.empty(2**34)),
        ("slow", idle),
        ("reached out", lambda: len(secret.read_text()) * 0 + 1),
        ("reached out", lambda: exec(compile("pass", str(folder / "a.py"), "exec")) or 1.0),
        ("reached out", lambda: os.system("true") + 1),
        ("crash", os.abort),
        ("slow", fall_silent),
        ("read", lambda: 1.0),
    ]

    def make(rng, number):
        change, read = ways[number]
        return Case(change, read, lambda found: "" if found == 1 else "not 1")

    return make

KIND = Kind("planted", prepare, seconds=1.0, megabytes=20.0, through_command=0)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="files are watched by inotify")
def test_planted_faults_are_counted(program, tmp_path, monkeypatch):
    table = program("validation.fuzzing.table")
    (tmp_path / "planted.py").write_text(PLANTED)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), str(SCRIPTS.parent)]))
    monkeypatch.setattr(table, "SILENT_S", 5)
    found = table.figures("planted:KIND", 15, 0)
    told = [fault.partition(",")[0].partition(" (")[0] for fault in found.faults]
    planted = ["wrong", *["traceback"] * 3, *["memory"] * 2, "slow", *["reached out"] * 3, "crash", "slow"]
    assert told == planted, found.faults
    assert "fall_silent" in found.faults[-1]
    assert (found.counts["read"], found.counts["refused"]) == (2, 1)


def test_sound_files_are_read_and_others_refused(program, monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPTS))
    found = program("validation.fuzzing.table").figures("expressions", 60, 0)
    assert not found.faults
    assert found.counts["read"] > 10
    assert found.counts["refused"] > 10
