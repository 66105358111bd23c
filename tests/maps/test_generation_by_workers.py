"""Maps made by several processes have the bits of one process, even if a process dies or is stopped."""

import re
import subprocess
import sys

import pytest

from fieldmap.maps import generate
from fieldmap.store import checkpoint_path
from tests.maps.conftest import SATURATING
from tests.store.conftest import numbers_in

LINEAR = """
format = 1
title = "Two cores, linear"
device = "two_cores.toml"
spacing_mm = 2.0

[iron]
refinement = 0.7
"""

FINER = SATURATING.replace("2.5", "2.0").format(
    refinement=0.7, states=12, accuracy="1e-6", modes=20, points=100, fields=4, held_out=2
)

# As in test_kill.py: processes of their own, with the kernels from the cache.
BEGIN = """
import os, signal, sys
import psutil
from distributed import LocalCluster
from fieldmap.maps import generate
from fieldmap.store import map_format

# Three parts of three planes of nodes.
map_format.NODES_PER_CHUNK = 180
# Ignored where the tests themselves run in the background of a shell.
signal.signal(signal.SIGINT, signal.default_int_handler)
folder = sys.argv[1]

def at(moment, act):
    waiting = [moment]
    def tell(text, share):
        print(text, flush=True)
        if waiting and waiting[0] in text:
            waiting.clear()
            act()
    return tell
"""

FINISHED = """
def kill_a_worker():
    workers = [p for p in psutil.Process().children() if any("spawn_main" in word for word in p.cmdline())]
    assert len(workers) == 2
    workers[0].kill()

if __name__ == "__main__":
    for name in ("linear", "saturating"):
        generate(f"{folder}/{name}.toml", f"{folder}/one_{name}.h5", accept_error=True)
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0", silence_logs=50) as cluster:
        to = {"scheduler": cluster.scheduler_address}
        generate(f"{folder}/linear.toml", f"{folder}/two_linear.h5", **to)
        tell = at("state 5 of", kill_a_worker)
        generate(f"{folder}/saturating.toml", f"{folder}/two_saturating.h5", progress=tell, accept_error=True, **to)
"""

STOPPED = """
if __name__ == "__main__":
    tell = at("state 10 of", lambda: os.killpg(os.getpid(), signal.SIGINT))
    try:
        generate(f"{folder}/saturating.toml", f"{folder}/resumed.h5", workers=2, progress=tell)
    except KeyboardInterrupt:
        print("stopped, archive there:", os.path.exists(f"{folder}/resumed.h5.partial"))
    generate(f"{folder}/saturating.toml", f"{folder}/resumed.h5", progress=at("", print), accept_error=True)
"""


def run(folder, name, rest):
    script = folder / name
    script.write_text(BEGIN + rest)
    command = [sys.executable, script, folder]
    # A process group of its own, which Ctrl-C on a terminal reaches.
    done = subprocess.run(command, capture_output=True, text=True, check=False, start_new_session=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.fixture(scope="module")
def folder(tmp_path_factory, two_cores):
    """Device and recipes, with every kernel compiled."""
    path = tmp_path_factory.mktemp("workers")
    files = {"two_cores.toml": two_cores, "linear.toml": LINEAR, "saturating.toml": FINER}
    for name, text in files.items():
        (path / name).write_text(text)
    for name in ("linear", "saturating"):
        generate(path / f"{name}.toml", path / "compiles.h5", accept_error=True)
    return path


@pytest.fixture(scope="module")
def told(folder):
    """The maps of one process and of two workers; and the progress texts of the last run."""
    return run(folder, "finished.py", FINISHED)


def same(one, other):
    mine, theirs = numbers_in(one), numbers_in(other)
    assert len(mine) > 25
    assert mine.keys() == theirs.keys()
    return [name for name in mine if mine[name] != theirs[name]] == []


def test_two_workers_of_a_scheduler_give_the_bits_of_one_process(folder, told):
    assert same(folder / "one_linear.h5", folder / "two_linear.h5")


def test_a_worker_killed_in_the_middle_changes_no_bit(folder, told):
    assert any(re.search(r"state 5 of .* 12", text) for text in told)
    assert same(folder / "one_saturating.h5", folder / "two_saturating.h5")


def test_an_interrupted_run_is_resumed_without_workers_to_the_same_bits(folder, told):
    lines = run(folder, "stopped.py", STOPPED)
    stop = lines.index("stopped, archive there: True")
    states = [text for text in lines[stop:] if text.startswith("state")]
    # At least nine states were kept; the first reported state is a missing one.
    assert int(states[0].split()[1]) >= 10
    assert same(folder / "one_saturating.h5", folder / "resumed.h5")
    assert not checkpoint_path(folder / "resumed.h5").exists()
