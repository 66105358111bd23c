"""Large maps, made, opened and looked up by processes with less than 2 GB, compared with small maps of the devices.

Ten million nodes of six coils take 6 GB in the folder for temporary files, two hundred coils at a million nodes 21 GB.
"""

import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from validation.row import Row

LIMIT = 2e9
DEVICE = """
format = 1
name = "two_hundred_coils"
title = "Two hundred coils below a plate"

[material.steel]
kind = "linear"
mu_r = 1000.0

[[body]]
name = "plate"
material = "steel"
shape = "box"
size_mm = [210.0, 110.0, 6.0]
position_mm = [0.0, 0.0, 13.0]
mesh_size_mm = 20.0
{coils}
[workspace]
shape = "box"
lower_mm = [-20.0, -20.0, -40.0]
upper_mm = [20.0, 20.0, -20.0]
"""
COIL = """
[[coil]]
name = "{name}"
kind = "circular"
inner_radius_mm = 1.5
outer_radius_mm = 4.5
height_mm = 8.0
turns = 200
position_mm = [{x}, {y}, 5.0]
"""
# Case -> device, cells along each axis of the large map and of a small map, and options of the iron.
CASES = {
    "1e7 nodes, 6 coils": ("disk_six_cores", (216, 216, 216), 24, {"refinement": 0.5, "tolerance": 1e-2}),
    "1e6 nodes, 200 coils": ("two_hundred_coils.toml", (104, 104, 96), 12, {"tolerance": 1e-2}),
}
# Each step runs in a process of its own, which prints a line of JSON. The limit counts the address space on Linux.
BEGIN = """
import json, resource, sys, time
import numpy as np
import fieldmap as fm

resource.setrlimit(resource.RLIMIT_DATA, (int({limit}), int({limit})))

def done(**found):
    found["peak"] = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(json.dumps(found))

begin, spent = time.perf_counter(), time.process_time()
"""
MAKE = """
device = fm.read_device({device!r})
lower, upper = device.bounds
path = fm.generate(
    device, {path!r}, spacing=(upper - lower) / {cells}, iron={iron}, large={large}, accept_error=True, progress=False
)
done(seconds=time.perf_counter() - begin, processor=time.process_time() - spent)
"""
CHECK = """
from fieldmap.store import check_map
found = check_map({path!r})
done(seconds=time.perf_counter() - begin, worst=max(found.divergence, found.curl, found.total))
"""
# Opening is timed the second time, when all modules are loaded. Lookups: the least processor time of seven, in turns.
LOOK = """
from pathlib import Path
fm.open_map({small!r})
opening = []
for _ in range(3):
    begun = time.perf_counter()
    large = fm.open_map({path!r})
    opening.append(time.perf_counter() - begun)
small = fm.open_map({small!r})
rng = np.random.default_rng(1)
currents = rng.normal(size=len(large.coil_names))
size = large.upper - large.lower
at_random = large.lower + rng.random((100_000, 3)) * size
line = np.linspace(0.1, 0.9, 100_000)[:, None]
near = large.lower + size * np.hstack([0.5 + 0.3 * np.sin(9 * line), 0.5 + 0.3 * np.cos(7 * line), line])
ratios = {{}}
for name, points in (("random", at_random), ("neighbours", near)):
    times = {{id(one): [] for one in (large, small)}}
    for _ in range(8):
        for one in (large, small):
            spent = time.process_time()
            one.field_and_gradient(points, currents)
            times[id(one)].append(time.process_time() - spent)
    best = [min(times[id(one)][1:]) for one in (large, small)]
    ratios[name] = best[0] / best[1]
    ratios[name + " ns"] = 1e4 * best[0]
    ratios[name + " first"] = times[id(large)][0] / times[id(small)][0]
flux = [one.field(at_random, currents) for one in (large, small)]
apart = np.linalg.norm(flux[0] - flux[1], axis=1).max() / np.linalg.norm(flux[1], axis=1).max()
done(opening=min(opening), apart=float(apart), size=Path({path!r}).stat().st_size, cells=large.nbytes, **ratios)
"""


def _run(program: str, **values: object) -> dict[str, float]:
    """Run a program in a process of its own, with a limit of its memory, and return its output."""
    text = (BEGIN + program).format(limit=LIMIT, **values)
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(done.stderr.strip().splitlines()[-1] if done.stderr else "no message")
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def large_maps() -> Iterator[Row]:
    """Memory, time to open and time of lookups of two large maps."""
    for case, (device, cells, few, iron) in CASES.items():
        folder = Path(tempfile.mkdtemp(prefix="large_maps_"))
        try:
            yield from _rows(case, folder, device, cells, few, iron)
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def _rows(
    case: str, folder: Path, device: str, cells: tuple[int, int, int], few: int, iron: dict[str, float]
) -> Iterator[Row]:
    if device.endswith(".toml"):
        places = [(10.0 * i - 95.0, 10.0 * j - 45.0) for i in range(20) for j in range(10)]
        coils = "".join(COIL.format(name=k + 1, x=x, y=y) for k, (x, y) in enumerate(places))
        (folder / device).write_text(DEVICE.format(coils=coils), encoding="utf-8")
        device = str(folder / device)
    path, small = str(folder / "large.h5"), str(folder / "small.h5")
    common = {"device": device, "iron": iron}
    made = _run(MAKE, path=path, cells=list(cells), large=True, **common)
    _run(MAKE, path=small, cells=few, large=False, **common)
    source = "less than 2 GB"
    yield Row(
        case,
        "making: memory, GB",
        made["peak"] / 1e9,
        LIMIT / 1e9,
        source,
        0,
        0,
        made["seconds"],
        made["processor"],
    )
    look = _run(LOOK, path=path, small=small)
    note = f"file of {look['size'] / 1e9:.1f} GB, {look['cells'] / 1e6:.0f} MB of coefficients"
    yield Row(case, "lookups: memory, GB", look["peak"] / 1e9, LIMIT / 1e9, source, note=note)
    yield Row(case, "opening, s", look["opening"], 1.0, "under a second")
    for name, bound in (("random", 1.5), ("neighbours", 1.1)):
        note = (
            f"{look[name + ' ns']:.0f} ns a point; the first time {look[name + ' first']:.1f} times as long"
        )
        yield Row(case, f"time of 1e5 points, {name}", look[name], bound, "the small map's", note=note)
    yield Row(case, "difference of B", look["apart"], 1e-4, "the small map")
    checked = _run(CHECK, path=path)
    yield Row(case, "check: memory, GB", checked["peak"] / 1e9, LIMIT / 1e9, source, 0, 0, checked["seconds"])
