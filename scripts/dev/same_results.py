"""Compare the results of two versions of the package: run all shipped cases with each, and compare all numbers.

    python scripts/dev/same_results.py run BEFORE --package ../before     # a checkout of the older commit
    python scripts/dev/same_results.py run AFTER
    python scripts/dev/same_results.py compare BEFORE AFTER

`run` uses the command line only: maps, rows of the thesis, scenarios, solutions, exports. If the core of a checkout is
not compiled, `run` compiles it by its own fieldmap/core/compile.py (with CC, or ziglang). Existing results in the
folder are skipped, so a stopped run can be continued. `--only` takes names of cases or their beginnings (`map`,
`simulate`, `thesis`, ...); `--quick` runs the quick and linear maps, small solutions and one scenario: some minutes.
Scenarios of saturating iron use a table of currents in all versions, because the defaults of the versions differ.

`compare` prints one line for each file: equal to the last bit, or the largest difference and its place. The exit code
is 1 if a file is missing or a difference exceeds its tolerance:

- maps, lookups, solutions and exports: 1e-12 of the largest value of the same array;
- runs of scenarios: 1e-9 of the largest value (for velocities at least of 1 m/s or 1 rad/s), row by row until a first
  output is at a limit of its controller. Two kinds of runs may exceed this later, and a line says from when on and by
  how much: runs that touch a wall, because they do not record when; and runs with a converter on the outputs. As long
  as both versions take the same steps of the converter, the loop does not reduce a difference, and an unstable body
  amplifies it; later a step of the converter bounds it. Such runs must agree for 0.3 s, and runs with a converter
  within 1e-3 to the end. The end of a run and the walls that it touched must be the same;
- equilibria, linearisations and rows of the thesis: 1e-9 m for a position of an equilibrium, otherwise 1e-9 of the
  largest value.

`--tolerance` sets one value for all. Times, dates, versions and other texts are not compared, nor are numbers that
consist of rounding errors: residuals, and deviations from known values.

The last bits of compiled code depend on the compiler, and with numba also on which kernels were compiled together or
read from the cache. For a comparison to the last bit compile both versions with the same compiler, and run the same
cases in the same order.
"""

import argparse
import json
import math
import os
import re
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

ROOT = Path(__file__).parents[2]
MAPS = ("quick", "linear", "workspace", "division", "saturating")
NOT_DATA = re.compile(
    r"second|date|version|fingerprint|time_s|elapsed|minutes|hash|sha256|author|software|seal|memory"
    r"|timing|processor|clock|path|machine$|bytes|(^|/)about$|size|residual$|deviation$",
    re.IGNORECASE,
)
"""Names of attributes, data sets and keys that differ from run to run: costs, dates and paths."""

EXACT, OF_RUNS = 1e-12, 1e-9
LOOSER = {"simulate": OF_RUNS, "equilibrium": 1e-9, "linearise": 1e-9, "thesis": 1e-9}
"""Tolerances of files by the beginning of their names; EXACT for other files."""
METRES = re.compile(r"(^|/)position$")
"""Names of numbers in files of equilibria that are compared in m, not relative to the largest value."""
LEAST_SCALE = {"velocity": 1.0, "spin": 1.0}
"""Least scale of arrays of a run. The values of a body that hardly moves are rounding errors."""
AGREE_S, WITH_CONVERTER = 0.3, 1e-3
"""Time, s, for which runs must agree that may differ later; and largest later difference of runs with a converter."""


@dataclass(frozen=True)
class Case:
    """One command: its words after `fieldmap`. It runs in the folder of results; its output is kept as NAME.json."""

    name: str
    words: tuple[str, ...]


def cases() -> Iterator[Case]:
    """All commands, in an order in which each finds its input files."""
    for recipe in MAPS:
        # The recipe of this checkout; the other version may lack it or have another map under this name.
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
    for path in sorted((ROOT / "maps/scenarios").glob("*.toml")):
        name, recipe = path.stem, tomllib.loads(path.read_text(encoding="utf-8"))["map"]
        # `bead` is of another machine and needs a map of its own.
        if recipe not in MAPS:
            continue
        words = ("simulate", name, "--map", f"{recipe}.h5", "-o", f"{name}.h5", "--json")
        # By default versions use a table of currents or the iron's model, which differ by more than rounding.
        table = () if recipe == "linear" else ("--set", "field.iron=table")
        yield Case(f"simulate_{name}", (*words, *table))
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


QUICK = re.compile(
    r"(map|info|probe|equilibrium)_(quick|linear)$|solve_(loop|single)|simulate_hold$|linearise_hold$|export"
)


