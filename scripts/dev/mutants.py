"""Plant errors in a copy of the package and see whether the tests catch them. `make mutants`.

    python scripts/dev/mutants.py --planted                     # the errors of scripts/dev/planted_errors.toml
    python scripts/dev/mutants.py lookup levitation --count 25  # 25 of Cosmic Ray's mutants of each package
    python scripts/dev/mutants.py lookup --count 25 --again     # again the mutants that no test caught
    python scripts/dev/mutants.py --report                      # results so far

Each mutant changes one operator, number, comparison or condition of one line. --seed draws the mutants; a larger
--count adds mutants to the same ones. A mutant is caught if one of the tests that run its line (tests_of_lines.py)
fails; the quickest tests run first, for at most a minute of processor time. A mutant that only another test would catch
counts as not caught, so the true share is at least the printed one. Results are kept in the folder of --keep, and known
mutants are not tried again. Survivors are listed with their line: kill them with a test, or state in
scripts/dev/equivalent_mutants.toml why they change nothing observable. The first run runs all tests once with coverage
(half an hour of one processor; --tests names fewer); then each mutant takes from seconds to two minutes. CI does not
run this.
"""

import argparse
import hashlib
import json
import math
import os
import re
import shutil
import subprocess
import sys
import time
import tomllib
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress
from rich.table import Table
from tests_of_lines import TestsOfLines, environment_of

ROOT = Path(__file__).resolve().parents[2]
PLANTED = ROOT / "scripts" / "dev" / "planted_errors.toml"
EQUIVALENT = ROOT / "scripts" / "dev" / "equivalent_mutants.toml"
PACKAGES = ("control", "currents", "device", "dynamics", "interop", "interpolants", "io", "iron", "kernels",
            "levitation", "lookup", "maps", "plot", "sources", "store", "studies", "thesis")  # fmt: skip
# Operators that imitate human mistakes in formulas. Decorators, exceptions and names are not changed.
OPERATORS = ("ReplaceBinaryOperator", "ReplaceComparisonOperator", "ReplaceUnaryOperator", "NumberReplacer",
             "AddNot", "ReplaceTrueWithFalse", "ReplaceFalseWithTrue", "ReplaceAndWithOr", "ReplaceOrWithAnd",
             "ReplaceBreakWithContinue", "ZeroIterationForLoop")  # fmt: skip
# Operators for integers raise an error on other numbers, so any test that runs the line would catch them.
_NEEDS_BITS = re.compile("_(BitAnd|BitOr|BitXor|LShift|RShift|Invert|Mod|FloorDiv)(_|$)")
# `zip(..., strict=True)` detects programming errors, which no input can cause.
NEVER_SEEN = ("strict=",)
# `is` instead of `==` changes nothing for small integers, words and choices, and raises an error for arrays.
_SAME_OBJECT = re.compile("_Eq_Is$|_NotEq_IsNot$")
# Meshes are cached by the mesher's inputs (fieldmap.iron.mesh.mesher). An error in the mesher itself must not find a
# mesh that was cached without it.
MESHER = ("fieldmap/iron/mesh/mesher.py", "fieldmap/iron/topology.py")


@dataclass(frozen=True)
class Trial:
    """One error: its kind, the line before and after, whether a test failed, seconds taken, and the test that failed;
    "" if none failed or none runs the line."""

    file: str
    what: str
    before: str
    after: str
    caught: bool
    seconds: float
    by: str = ""

    @property
    def key(self) -> str:
        """Identifies the error by the text of its line, independent of the line number."""
        return f"{self.file}: {self.before} -> {self.after}"


