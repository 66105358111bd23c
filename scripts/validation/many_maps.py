"""A thousand maps of six pole pieces in one command, which is killed twice and run again; its memory."""

import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import psutil

from fieldmap.maps import generate
from fieldmap.studies import read_study
from validation.row import Row

KILLED_AT = (200, 450)
# Maps after which a process has all that it keeps.
SETTLED = 100
COMPARED = 12
DEVICE = """
format = 1
name = "pole"
title = "A pole piece in a coil, coarse"

[material.iron]
kind = "linear"
mu_r = 1000.0

[[body]]
name = "pole"
material = "iron"
shape = "cylinder"
radius_mm = 8.0
height_mm = 20.0
position_mm = [0.0, 0.0, 0.0]
mesh_size_mm = 5.0

[[coil]]
name = "upper"
kind = "circular"
inner_radius_mm = 14.0
outer_radius_mm = 20.0
height_mm = 16.0
turns = 400
position_mm = [0.0, 0.0, 10.0]

[workspace]
shape = "box"
lower_mm = [-6.0, -6.0, -16.0]
upper_mm = [6.0, 6.0, -5.0]
"""
RECIPE = """
format = 1
title = "Below a pole piece"
device = "pole.toml"
spacing_mm = 2.5
"""
STUDY = f"""
format = 1
title = "Six pole pieces"
recipe = "poles.toml"

[[vary]]
name = "turns"
key = "coil.upper.turns"
values = {[10 * k for k in range(10, 94)]}

[[vary]]
name = "floor"
key = "workspace.lower_mm.3"
values = [-16.0, -18.0]

[[vary]]
name = "radius"
key = "body.pole.radius_mm"
values = [6.5, 7.0, 7.5, 8.0, 8.5, 9.0]
"""


def many_maps() -> Iterator[Row]:
    """1 008 maps: six pole pieces, two boxes, 84 numbers of turns."""
    with tempfile.TemporaryDirectory() as name:
        folder, begin = Path(name), time.perf_counter()
        for file, text in (("pole.toml", DEVICE), ("poles.toml", RECIPE), ("study.toml", STUDY)):
            (folder / file).write_text(text)
        index = folder / "many.nc"
        killed = [_run(folder, index, count)[0] for count in KILLED_AT]
        times = _times(folder)
        exit_code, memory, cpu = _run(folder, index, None)
        seconds = time.perf_counter() - begin
        study = read_study(folder / "study.toml")
        files = sorted((folder / "many").glob("*.h5"))
        case, kept = (
            f"{len(study.variants)} maps",
            sum(_times(folder)[file] == at for file, at in times.items()),
        )
        missing = len(study.variants) - len(files) + exit_code
        source = f"one for each variant; the command was killed {killed.count(-9)} times"
        yield Row(case, "maps missing", missing, 0, source, seconds=seconds, cpu_seconds=cpu)
        yield Row(case, "finished maps made again", len(times) - kept, 0, f"{len(times)} before the last run")
        chosen = random.Random(3).sample(range(len(files)), COMPARED)
        alone = folder / "alone.h5"
        differing = 0
        for number in chosen:
            settings = dict(study.variants[number].settings)
            generate(folder / "poles.toml", alone, resume=False, changes=settings)
            differing += _numbers(files[number]) != _numbers(alone)
        yield Row(case, f"of {COMPARED} maps, those that differ in a bit", differing, 0, "made by themselves")
        settled, end = memory
        # The geometry kernel keeps some 50 kB for each device that it checks and meshes.
        later = len(files) - len(times) - SETTLED
        note = f"{settled:.0f} MB after {SETTLED} maps of the last run, at most {end:.0f} MB later"
        yield Row(case, "growth of memory a map, kB", 1e3 * (end - settled) / later, 200, note)


def _run(folder: Path, index: Path, stop: int | None) -> tuple[int, tuple[float, float], float]:
    """Exit code, memory after some maps and the most after them, MB, and processor seconds; killed once so many maps
    are there."""
    words = ["map", str(folder / "poles.toml"), "--over", str(folder / "study.toml"), "-o", str(index)]
    before, settled, most, cpu = len(_times(folder)), 0.0, 0.0, 0.0
    with subprocess.Popen(
        [sys.executable, "-m", "fieldmap", "--quiet", *words], stdout=subprocess.DEVNULL
    ) as one:
        process = psutil.Process(one.pid)
        while one.poll() is None:
            count = len(_times(folder))
            try:
                have, spent = process.memory_info().rss / 1e6, process.cpu_times()
            except psutil.Error:
                break
            cpu = spent.user + spent.system or cpu
            if count - before >= SETTLED:
                settled = settled or have
                most = max(most, have)
            if stop is not None and count >= stop:
                one.kill()
                break
            time.sleep(0.1)
    return one.returncode, (settled, most), cpu


def _times(folder: Path) -> dict[str, int]:
    """Finished maps, with the time of each file."""
    return {
        file.name: file.stat().st_mtime_ns
        for file in (folder / "many").glob("[0-9]*.h5")
        if file.stem.isdigit()
    }


def _numbers(path: Path) -> dict[str, bytes]:
    with h5py.File(path) as file:
        found: dict[str, bytes] = {}
        file["/data/0/meshes"].visititems(
            lambda name, of: (
                found.update({name: np.asarray(of).tobytes()}) if isinstance(of, h5py.Dataset) else None
            )
        )
        return found
