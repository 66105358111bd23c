"""Plant errors in a copy of the package and see whether the tests catch them. `make mutants`.

    python scripts/mutants.py --planted                     # the errors of scripts/planted_errors.toml
    python scripts/mutants.py lookup levitation --count 25  # as many of Cosmic Ray's mutants of these packages
    python scripts/mutants.py --report                      # what is known so far

Each mutant changes one operator, number, comparison or condition of one line; which ones are tried is drawn by --seed,
the same ones each time, more of them with a larger --count. A mutant is caught if a test fails; the tests that name
what stands in its file run first. Results are kept in the folder of --keep, and what is known is not tried again.
Survivors are listed with their line: kill them with a test, or say in scripts/equivalent_mutants.toml why they change
nothing that could be seen. It takes from seconds to minutes for each mutant; nothing here runs in CI.
"""

import argparse
import json
import os
import random
import re
import shutil
import subprocess
import sys
import time
import tomllib
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

ROOT = Path(__file__).resolve().parents[1]
PLANTED = ROOT / "scripts" / "planted_errors.toml"
EQUIVALENT = ROOT / "scripts" / "equivalent_mutants.toml"
PACKAGES = ("control", "currents", "dynamics", "interpolants", "iron", "kernels", "levitation", "lookup", "sources",
            "thesis")  # fmt: skip
# What they replace is what a person gets wrong in a formula. Decorators, exceptions and names are left alone.
OPERATORS = ("ReplaceBinaryOperator", "ReplaceComparisonOperator", "ReplaceUnaryOperator", "NumberReplacer",
             "AddNot", "ReplaceTrueWithFalse", "ReplaceFalseWithTrue", "ReplaceAndWithOr", "ReplaceOrWithAnd",
             "ReplaceBreakWithContinue", "ZeroIterationForLoop")  # fmt: skip
# Of numbers that are not whole they end in an error at once, which any test that runs the line catches.
_NEEDS_BITS = re.compile("_(BitAnd|BitOr|BitXor|LShift|RShift|Invert|Mod|FloorDiv)(_|$)")
# Beyond it the tests hang, which is caught too.
SECONDS = 900.0


@dataclass(frozen=True)
class Trial:
    """One error: what it is, the line before and after, whether a test failed, and how long that took."""

    file: str
    what: str
    before: str
    after: str
    caught: bool
    seconds: float

    @property
    def key(self) -> str:
        """The same for the same error in the same line, wherever that stands."""
        return f"{self.file}: {self.before} -> {self.after}"


def main() -> int:
    """Exit code 1 where a planted error was not caught."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("packages", nargs="*", choices=[*PACKAGES, []], help="packages to change")
    parser.add_argument("--planted", action="store_true", help="the errors of scripts/planted_errors.toml")
    parser.add_argument("--count", type=int, default=20, help="mutants of each package")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--keep", type=Path, default=ROOT / "maps" / "out" / "mutants", help="folder of results"
    )
    parser.add_argument("--report", action="store_true", help="print what is known and try nothing")
    given = parser.parse_args()
    given.keep.mkdir(parents=True, exist_ok=True)
    console = Console()
    known = _read(given.keep)
    if not given.report:
        copy = _copied(given.keep / "copy")
        if given.planted:
            known |= _planted(copy, given.keep, console)
        for package in given.packages:
            known |= _sampled(package, given.count, given.seed, copy, given.keep, known, console)
        shutil.rmtree(copy)
    _print(list(known.values()), console)
    planted = [one for one in known.values() if one.what in {error["what"] for error in _list_of_planted()}]
    return int(given.planted and not all(one.caught for one in planted))


def _copied(folder: Path) -> Path:
    """A copy of the checkout that errors are planted in; compiled kernels travel with it."""
    if folder.exists():
        shutil.rmtree(folder)
    for name in ("fieldmap", "tests", "geometry", "maps", "scripts", "docs"):
        # Results and their folder lie in maps/out.
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
                (error["what"], error["before"], error["after"]),
            )  # fmt: skip
            found[trial.key] = trial
            _write(keep, trial)
    return found


def _sampled(
    package: str, count: int, seed: int, copy: Path, keep: Path, known: dict[str, Trial], console: Console
) -> dict[str, Trial]:
    """`count` mutants of a package: the first of a list in random order."""
    mutants = _mutants(package)
    random.Random(seed).shuffle(mutants)
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
            if trial.key in known:
                found[trial.key] = known[trial.key]
                continue
            trial = _tried(copy, file, mutated, _tests_of(path, package), (operator, before, after))
            found[trial.key] = trial
            _write(keep, trial)
    return found


def _mutants(package: str) -> list[tuple[Path, str, int, int]]:
    """File, operator, which place in the file, and line, of all mutants of a package."""
    import cosmic_ray.plugins
    from cosmic_ray.ast import ast_nodes, get_ast

    names = [
        n
        for n in cosmic_ray.plugins.operator_names()
        if n.split("/")[1].startswith(OPERATORS) and not _NEEDS_BITS.search(n)
    ]
    folder = ROOT / "fieldmap" / package
    found = []
    for path in sorted(folder.rglob("*.py")) if folder.is_dir() else [folder.with_suffix(".py")]:
        tree = get_ast(path.read_text(encoding="utf-8"))
        for name in names:
            operator = cosmic_ray.plugins.get_operator(name)()
            places = (place for node in ast_nodes(tree) for place in operator.mutation_positions(node))
            found += [(path, name, k, start[0]) for k, (start, _) in enumerate(places)]
    return found


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


def _tests_of(path: Path, package: str) -> list[str]:
    """Test files that name the module or what it defines, the most telling first; then the package's folder."""
    defined = set(re.findall(r"^(?:def|class) ([A-Za-z]\w+)", path.read_text(encoding="utf-8"), re.MULTILINE))
    module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
    scores = []
    for test in (ROOT / "tests").rglob("test_*.py"):
        text = test.read_text(encoding="utf-8")
        score = sum(bool(re.search(rf"\b{name}\b", text)) for name in defined) + 3 * (module in text)
        if score:
            scores.append((-score, test.relative_to(ROOT).as_posix()))
    files = [name for _, name in sorted(scores)]
    near = [name for name in files[6:] if name.startswith(f"tests/{package}/")]
    folder = [f"tests/{package}"] if (ROOT / "tests" / package).is_dir() else []
    # What a module does for its neighbours is tested through them.
    return [*files[:6], *near][:12] or folder