def main() -> int:
    """Exit code: 1 if a planted error was not caught."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("packages", nargs="*", choices=[*PACKAGES, []], help="packages to change")
    parser.add_argument(
        "--planted", action="store_true", help="the errors of scripts/dev/planted_errors.toml"
    )
    parser.add_argument("--count", type=int, default=20, help="mutants of each package")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--keep", type=Path, default=ROOT / "maps" / "out" / "mutants", help="folder of results"
    )
    parser.add_argument("--tests", nargs="+", default=["tests"], help="files and folders of tests that count")
    parser.add_argument("--again", action="store_true", help="try those again that no test caught")
    parser.add_argument("--report", action="store_true", help="print what is known and try nothing")
    given = parser.parse_args()
    given.keep.mkdir(parents=True, exist_ok=True)
    console = Console()
    known = _read(given.keep)
    shown = known if given.report else {}
    if not given.report:
        copy = _copied(given.keep / "copy")
        if given.planted:
            shown |= _planted(copy, given.keep, console)
        if given.packages:
            environment = environment_of(copy) | {"FIELDMAP_MESHES": str((given.keep / "meshes").resolve())}
            tests = TestsOfLines(copy, (given.keep / "covering").resolve(), given.tests, environment)
        for package in given.packages:
            again = {key for key, one in known.items() if given.again and not one.caught}
            left = {key: one for key, one in known.items() if key not in again}
            shown |= _sampled(package, given.count, given.seed, copy, given.keep, left, tests, console)
        shutil.rmtree(copy)
    _print(list(shown.values()), console)
    planted = [one for one in shown.values() if one.what in {error["what"] for error in _list_of_planted()}]
    return int(not all(one.caught for one in planted))


def _copied(folder: Path) -> Path:
    """Copy the checkout, with its compiled kernels, to plant errors in."""
    if folder.exists():
        shutil.rmtree(folder)
    for name in ("fieldmap", "tests", "geometry", "maps", "scripts", "docs"):
        # maps/out holds results, among them this copy.
        shutil.copytree(
            ROOT / name, folder / name, ignore=shutil.ignore_patterns("out") if name == "maps" else None
        )
    for path in ROOT.iterdir():
        if path.is_file():
            shutil.copy2(path, folder / path.name)
    return folder


def _list_of_planted() -> list[dict[str, str]]:
    return list(tomllib.loads(PLANTED.read_text(encoding="utf-8"))["error"])


def _planted(copy: Path, keep: Path, console: Console) -> dict[str, Trial]:
    found = {}
    with Progress(console=console) as progress:
        for error in progress.track(_list_of_planted(), description="planted errors"):
            path = copy / error["file"]
            text = path.read_text(encoding="utf-8")
            if text.count(error["before"]) != 1:
                raise SystemExit(f"{error['file']}: {error['before']!r} must stand there once")
            trial = _tried(
                copy, error["file"], text.replace(error["before"], error["after"]), error["tests"].split(),
                _limit(200.0), (error["what"], error["before"], error["after"]),
            )  # fmt: skip
            found[trial.key] = trial
            _write(keep, trial)
    return found


def _sampled(
    package: str,
    count: int,
    seed: int,
    copy: Path,
    keep: Path,
    known: dict[str, Trial],
    tests: TestsOfLines,
    console: Console,
) -> dict[str, Trial]:
    """`count` mutants of a package: the first of a list in random order."""
    mutants = _mutants(package, seed)
    explained = _explained()
    # The unchanged package must pass the tests in this order, too; this is checked once.
    checked = any(key.startswith(f"fieldmap/{package}") for key in known)
    found = {}
    with Progress(console=console) as progress:
        for path, operator, occurrence, line in progress.track(mutants[:count], description=package):
            file = path.relative_to(ROOT).as_posix()
            original = path.read_text(encoding="utf-8")
            mutated = _mutated(original, operator, occurrence)
            if mutated is None:
                continue
            before, after = _change(original, mutated, line)
            trial = Trial(file, operator, before, after, False, 0.0)
            if trial.key in known or trial.key in explained:
                found[trial.key] = known.get(trial.key, trial)
                continue
            names = tests.of(file, line, package)
            limit = _limit(sum(tests.seconds[name] for name in names))
            if not checked and (failed := _failed(copy, file, names, limit)):
                raise SystemExit(f"without any error: {failed}")
            checked = True
            trial = _tried(copy, file, mutated, names, limit, (operator, before, after))
            found[trial.key] = trial
            _write(keep, trial)
    return found


def _mutants(package: str, seed: int) -> list[tuple[Path, str, int, int]]:
    """File, operator, number of the occurrence in the file, and line, of all mutants of a package. The random order
    depends on the text of each line only, so changes of other lines do not alter it."""
    import cosmic_ray.plugins
    from cosmic_ray.ast import ast_nodes, get_ast

    names = [
        n
        for n in cosmic_ray.plugins.operator_names()
        if n.split("/")[1].startswith(OPERATORS) and not _NEEDS_BITS.search(n) and not _SAME_OBJECT.search(n)
    ]
    folder = ROOT / "fieldmap" / package
    found = []

    def drawn(path: Path, text: str, *place: object) -> str:
        return hashlib.sha256(repr((seed, path.name, text.strip(), *place)).encode()).hexdigest()

    for path in sorted(folder.rglob("*.py")) if folder.is_dir() else [folder.with_suffix(".py")]:
        text = path.read_text(encoding="utf-8")
        tree, lines, here = get_ast(text), text.splitlines(), Counter[Any]()
        for name in names:
            operator = cosmic_ray.plugins.get_operator(name)()
            places = (place for node in ast_nodes(tree) for place in operator.mutation_positions(node))
            for k, (start, _) in enumerate(places):
                line = lines[start[0] - 1]
                if line[: start[1]].endswith(NEVER_SEEN):
                    continue
                place = name, start[1] - len(line) + len(line.lstrip())
                here[place, start[0]] += 1
                # The two changes of a number are drawn independently.
                others = (here[place, start[0]],) if here[place, start[0]] > 1 else ()
                found.append((drawn(path, line, *place, *others), path, name, k, start[0]))
    return [mutant for _, *mutant in sorted(found)]


def _mutated(text: str, operator: str, occurrence: int) -> str | None:
    import cosmic_ray.plugins
    from cosmic_ray.mutating import mutate_code

    return mutate_code(text, cosmic_ray.plugins.get_operator(operator)(), occurrence)


def _change(original: str, mutated: str, line: int) -> tuple[str, str]:
    """The line that differs, before and after."""
    for a, b in zip(original.splitlines(), mutated.splitlines(), strict=False):
        if a != b:
            return a.strip(), b.strip()
    return original.splitlines()[line - 1].strip(), "(gone)"


def _limit(seconds: float) -> float:
    """Wall time, s, beyond which tests count as hanging, and the error as caught. seconds: their usual time."""
    return 60.0 + 3.0 * seconds


def _tried(
    copy: Path, file: str, text: str, tests: list[str], limit: float, told: tuple[str, str, str]
) -> Trial:
    """Plant an error, run the tests until one fails, and take it out again."""
    path = copy / file
    original, times = path.read_text(encoding="utf-8"), path.stat()
    begin = time.monotonic()
    # A cached kernel contains the functions that it calls, and is reused as long as its own file is unchanged. So an
    # error in a kernel removes all cached kernels during the trial. Other files are not compiled.
    aside = copy.parent / "compiled"
    compiled = [*(copy / "fieldmap").rglob("*.nb?")] if file.startswith("fieldmap/kernels") else []
    for one in compiled:
        (aside / one.relative_to(copy)).parent.mkdir(parents=True, exist_ok=True)
        shutil.move(one, aside / one.relative_to(copy))
    in_c = file.endswith((".h", ".c"))
    try:
        path.write_text(text, encoding="utf-8")
        if in_c:
            _compile_core(copy)
        failed = _failed(copy, file, tests, limit)
    finally:
        path.write_text(original, encoding="utf-8")
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
        if in_c:
            _compile_core(copy)
        if compiled:
            for one in (copy / "fieldmap").rglob("*.nb?"):
                one.unlink(missing_ok=True)
            for one in compiled:
                shutil.move(aside / one.relative_to(copy), one)
    return Trial(file, *told, bool(failed), round(time.monotonic() - begin, 1), failed)


def _compile_core(copy: Path) -> None:
    environment = {"CC": "cc", **os.environ}
    command = [sys.executable, str(copy / "fieldmap" / "core" / "compile.py")]
    subprocess.run(command, env=environment, check=True, capture_output=True)


def _failed(copy: Path, file: str, tests: list[str], limit: float) -> str:
    """Name of the first of these tests that fails; "" if none fails or there are none."""
    if not tests:
        return ""
    environment = environment_of(copy)
    environment.pop("FIELDMAP_MESHES", None)
    if file not in MESHER:
        environment["FIELDMAP_MESHES"] = str(copy.parent.resolve() / "meshes")
    names = copy.parent / "tests.txt"
    names.write_text("".join(f"{name}\n" for name in tests), encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", f"@{names.resolve()}"]
    try:
        done = subprocess.run(
            command, cwd=copy, env=environment, capture_output=True, timeout=limit, text=True
        )
    except subprocess.TimeoutExpired:
        return "(no end)"
    if done.returncode == 0:
        return ""
    # If a module of tests cannot be imported, pytest also reports its tests as missing.
    if told := re.search(r"^(?:FAILED|ERROR) (tests/.*?)(?: - |$)", done.stdout, re.MULTILINE):
        return told[1]
    functions = ["-m", "not slow", *dict.fromkeys(name.split("[")[0] for name in tests if "::" in name)]
    if done.returncode == 4 and "ERROR: not found" in done.stderr and functions != tests:
        # The error changed the parameters of a test, so all its present parameters are run.
        return _failed(copy, file, functions, limit)
    if done.returncode in (4, 5) and "ImportError while loading conftest" not in done.stderr:
        raise SystemExit(done.stdout[-2000:] + done.stderr[-2000:])
    return f"(exit code {done.returncode})"


def _read(keep: Path) -> dict[str, Trial]:
    file = keep / "trials.jsonl"
    lines = file.read_text(encoding="utf-8").splitlines() if file.is_file() else []
    return {trial.key: trial for trial in (Trial(**json.loads(line)) for line in lines)}


def _write(keep: Path, trial: Trial) -> None:
    with (keep / "trials.jsonl").open("a", encoding="utf-8") as file:
        file.write(json.dumps(asdict(trial)) + "\n")


def _explained() -> dict[str, str]:
    if not EQUIVALENT.is_file():
        return {}
    entries = tomllib.loads(EQUIVALENT.read_text(encoding="utf-8")).get("mutant", [])
    return {
        f"{one['file']}: {one['before']} -> {after}": one["why"] for one in entries for after in one["after"]
    }


def _print(trials: list[Trial], console: Console) -> None:
    """Print the numbers of caught mutants in each package and in all, and every unexplained survivor. Mutants of lines
    that no longer exist do not count."""
    texts = {
        one.file: (ROOT / one.file).read_text(encoding="utf-8")
        for one in trials
        if (ROOT / one.file).is_file()
    }
    trials = [one for one in trials if one.before in texts.get(one.file, "")]
    explained, planted = _explained(), {error["what"] for error in _list_of_planted()}
    table = Table(
        "package", "mutants", "caught", "explained", "share (%)", "95 % interval (%)", "seconds each"
    )
    groups: dict[str, list[Trial]] = {}
    for one in trials:
        name = "planted" if one.what in planted else one.file.split("/")[1].removesuffix(".py")
        groups.setdefault(name, []).append(one)
    drawn = [one for one in trials if one.what not in planted]
    rows = [*sorted(groups.items()), *([("all but planted", drawn)] if drawn else [])]
    for name, ones in rows:
        caught = sum(one.caught for one in ones)
        named = sum(not one.caught and one.key in explained for one in ones)
        seconds = sum(one.seconds for one in ones) / len(ones)
        share = 100.0 * (caught + named) / len(ones)
        low, high = (100.0 * side for side in _interval(caught + named, len(ones)))
        counts = (str(len(ones)), str(caught), str(named))
        table.add_row(name, *counts, f"{share:.0f}", f"{low:.0f} to {high:.0f}", f"{seconds:.0f}")
    console.print(table)
    for one in sorted(trials, key=lambda trial: trial.file):
        if not one.caught and one.key not in explained:
            console.print(f"not caught: {one.file}\n  - {one.before}\n  + {one.after}", markup=False)


def _interval(k: int, n: int, z: float = 1.96) -> tuple[float, float]:
    """Wilson interval of a share estimated as k of n."""
    middle = (k + z * z / 2.0) / (n + z * z)
    half = z * math.sqrt(k * (n - k) / n + z * z / 4.0) / (n + z * z)
    return middle - half, middle + half


if __name__ == "__main__":
    sys.exit(main())
