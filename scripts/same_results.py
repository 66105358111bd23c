"""Do two versions of the package give the same data? Runs everything that is shipped, and compares number by number.

    python scripts/same_results.py run BEFORE --package ../before     # a checkout of the older commit
    python scripts/same_results.py run AFTER
    python scripts/same_results.py compare BEFORE AFTER

`run` drives the command line only: maps, rows of the thesis, scenarios, solutions, exports. It skips what its folder
holds already, so it goes on where it was stopped. `--only` takes the names of cases or their beginnings (`map`,
`simulate`, `thesis`, ...). `compare` prints one line for each file: equal to the last bit, or the largest difference
relative to the largest value of the same array. Exit code 1 if a difference is above `--tolerance`, or if a file is
missing. Times, dates, versions and texts are not compared, nor what is rounding by nature: residuals, and deviations
from known values.

The last bits of compiled code depend on which kernels were compiled together and which were read from the cache. For a
comparison to the last bit both versions start from a clone without compiled kernels and run the same cases in the same
order. Where a controller reads through a converter, a last bit grows to the step of the converter.
"""

import argparse
import json
import math
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

ROOT = Path(__file__).parent.parent
MAPS = ("quick", "linear", "workspace", "division", "saturating")
NOT_DATA = re.compile(
    r"second|date|version|fingerprint|time_s|elapsed|minutes|hash|sha256|author|software|seal|memory"
    r"|timing|processor|clock|path|machine$|bytes|(^|/)about$|size|residual$|deviation$",
    re.IGNORECASE,
)
"""Names of attributes, data sets and keys that differ from run to run: costs, dates and where files lie."""


@dataclass(frozen=True)
class Case:
    """One command: its words after `fieldmap`, in the folder of results; what it prints is kept as NAME.json."""

    name: str
    words: tuple[str, ...]


def cases() -> Iterator[Case]:
    """All commands, in an order in which each finds what it needs."""
    for recipe in MAPS:
        # This checkout's own recipe, which the other version may lack, or have under this name for another map.
        file = str(ROOT / "maps" / f"{recipe}.toml")
        yield Case(f"map_{recipe}", ("map", file, "-o", f"{recipe}.h5", "--json"))
        yield Case(f"info_{recipe}", ("info", f"{recipe}.h5", "--json"))
        probe = ("--at", "0.004", "-0.003", "-0.095", "--currents", "1.5", "--payload")
        yield Case(f"probe_{recipe}", ("probe", f"{recipe}.h5", *probe, "--json"))
    for recipe in ("quick", "linear", "workspace"):
        lift = ("--height-mm", "-95", "--payload-of", "drive_unit")
        yield Case(f"equilibrium_{recipe}", ("equilibrium", f"{recipe}.h5", *lift, "--json"))
    for device in ("loop_and_sphere", "single_electromagnet", "disk_six_cores"):
        yield Case(f"solve_{device}", ("solve", device, "--json"))
    saturated = ("--nonlinear", "--currents", "1.5,1.2,1.5,1.5,1.8,1.5", "--refinement", "0.6")
    below = ("--at", "0", "0", "-0.09")
    yield Case("solve_drive_unit", ("solve", "drive_unit", *saturated, *below, "--json"))
    for name in sorted(path.stem for path in (ROOT / "maps/scenarios").glob("*.toml")):
        recipe = "linear" if name == "hold" else "division"
        words = ("simulate", before(name), "--map", f"{recipe}.h5", "-o", f"{before(name)}.h5", "--json")
        yield Case(f"simulate_{before(name)}", words)
    yield Case("linearise_hold", ("linearise", "hold", "--map", "linear.h5", "--json"))
    linearise = ("linearise", "spikes", "--map", "division.h5", "--depths", "10,15", "--json")
    yield Case("linearise_spikes", linearise)
    for kind, file in (
        ("c", "quick.fmap"),
        ("csv", "quick.csv"),
        ("vti", "quick.vti"),
        ("mag-manip", "quick.yaml"),
    ):
        yield Case(f"export_{kind}", ("export", "quick.h5", "--to", kind, "-o", file, "--json"))
    yield Case(
        "export_c_global",
        ("export", "quick.h5", "--to", "c", "--kind", "global", "-o", "global.fmap", "--json"),
    )
    yield Case("thesis", ("thesis", "--maps", ".", "--json"))


RENAMED = {"coupled_regulator": "linked_regulator"}
"""Names of shipped files now -> the names by which all versions find them."""


def before(name: str) -> str:
    """The name of a shipped file that older versions know too."""
    return RENAMED.get(name, name)