def compile_core(package: Path) -> None:
    """Compile the core of a checkout that has one, if it is not compiled."""
    script = package.resolve() / "fieldmap" / "core" / "compile.py"
    if script.exists() and not [*script.parent.glob("library.*.so"), *script.parent.glob("library.*.pyd")]:
        subprocess.run([sys.executable, str(script)], cwd=package, check=True)


def run(folder: Path, package: Path, chosen: Iterator[Case]) -> int:
    """Run the cases that are not in the folder; print the time of each."""
    compile_core(package)
    folder.mkdir(parents=True, exist_ok=True)
    environment = os.environ | {"PYTHONPATH": str(package.resolve()), "COLUMNS": "120"}
    failed = 0
    for case in chosen:
        out = folder / f"{case.name}.json"
        if out.exists():
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
    """The largest difference of a file, relative to the largest value of its array, and its place; count of compared
    arrays; missing: names that only one side has or that differ; notes: until when runs were compared."""

    largest: float = 0.0
    where: str = ""
    count: int = 0
    missing: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def compare(first: Path, second: Path, tolerance: float | None) -> int:
    """Compare two folders file by file."""
    worst = 0
    files = sorted({path.name for folder in (first, second) for path in folder.iterdir() if path.is_file()})
    for name in files:
        if not ((first / name).exists() and (second / name).exists()):
            print(f"{name:34s} only in {first if (first / name).exists() else second}")
            worst = 1
            continue
        bound = tolerance_of(first / name) if tolerance is None else tolerance
        found = compare_files(first / name, second / name, bound)
        verdict = (
            "nothing to compare"
            if not found.count
            else "equal to the last bit"
            if found.largest == 0
            else f"{found.largest:.1e} at {found.where}, {bound:.0e} allowed"
        )
        bad = not found.largest <= bound or bool(found.missing)
        worst |= bad
        print(f"{name:34s} {found.count:7d} compared: {verdict}{'   <-- differs' if bad else ''}")
        for what in found.missing[:8]:
            print(f"{'':34s} not the same on both sides: {what}")
        for what in found.notes:
            print(f"{'':34s} {what}")
    return worst


def tolerance_of(path: Path) -> float:
    """Largest allowed difference of a file."""
    if is_run(path):
        return OF_RUNS
    return next((bound for begin, bound in LOOSER.items() if path.name.startswith(begin)), EXACT)


def is_run(path: Path) -> bool:
    """Whether a file holds runs of a scenario."""
    if path.suffix != ".h5":
        return False
    with h5py.File(path) as file:
        return str(file.attrs.get("format", "")).startswith("fieldmap run")


def compare_files(first: Path, second: Path, tolerance: float = EXACT) -> Difference:
    """Compare two files of the same name. tolerance: runs that may differ later are compared until they exceed it."""
    if is_run(first):
        return _compare_runs(first, second, tolerance)
    if first.suffix == ".h5":
        return _compare(_of_hdf5(first), _of_hdf5(second))
    if first.suffix == ".json":
        metres = METRES if first.name.startswith("equilibrium") else None
        return _compare(_of_json(first), _of_json(second), metres)
    if first.suffix == ".h":
        return Difference()
    same = first.read_bytes() == second.read_bytes()
    return Difference(0.0 if same else math.inf, "bytes", 1)


def _compare(
    first: dict[str, np.ndarray], second: dict[str, np.ndarray], metres: re.Pattern[str] | None = None
) -> Difference:
    largest, where = 0.0, ""
    for name in first.keys() & second.keys():
        a, b = first[name], second[name]
        if a.shape != b.shape:
            return Difference(math.inf, f"{name}: shapes {a.shape}, {b.shape}", len(first))
        away = _away(a, b, 1.0 if metres and metres.search(name) else None)
        if not np.max(away, initial=0.0) <= largest:
            largest, where = float(np.max(away)), name
    return Difference(largest, where, len(first), tuple(sorted(first.keys() ^ second.keys())))


def _away(a: np.ndarray, b: np.ndarray, scale: float | None = None) -> np.ndarray:
    """Differences, relative to the largest value of a unless a scale is given; 0 for two NaN."""
    with np.errstate(invalid="ignore"):
        away = np.where((a == b) | (np.isnan(a) & np.isnan(b)), 0.0, np.abs(a - b))
    return away / (scale or np.nanmax(np.abs(a), initial=0.0) or 1.0)


