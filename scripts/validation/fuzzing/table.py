"""Run the cases of each kind in a process of its own, and count the outcomes."""

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

PROGRAM = Path(__file__).with_name("program.py")
SILENT_S, START_S = 120, 600
_FRAME = re.compile(r'File "([^"]+)", line (\d+) in (\S+)')
GOOD = ("read", "refused")


@dataclass
class Figures:
    """Counts of results, the largest processor seconds and megabytes of a case, and the failures."""

    counts: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0
    megabytes: float = 0.0
    faults: list[str] = field(default_factory=list)
    wall: float = 0.0


def figures(kind: str, count: int, seed: int, first: int = 0) -> Figures:
    """Run cases `first` to `count` of a kind. If the process ends or hangs, a new one continues after that case."""
    found, begin = Figures(), time.perf_counter()
    while first < count:
        reached = _some(kind, first, count, seed, found)
        if reached is None:
            break
        first = reached + 1
    found.wall = time.perf_counter() - begin
    return found


def _some(kind: str, first: int, count: int, seed: int, found: Figures) -> int | None:
    """Run cases in one process. Returns the number of the case that ended it, or None if all cases were run."""
    command = [sys.executable, "-P", str(PROGRAM), kind, str(first), str(count), str(seed)]
    current, change, done, silent = first, "before the first case", True, []

    def end() -> None:
        silent.append(True)
        # SIGABRT makes the process print its traceback.
        process.send_signal(signal.SIGABRT) if os.name == "posix" else process.kill()

    with (
        tempfile.TemporaryFile("w+") as errors,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True) as process,
    ):
        watchdog = [threading.Timer(START_S, end)]
        watchdog[0].start()
        for line in process.stdout or ():
            watchdog[0].cancel()
            watchdog[0] = threading.Timer(SILENT_S, end)
            watchdog[0].start()
            told = json.loads(line)
            done = "result" in told
            if not done:
                current, change = told["number"], told["change"]
                continue
            found.counts[told["result"]] += 1
            found.seconds = max(found.seconds, told["seconds"])
            found.megabytes = max(found.megabytes, told["megabytes"])
            if told["result"] not in GOOD:
                found.faults.append(f"{told['result']}, case {current}, {change}: {told['why']}")
        watchdog[0].cancel()
        process.wait()
        errors.seek(0)
        error = errors.read()
    if process.returncode == 0:
        return None
    if done and current == first:
        raise RuntimeError(f"{kind}: {error[-2000:]}")
    what, why = (
        ("slow", f"silent for {SILENT_S} s") if silent else ("crash", f"exit code {process.returncode}")
    )
    found.counts[what] += 1
    found.faults.append(f"{what}, {why}, case {current}, {change}: {_place(error) or error[-200:]}")
    return current


def _place(error: str) -> str:
    """The innermost calls in the output of faulthandler, if any."""
    calls = _FRAME.findall(error)[:4]
    return " in ".join(f"{Path(path).name}:{line} {name}" for path, line, name in calls)


if __name__ == "__main__":
    of = figures(
        sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]) if len(sys.argv) > 4 else 0
    )
    print("\n".join(of.faults))
    print(dict(of.counts), f"{of.seconds:.2f} s, {of.megabytes:.0f} MB, wall {of.wall:.0f} s")