def run(folder: Path, package: Path, only: list[str]) -> int:
    """Run the cases that the folder lacks; print how long each took."""
    folder.mkdir(parents=True, exist_ok=True)
    environment = os.environ | {"PYTHONPATH": str(package.resolve()), "COLUMNS": "120"}
    failed = 0
    for case in cases():
        out = folder / f"{case.name}.json"
        if out.exists() or (only and not case.name.startswith(tuple(only))):
            continue
        begin = time.perf_counter()
        command = [sys.executable, "-m", "fieldmap", "--quiet", *case.words]
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
        spent = time.perf_counter() - begin
        print(f"{case.name}: exit code {done.returncode}, {spent:.0f} s", flush=True)
        if done.returncode == 2 or not done.stdout.strip():
            failed += 1
            print(done.stderr, flush=True)
            continue
        out.write_text(done.stdout, encoding="utf-8")
    return int(failed > 0)


@dataclass(frozen=True)
class Difference:
    """The largest difference of a file, relative to the largest value of its array, and where it is; count of arrays
    or numbers compared; what only one side has."""

    largest: float
    where: str
    count: int
    missing: tuple[str, ...] = ()


def compare(first: Path, second: Path, tolerance: float) -> int:
    """Compare two folders file by file."""
    worst = 0
    files = sorted({path.name for folder in (first, second) for path in folder.iterdir() if path.is_file()})
    for name in files:
        if not ((first / name).exists() and (second / name).exists()):
            print(f"{name:34s} only in {first if (first / name).exists() else second}")
            worst = 1
            continue
        found = compare_files(first / name, second / name)
        verdict = (
            "nothing to compare"
            if not found.count
            else "equal to the last bit"
            if found.largest == 0
            else f"{found.largest:.1e} at {found.where}"
        )
        bad = found.largest > tolerance or bool(found.missing)
        worst |= bad
        print(f"{name:34s} {found.count:7d} compared: {verdict}{'   <-- differs' if bad else ''}")
        for what in found.missing[:8]:
            print(f"{'':34s} only on one side: {what}")
    return worst


def compare_files(first: Path, second: Path) -> Difference:
    """Compare two files of the same name."""
    if first.suffix == ".h5":
        return _compare(_of_hdf5(first), _of_hdf5(second))
    if first.suffix == ".json":
        return _compare(_of_json(first), _of_json(second))
    if first.suffix == ".h":
        return Difference(0.0, "", 0)
    same = first.read_bytes() == second.read_bytes()
    return Difference(0.0 if same else math.inf, "bytes", 1)


def _compare(first: dict[str, np.ndarray], second: dict[str, np.ndarray]) -> Difference:
    largest, where = 0.0, ""
    for name in first.keys() & second.keys():
        a, b = first[name], second[name]
        if a.shape != b.shape:
            return Difference(math.inf, f"{name}: shapes {a.shape}, {b.shape}", len(first))
        with np.errstate(invalid="ignore"):
            away = np.where((a == b) | (np.isnan(a) & np.isnan(b)), 0.0, np.abs(a - b))
        scale = np.nanmax(np.abs(a), initial=0.0)
        relative = float(np.max(away, initial=0.0) / (scale or 1.0))
        if not relative <= largest:
            largest, where = relative, name
    return Difference(largest, where, len(first), tuple(sorted(first.keys() ^ second.keys())))


def _of_hdf5(path: Path) -> dict[str, np.ndarray]:
    found: dict[str, np.ndarray] = {}

    def visit(name: str, item: h5py.Group | h5py.Dataset) -> None:
        values = [(f"{name}@{key}", value) for key, value in item.attrs.items()]
        if isinstance(item, h5py.Dataset):
            values.append((name, item[()]))
        for key, value in values:
            array = np.asarray(value)
            if array.dtype.kind in "fiub" and not NOT_DATA.search(key):
                found[key] = array.astype(float)

    with h5py.File(path) as file:
        file.visititems(visit)
    return found


def _of_json(path: Path) -> dict[str, np.ndarray]:
    found: dict[str, np.ndarray] = {}

    def walk(name: str, value: object) -> None:
        if NOT_DATA.search(name):
            return
        if isinstance(value, dict):
            label = value.get("id")
            for key, inner in value.items():
                walk(f"{name}/{key}" if label is None else f"{name}/{label}/{key}", inner)
        elif isinstance(value, list):
            for number, inner in enumerate(value):
                walk(f"{name}/{number}", inner)
        elif isinstance(value, int | float):
            found[name] = np.array([value], dtype=float)

    walk("", json.loads(path.read_text(encoding="utf-8")))
    return found


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    runs = commands.add_parser("run")
    runs.add_argument("folder", type=Path)
    runs.add_argument("--package", type=Path, default=ROOT, help="a checkout; this one unless given")
    runs.add_argument("--only", nargs="+", default=[], metavar="CASE")
    compares = commands.add_parser("compare")
    compares.add_argument("first", type=Path)
    compares.add_argument("second", type=Path)
    compares.add_argument("--tolerance", type=float, default=1e-12)
    given = parser.parse_args()
    if given.command == "run":
        return run(given.folder, given.package, given.only)
    return compare(given.first, given.second, given.tolerance)


if __name__ == "__main__":
    sys.exit(main())
