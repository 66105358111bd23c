"""Map files under fire: spoiled in thousands of ways, and made by a run that is killed again and again."""

import json
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import h5py

from fieldmap.store import partial_path
from validation.row import Row

SPOILED = 1000
SEEDS = 5
KILLS = 25
RECIPE = """
format = 1
title = "Sixty parts"
device = "loop_and_sphere"
spacing_mm = [0.3, 0.6, 0.3]
"""
# Every run is a process of its own, which tells when it began each step.
RUN = """
import sys, time
from fieldmap.maps import generate
begin = float(sys.argv[3])
generate(sys.argv[1], sys.argv[2], progress=lambda text, share: print(f"{time.time() - begin:.3f} {text}", flush=True))
"""


def spoiled_maps() -> Iterator[Row]:
    """Maps with damaged bytes and forged contents: refused, or read as they were."""
    script = Path(__file__).with_name("spoiled_maps.py")
    for seed in range(1, SEEDS + 1):
        begin = time.perf_counter()
        command = [sys.executable, str(script), str(SPOILED), str(seed)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        seconds = time.perf_counter() - begin
        if done.returncode:
            last = done.stderr.splitlines()[-1] if done.stderr else "nothing"
            yield Row("spoiled maps", "crash", float("nan"), 0, "", note=f"seed {seed}: {last}")
            continue
        found = json.loads(done.stdout)
        bad = [*found["wrong"], *found["traceback"], *found["hung"]]
        yield Row(
            f"{SPOILED} spoiled maps, seed {seed}",
            "other data, other errors, no answer",
            len(bad),
            0,
            f"the map before; {found['refused']} refused, {found['identical']} as before",
            seconds=seconds,
            note="; ".join(bad[:3]),
        )


def killed_runs() -> Iterator[Row]:
    """One run killed 25 times at random moments, against the same run without a break."""
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        recipe, target = Path(folder) / "recipe.toml", Path(folder) / "map.h5"
        recipe.write_text(RECIPE)
        _run(recipe, target.with_name("compiles.h5"))
        steps = _run(recipe, target.with_name("whole.h5"))
        parts = [second for second, text in steps if "part " in text and "nodes" in text]
        kills, reached = _kill(recipe, target, parts[0])
        resumed = [text for _, text in _run(recipe, target) if "resumed" in text]
        whole, ours = _numbers(target.with_name("whole.h5")), _numbers(target)
        differing = sum(whole[name] != ours.get(name) for name in whole) + abs(len(ours) - len(whole))
    yield Row(
        f"a run of {len(parts)} parts killed {kills} times",
        "data sets that differ in a bit",
        differing,
        0,
        f"the run without a break; killed while: {', '.join(reached)}; then {', '.join(resumed) or 'begun anew'}",
        seconds=time.perf_counter() - begin,
    )
    yield Row(
        "killed run",
        "kills missing of 25",
        float(KILLS - kills),
        0,
        "a run that finishes too soon shows less",
    )


def _kill(recipe: Path, target: Path, latest: float) -> tuple[int, list[str]]:
    """Start the run and kill it, KILLS times, at a random moment: within `latest` seconds, or soon after it began with
    its first, second or third part, so that the run lasts. In which steps it died, and how often."""
    moments, died = random.Random(7), {}
    for kill in range(KILLS):
        last, left = "starting", moments.randint(1, 3)
        with subprocess.Popen(_command(recipe, target), stdout=subprocess.PIPE, text=True) as process:
            late = threading.Timer(moments.uniform(0.05, 1.5) * latest, process.kill)
            late.start()
            for line in process.stdout or ():
                last = line.strip().partition(" ")[2].partition(",")[0]
                left -= "nodes, part" in line
                if not left:
                    time.sleep(moments.uniform(0.0, 0.1))
                    process.kill()
            late.cancel()
        if process.returncode != -signal.SIGKILL:
            return kill, [*died, "finished before its time"]
        died[last] = died.get(last, 0) + 1
    return KILLS, [f"{name} {count}" for name, count in died.items()]


def _command(recipe: Path, target: Path) -> list[str]:
    return [sys.executable, "-c", RUN, str(recipe), str(target), f"{time.time()}"]


def _run(recipe: Path, target: Path) -> list[tuple[float, str]]:
    """Seconds and text of each step of a run to its end."""
    done = subprocess.run(_command(recipe, target), capture_output=True, text=True, check=True)
    lines = (line.partition(" ") for line in done.stdout.splitlines())
    if partial_path(target).exists():
        raise FileExistsError(partial_path(target))
    return [(float(second), text) for second, _, text in lines]


def _numbers(path: Path) -> dict[str, bytes]:
    with h5py.File(path) as file:
        records = file["/data/0/meshes"].values()
        return {data.name: data[()].tobytes() for record in records for data in record.values()}