def _tried(copy: Path, file: str, text: str, tests: list[str], told: tuple[str, str, str]) -> Trial:
    """Plant an error, run the tests until one fails, and take it out again."""
    path = copy / file
    original = path.read_text(encoding="utf-8")
    begin = time.monotonic()
    # Kernels that were compiled with the mended file, or with another error, are not taken for this one's.
    compiled = [*(copy / "fieldmap").rglob("*.nb?")] if file.startswith("fieldmap/kernels") else []
    for one in compiled:
        one.unlink(missing_ok=True)
    try:
        path.write_text(text, encoding="utf-8")
        caught = _fails(copy, tests)
    finally:
        path.write_text(original, encoding="utf-8")
        if compiled:
            for one in (copy / "fieldmap").rglob("*.nb?"):
                one.unlink(missing_ok=True)
    return Trial(file, *told, caught, round(time.monotonic() - begin, 1))


def _fails(copy: Path, tests: list[str]) -> bool:
    if not tests:
        return False
    environment = os.environ | {"PYTHONPATH": str(copy), "PYTHONSAFEPATH": "1"}
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *tests]
    try:
        done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, timeout=SECONDS)
    except subprocess.TimeoutExpired:
        return True
    if done.returncode in (0, 1, 2):
        return done.returncode != 0
    raise SystemExit(done.stdout.decode()[-2000:] + done.stderr.decode()[-2000:])


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
    return {f"{one['file']}: {one['before']} -> {one['after']}": one["why"] for one in entries}


def _print(trials: list[Trial], console: Console) -> None:
    """How many were caught in each package, and every survivor that nobody has explained."""
    explained, planted = _explained(), {error["what"] for error in _list_of_planted()}
    table = Table("package", "mutants", "caught", "explained", "share (%)", "seconds each")
    groups: dict[str, list[Trial]] = {}
    for one in trials:
        name = "planted" if one.what in planted else one.file.split("/")[1].removesuffix(".py")
        groups.setdefault(name, []).append(one)
    for name, ones in sorted(groups.items()):
        caught = sum(one.caught for one in ones)
        named = sum(not one.caught and one.key in explained for one in ones)
        seconds = sum(one.seconds for one in ones) / len(ones)
        share = 100.0 * (caught + named) / len(ones)
        table.add_row(name, str(len(ones)), str(caught), str(named), f"{share:.0f}", f"{seconds:.0f}")
    console.print(table)
    for one in sorted(trials, key=lambda trial: trial.file):
        if not one.caught and one.key not in explained:
            console.print(f"not caught: {one.file}\n  - {one.before}\n  + {one.after}", markup=False)


if __name__ == "__main__":
    sys.exit(main())
