"""A thousand maps of six pole pieces in one command that is killed twice and run again; and its memory."""

import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import psutil

from fieldmap.maps import generate
from fieldmap.studies import read_study
from validation.map_files import numbers
from validation.row import Row

KILLED_AT = (200, 450)
# Number of maps after which the memory of a process no longer grows.
SETTLED = 100
COMPARED = 12
RECIPE = """
format = 1
title = "Below a pole piece, coarse"
device = "single_electromagnet"
spacing_mm = [2.5, 2.5, 5.0]

[iron]
refinement = 0.4
"""
STUDY = f"""
format = 1
title = "Six pole pieces"
recipe = "poles.toml"

[[vary]]
name = "turns"
key = "coil.1.turns"
values = {[10 * k for k in range(10, 94)]}

[[vary]]
name = "floor"
key = "workspace.lower_mm.3"
values = [-60.0, -55.0]

[[vary]]
name = "radius"
key = "body.core.radius_mm"
values = [15.0, 16.0, 17.0, 18.0, 19.0, 20.0]
"""


def many_maps() -> Iterator[Row]:
    """1 008 maps: six pole pieces, two boxes, 84 numbers of turns."""
    with tempfile.TemporaryDirectory() as name:
        folder, begin = Path(name), time.perf_counter()
        for file, text in (("poles.toml", RECIPE), ("study.toml", STUDY)):
            (folder / file).write_text(text)
        index, study = folder / "many.nc", read_study(folder / "study.toml")
        killed = [_run(folder, index, count)[0] for count in KILLED_AT]
        times = _times(folder)
        exit_code, (settled, end), cpu = _run(folder, index, None, len(study.variants))
        seconds = time.perf_counter() - begin
        files = [folder / "many" / name for name in sorted(_times(folder))]
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
            differing += numbers(files[number]) != numbers(alone)
        yield Row(case, f"of {COMPARED} maps, those that differ in a bit", differing, 0, "made by themselves")
        later = len(files) - len(times) - SETTLED
        note = f"at most {end:.1f} MB in {later} maps, {settled:.1f} MB in the {SETTLED} maps of that run before them"
        yield Row(case, "growth of memory, MB", end - settled, 5, note)


def _run(
    folder: Path, index: Path, stop: int | None, total: int = 0
) -> tuple[int, tuple[float, float], float]:
    """Exit code, peak memory up to SETTLED maps and after them, MB, and processor seconds. The run is killed when
    `stop` maps exist. The index is written after the maps."""
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
            if count - before < SETTLED:
                settled = max(settled, have)
            elif count < total:
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
