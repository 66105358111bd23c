"""Map files that are corrupted in thousands of ways, or made by a run that is killed repeatedly."""

import json
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import psutil

from fieldmap.store import checkpoint_path
from validation.row import Row

CORRUPTED = 1000
SEEDS = 5
KILLS = 25
# Fewer kills for workers and schedulers, whose start takes some seconds each time.
KILLS_OF_RUNS, KILLS_OF_WORKERS, KILLS_OF_SCHEDULERS = 10, 5, 10
MODEL = "/fieldmap/reduced_model"
RECIPES = {
    "linear iron": """
format = 1
title = "Fifty-five parts"
device = "loop_and_sphere"
spacing_mm = [0.3, 0.6, 0.3]
""",
    "saturating iron": """
format = 1
title = "Thirty-six states and a few parts"
device = "two_cores.toml"
spacing_mm = 2.0

[iron]
model = "saturating"

[currents]
lower_A = [0.5, -1.0]
upper_A = 2.0
states = 32
modes = 12
points = 120
fields = 8
held_out = 4
""",
}
DEVICE = """
format = 1
name = "two_cores"
title = "Two cores on a bar, a coil on each"

[material.steel]
kind = "froehlich"
mu_r = 2000.0
saturation_polarisation_T = 2.0
{bodies}
[workspace]
shape = "box"
lower_mm = [-8.0, -8.0, -16.0]
upper_mm = [8.0, 8.0, -6.0]
"""
BODY = """
[[body]]
name = "{name}"
material = "steel"
shape = "box"
size_mm = {size}
position_mm = {place}
mesh_size_mm = 7.0
"""
COIL = """
[[coil]]
name = "{name}"
kind = "circular"
inner_radius_mm = 8.0
outer_radius_mm = 13.0
height_mm = 14.0
turns = 4000
position_mm = [{x}, 0.0, 10.0]
"""
# Every run is a process of its own, which prints the time of each step.
RUN = """
import json, sys, time
from fieldmap.maps import generate

if __name__ == "__main__":
    begin = float(sys.argv[3])

    def tell(text, share):
        print(f"{time.time() - begin:.3f} {text}", flush=True)

    generate(sys.argv[1], sys.argv[2], progress=tell, accept_error=True, **json.loads(sys.argv[4]))
"""