def _compare_runs(first: Path, second: Path, tolerance: float) -> Difference:
    """Compare the runs of two files, row by row."""
    total = Difference()
    with h5py.File(first) as one, h5py.File(second) as two:
        for name in sorted(one.keys() | two.keys()):
            if name not in one or name not in two:
                total = replace(total, missing=(*total.missing, name))
                continue
            found = _compare_run(one[name], two[name], tomllib.loads(one.attrs["scenario"]), tolerance)
            larger = found if not found.largest <= total.largest else total
            total = replace(
                larger,
                where=larger.where if larger is total else f"{name}/{larger.where}",
                count=total.count + found.count,
                missing=total.missing + tuple(f"{name}: {what}" for what in found.missing),
                notes=total.notes + tuple(f"{name}: {what}" for what in found.notes),
            )
    return total


def _compare_run(one: h5py.Group, two: h5py.Group, keys: dict[str, Any], tolerance: float) -> Difference:
    """Compare two runs. keys: of the scenario."""
    about, other = (json.loads(side.attrs["about"]) for side in (one, two))
    time, rows = np.asarray(one["time"]), min(len(one["time"]), len(two["time"]))
    free = min(rows, *(_first_at_limit(side["outputs"], keys["control"]) for side in (one, two)))
    away, worst, where = np.zeros(free), 0.0, ""
    for name in sorted(one.keys() & two.keys()):
        a, b = np.asarray(one[name])[:free], np.asarray(two[name])[:free]
        scale = max(np.abs(a).max(initial=0.0), LEAST_SCALE.get(name, 0.0))
        here = _away(a, b, scale).reshape(free, -1).max(axis=1, initial=0.0)
        away = np.maximum(away, here)
        if here.max(initial=0.0) > worst:
            worst, where = float(here.max()), f"{name}, row {int(here.argmax())}"
    notes = (
        [f"at a limit of its controller from {time[free]:.4g} s of {time[-1]:.4g} s on"]
        if free < rows
        else []
    )
    converter = "output_bits" in keys.get("coils", {})
    if worst > tolerance:
        until = int(np.argmax(away > tolerance))
        notes.append(
            f"above {tolerance:.0e} from {time[until]:.4g} s of {time[-1]:.4g} s on: {worst:.1e} at {where}"
        )
        notes += [f"it touches {what}" for what in about["touched"]]
        near = worst < WITH_CONVERTER or bool(about["touched"])
        if (converter or about["touched"]) and near and time[until] >= AGREE_S:
            worst, where = float(away[:until].max()), "rows before that"
    different = [key for key in ("event", "touched") if about[key] != other[key]]
    if len(one["time"]) != len(two["time"]) and free == rows:
        different.append("rows")
    different += sorted(one.keys() ^ two.keys())
    return Difference(worst, where, len(one.keys() & two.keys()), tuple(different), tuple(notes))


def _first_at_limit(outputs: h5py.Dataset, control: dict[str, Any]) -> int:
    """The first row with an output at a limit, within a thousandth of its range for converters; or all rows."""
    values = np.asarray(outputs)
    axes = [control.get(axis, {}) for axis in "zxy"]
    if values.shape[1] != len(axes):
        return len(values)
    low, high = (
        np.array([axis.get(name, end) for axis in axes])
        for name, end in (("lower", -np.inf), ("upper", np.inf))
    )
    near = np.where(np.isfinite(high - low), 1e-3 * (high - low), 0.0)
    at = ((values <= low + near) | (values >= high - near)).any(axis=1)
    return int(np.argmax(at)) if at.any() else len(values)


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
    """Numbers by the path of keys; all numbers of a list, or of the tables of a list, form one array."""
    found: dict[str, list[float]] = {}

    def walk(name: str, value: object) -> None:
        # Metrics of runs follow from their rows, which are compared in another file.
        if NOT_DATA.search(name) or name == "/batches/runs":
            return
        if isinstance(value, dict):
            label = value.get("id")
            for key, inner in value.items():
                walk(f"{name}/{key}" if label is None else f"{name}/{label}/{key}", inner)
        elif isinstance(value, list):
            for inner in value:
                walk(name, inner)
        elif isinstance(value, int | float):
            found.setdefault(name, []).append(float(value))

    walk("", json.loads(path.read_text(encoding="utf-8")))
    return {name: np.array(values) for name, values in found.items()}


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
    runs.add_argument("--quick", action="store_true", help="some minutes instead of an hour")
    compares = commands.add_parser("compare")
    compares.add_argument("first", type=Path)
    compares.add_argument("second", type=Path)
    compares.add_argument("--tolerance", type=float, help="one for all files, instead of those stated above")
    given = parser.parse_args()
    if given.command == "run":
        chosen = (
            case
            for case in cases()
            if (not given.only or case.name.startswith(tuple(given.only)))
            and (not given.quick or QUICK.match(case.name))
        )
        return run(given.folder, given.package, chosen)
    return compare(given.first, given.second, given.tolerance)


if __name__ == "__main__":
    sys.exit(main())
