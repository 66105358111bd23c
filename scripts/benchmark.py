"""Benchmarks of the package and of other libraries, in one run. `make bench` prints them.

    python scripts/benchmark.py [--only SECTION ...] [--quick] [--json]

Sections: kernels (nanoseconds per point, compared with magpylib), iron (error over seconds and unknowns for an iron
disk, compared with magpylib-material-response of the extra `bench`), peers (validation cases of that program, and a
cube), controllers (steps per second), lookup (a field from a map, compared with five interpolation libraries of the
same extra), generation (points times coils per second, compared with magpylib), dynamics (a levitated magnet in closed
loop, times real time), own (a user's own controllers in Python, numba and C: samples per second), saturating (new
currents of maps of saturating iron, wrenches, currents for a force), app (response to a slider of `fieldmap app`),
magpylib (fields as magpylib sources: time, differences, motion, getFT), derivatives (of a state by numbers of its
device, in solves), traffic (bytes through client and scheduler, with workers) and busy (utilisation of eight workers by
a map of saturating iron and by a study).
The exit code is 0 for any figures. Compare ratios within one run only, and on a machine that does nothing else.

A section is a module with `measure(quick) -> dict` (JSON-ready) and `show(result, console)`.
"""

import argparse
import importlib
import json
import os
import platform
import sys
from pathlib import Path

import magpylib
import numba
import numpy as np
import scipy
from rich.console import Console

SECTIONS = {
    "kernels": "benchmarks.kernels",
    "iron": "benchmarks.iron_disk",
    "controllers": "benchmarks.controllers",
    "peers": "benchmarks.peer_cases",
    "lookup": "benchmarks.lookup",
    "generation": "benchmarks.generation",
    "dynamics": "benchmarks.dynamics",
    "own": "benchmarks.own_controllers",
    "saturating": "benchmarks.saturating_maps",
    "app": "benchmarks.app",
    "magpylib": "benchmarks.magpylib_sources",
    "derivatives": "benchmarks.derivatives",
    "reaction": "benchmarks.reaction",
    "traffic": "benchmarks.traffic",
    "busy": "benchmarks.busy",
}


def machine() -> str:
    """Processor and versions, one line."""
    name = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        models = [
            line for line in info.read_text(encoding="utf-8").splitlines() if line.startswith("model name")
        ]
        name = models[0].split(":", 1)[1].strip() if models else name
    load = f"load {os.getloadavg()[0]:.1f} at the start; " if hasattr(os, "getloadavg") else ""
    versions = f"numpy {np.__version__}, scipy {scipy.__version__}, numba {numba.__version__}"
    return (
        f"{name}, {os.cpu_count()} cores, {load}{platform.system()}, Python {platform.python_version()}, "
        f"{versions}, magpylib {magpylib.__version__}"
    )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", choices=SECTIONS, default=list(SECTIONS), metavar="SECTION")
    parser.add_argument("--quick", action="store_true", help="few points and coarse meshes: to try it out")
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")
    options = parser.parse_args()
    console = Console(width=None if sys.stdout.isatty() else 120, stderr=options.json)
    console.print(machine(), highlight=False)
    results = {"machine": machine()}
    for name in options.only:
        section = importlib.import_module(SECTIONS[name])
        results[name] = section.measure(options.quick)
        if not options.json:
            section.show(results[name], console)
    if options.json:
        print(json.dumps(results, indent=2))


if __name__ == "__main__":
    main()