def corrupted_maps() -> Iterator[Row]:
    """Maps with damaged bytes and forged contents must be refused, or read with their original data."""
    script = Path(__file__).with_name("corrupted_maps.py")
    for seed in range(1, SEEDS + 1):
        begin = time.perf_counter()
        command = [sys.executable, str(script), str(CORRUPTED), str(seed)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        seconds = time.perf_counter() - begin
        if done.returncode:
            last = done.stderr.splitlines()[-1] if done.stderr else "nothing"
            yield Row("corrupted maps", "crash", float("nan"), 0, "", note=f"seed {seed}: {last}")
            continue
        found = json.loads(done.stdout)
        bad = [*found["wrong"], *found["traceback"], *found["hung"]]
        yield Row(
            f"{CORRUPTED} corrupted maps, seed {seed}",
            "other data, other errors, no answer",
            len(bad),
            0,
            f"the map before; {found['refused']} refused, {found['identical']} as before",
            seconds=seconds,
            note="; ".join(bad[:3]),
        )


def killed_runs() -> Iterator[Row]:
    """Linear iron: one run killed 25 times at random moments, against the same run without interruption."""
    yield from _killed("linear iron")


def killed_training() -> Iterator[Row]:
    """Saturating iron, with states that are solved and stored one by one: the same comparison."""
    yield from _killed("saturating iron")


def killed_workers() -> Iterator[Row]:
    """Saturating iron with two worker processes, of this machine or of a dask scheduler. The run is killed ten times;
    then five of its workers are killed during the last run."""
    yield from _killed("saturating iron", KILLS_OF_RUNS, "two processes", workers=2)
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        address = cluster.scheduler_address
        yield from _killed("saturating iron", KILLS_OF_RUNS, "two of a scheduler", scheduler=address)


def killed_schedulers() -> Iterator[Row]:
    """Saturating iron with two workers of a scheduler that is killed ten times, after a few pieces each time. The run
    then fails, and the same command continues with a new scheduler."""
    begin, moments, exits = time.perf_counter(), random.Random(9), []
    with tempfile.TemporaryDirectory() as folder:
        recipe, target = _recipe(Path(folder), "saturating iron"), Path(folder) / "map.h5"
        _run(recipe, target.with_name("compiles.h5"))
        _run(recipe, target.with_name("whole.h5"))
        for _ in range(KILLS_OF_SCHEDULERS):
            with _scheduler(Path(folder)) as (where, scheduler):
                left = moments.randint(1, 3)

                def count(
                    text: str, _: subprocess.Popen[str], scheduler: subprocess.Popen[bytes] = scheduler
                ) -> None:
                    nonlocal left
                    left -= _is_piece(text)
                    if not left:
                        scheduler.kill()

                try:
                    _run(recipe, target, where, count)
                except subprocess.CalledProcessError as error:
                    exits.append(error.returncode)
        with _scheduler(Path(folder)) as (where, _):
            steps = _run(recipe, target, where)
        differing = _differing(target)
    first = next(text for _, text in steps if _is_piece(text))
    seconds, case = time.perf_counter() - begin, "saturating iron, schedulers killed"
    note = f"the run without a break; the last one began with {first}"
    yield Row(case, "data sets that differ in a bit", differing, 0, note, seconds=seconds)
    missing = KILLS_OF_SCHEDULERS - exits.count(1)
    yield Row(
        case, f"runs of {KILLS_OF_SCHEDULERS} that did not end with exit code 1", missing, 0, "each does"
    )


@contextmanager
def _scheduler(folder: Path) -> Iterator[tuple[dict[str, str], subprocess.Popen[bytes]]]:
    """Start a scheduler and two workers, each in a process of its own. Yields their address and the scheduler."""
    file = folder / "scheduler.json"
    file.unlink(missing_ok=True)
    program = [
        sys.executable,
        "-m",
        "distributed.cli.dask_{}",
        "--no-dashboard",
        "--scheduler-file",
        str(file),
    ]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    each = {"scheduler": ["--port", "0"], "worker": ["--nthreads", "1", "--nworkers", "2"]}
    commands = [[part.format(kind) for part in program] + more for kind, more in each.items()]
    scheduler, workers = (subprocess.Popen(command, **quiet) for command in commands)
    try:
        while not file.exists():
            time.sleep(0.1)
        yield {"scheduler": str(file)}, scheduler
    finally:
        scheduler.kill()
        for child in psutil.Process(workers.pid).children(recursive=True):
            child.kill()
        workers.kill()


def _recipe(folder: Path, iron: str) -> Path:
    recipe = folder / "recipe.toml"
    recipe.write_text(RECIPES[iron])
    recipe.with_name("two_cores.toml").write_text(_two_cores())
    return recipe


def _differing(target: Path) -> int:
    """Number of data sets of a map that differ from the run without interruption."""
    whole, ours = numbers(target.with_name("whole.h5")), numbers(target)
    return sum(whole[name] != ours.get(name) for name in whole) + abs(len(ours) - len(whole))


def _killed(iron: str, kills: int = KILLS, by: str = "", **where: Any) -> Iterator[Row]:
    """Compare a run without interruption in one process with a killed run that uses the processes in `where`."""
    begin, case = time.perf_counter(), f"{iron}, {by}" if by else iron
    with tempfile.TemporaryDirectory() as folder:
        recipe, target = _recipe(Path(folder), iron), Path(folder) / "map.h5"
        _run(recipe, target.with_name("compiles.h5"))
        steps = _run(recipe, target.with_name("whole.h5"))
        if where:
            # A run with workers is timed by itself, because workers start slowly.
            steps = _run(recipe, target.with_name("by_others.h5"), where)
        pieces = [second for second, text in steps if _is_piece(text)]
        done, reached = _kill(recipe, target, pieces[0], kills, where)
        if where:
            count, steps = _run_while_workers_die(recipe, target, where)
            yield Row(
                case,
                f"kills of workers missing of {KILLS_OF_WORKERS}",
                KILLS_OF_WORKERS - count,
                0,
                "the run went on",
            )
        else:
            steps = _run(recipe, target)
        resumed = [text for _, text in steps if "resumed" in text]
        differing = _differing(target)
    yield Row(
        f"{case}, {len(pieces)} pieces, killed {done} times",
        "data sets that differ in a bit",
        differing,
        0,
        f"the run without a break; killed while: {', '.join(reached)}; {', '.join(resumed)}",
        seconds=time.perf_counter() - begin,
    )
    yield Row(
        f"{case}, killed",
        f"kills missing of {kills}",
        float(kills - done),
        0,
        "a run that finishes too soon shows less",
    )


def _two_cores() -> str:
    """The device of the saturating run, small for a quick start."""
    bodies = [
        BODY.format(name="bar", size=[60.0, 12.0, 8.0], place=[0.0, 0.0, 20.0]),
        *(
            BODY.format(name=f"core {x:g}", size=[10.0, 10.0, 20.0], place=[x, 0.0, 0.0])
            for x in (-22.0, 22.0)
        ),
        *(COIL.format(name=name, x=x) for name, x in (("left", -22.0), ("right", 22.0))),
    ]
    return DEVICE.format(bodies="".join(bodies))


def _is_piece(text: str) -> bool:
    """Whether a step is a piece of work that is stored by itself."""
    return "nodes, part" in text or text.startswith("state ")


def _kill(
    recipe: Path, target: Path, latest: float, kills: int, where: dict[str, Any]
) -> tuple[int, list[str]]:
    """Start and kill the run `kills` times, at a random moment within three times `latest` seconds, or, so that it does
    not finish, soon after it begins its first, second or third piece. Returns the number of kills and their steps."""
    moments, died = random.Random(7), {}
    for kill in range(kills):
        last, left = "starting", moments.randint(1, 3)
        with subprocess.Popen(
            _command(recipe, target, where), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        ) as process:
            late = threading.Timer(moments.uniform(0.05, 3.0) * latest, process.kill)
            late.start()
            for line in process.stdout or ():
                text = line.strip().partition(" ")[2]
                last = "states" if text.startswith("state ") else text.partition(",")[0]
                left -= _is_piece(text)
                if not left:
                    time.sleep(moments.uniform(0.0, 0.1))
                    process.kill()
            late.cancel()
        if process.returncode != -signal.SIGKILL:
            return kill, [*died, "finished before its time"]
        died[last] = died.get(last, 0) + 1
    return kills, [f"{name} {count}" for name, count in died.items()]


def _run_while_workers_die(
    recipe: Path, target: Path, where: dict[str, Any]
) -> tuple[int, list[tuple[float, str]]]:
    """Run to the end, and kill workers after some pieces. Returns the number of killed workers and the steps."""
    moments, killed = random.Random(8), 0

    def kill_one(text: str, process: subprocess.Popen[str]) -> None:
        nonlocal killed
        if killed == KILLS_OF_WORKERS or not _is_piece(text) or moments.random() < 0.5:
            return
        # Workers of a scheduler are children of this process.
        parent = psutil.Process() if "scheduler" in where else psutil.Process(process.pid)
        workers = [child for child in parent.children(recursive=True) if _is_worker(child)]
        if workers:
            moments.choice(workers).kill()
            killed += 1

    steps = _run(recipe, target, where, kill_one)
    return killed, steps


def _is_worker(process: psutil.Process) -> bool:
    try:
        return "spawn_main" in " ".join(process.cmdline())
    except psutil.Error:
        return False


def _command(recipe: Path, target: Path, where: dict[str, Any]) -> list[str]:
    program = recipe.with_name("run.py")
    program.write_text(RUN)
    return [sys.executable, str(program), str(recipe), str(target), f"{time.time()}", json.dumps(where)]


def _run(
    recipe: Path,
    target: Path,
    where: dict[str, Any] | None = None,
    seen: Callable[[str, subprocess.Popen[str]], None] = lambda text, process: None,
) -> list[tuple[float, str]]:
    """Seconds and text of each step of a run to its end; seen(text, process): called after each."""
    steps = []
    with (
        tempfile.TemporaryFile("w+") as errors,
        subprocess.Popen(
            _command(recipe, target, where or {}), stdout=subprocess.PIPE, stderr=errors, text=True
        ) as process,
    ):
        for line in process.stdout or ():
            second, _, text = line.strip().partition(" ")
            steps.append((float(second), text))
            seen(text, process)
        if process.wait():
            failed = subprocess.CalledProcessError(process.returncode, process.args)
            errors.seek(0)
            failed.add_note(errors.read()[-4000:])
            raise failed
    if checkpoint_path(target).exists():
        raise FileExistsError(checkpoint_path(target))
    return steps


def numbers(path: Path) -> dict[str, bytes]:
    """Bytes of every data set of a map: its fields, and its model if it has one."""
    with h5py.File(path) as file:
        records = [*file["/data/0/meshes"].values(), *([file[MODEL]] if MODEL in file else [])]
        return {data.name: data[()].tobytes() for record in records for data in record.values()}
