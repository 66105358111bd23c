"""Find slow tests of which other tests run every line too, and write tests/slow_covered.txt.

    python scripts/dev/slow_tests.py                    # runs the tests with coverage: ten minutes, kernels compiled
    python scripts/dev/slow_tests.py --measured FOLDER  # chooses again from what a run left there

`make test` leaves the tests of that file out, `make slow` runs them. A test is on the list if it takes more than
--seconds of processor time and each line that it runs is run by a test that stays, or by --tests of them if so many
did. The longest are looked at first. What the lines do not tell is left alone: tests that start other processes, those
that run no line of the package, and those that hold definitions, such as signatures and the keys of files. Of a
function whose quickest case takes less than --case, that one stays; of those in tests/physics, which compare with
closed forms, always.

A line that a test runs may be wrong without its notice: `make mutants` counts how many errors the tests that stay see.
Of lines of compiled kernels only the calls are seen here. The extra `mutants` has what it takes.
"""

import argparse
import json
import os
import subprocess
from collections import Counter, defaultdict
from collections.abc import Generator, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
COVERED = ROOT / "tests" / "slow_covered.txt"
# Processor time of child processes from which on lines say too little about a test, s.
CHILD = 0.1
HEADER = """\
# Slow tests of which other tests run every line too: `make slow`, a part of `make validate`, runs them, `make test`
# leaves them out. Written by scripts/dev/slow_tests.py, which says how it chooses; tests/slow.txt is the list by hand.
"""


@dataclass
class Measured:
    """Processor time of a test's call and of the processes that it started, s."""

    seconds: float
    child_seconds: float


def main() -> None:
    """Write the list."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=0.1, help="of a test that may be left out")
    parser.add_argument("--case", type=float, default=0.2, help="of a case that stays for its function, s")
    parser.add_argument("--tests", type=int, default=1, help="that still run each line, if so many did")
    parser.add_argument("--measured", type=Path, help="folder of a run; without it the tests are run")
    given = parser.parse_args()
    folder = given.measured or ROOT / "maps" / "out" / "slow_tests"
    if given.measured is None:
        measure(folder)
    tests = {
        name: Measured(**one)
        for path in sorted(folder.glob("*.json"))
        for name, one in json.loads(path.read_text(encoding="utf-8")).items()
    }
    from tests_of_lines import reads_definitions

    held = {file for file in {name.split("::")[0] for name in tests} if reads_definitions(ROOT / file)}
    lines = lines_of(folder / "lines.coverage", {name for name in tests if name.split("::")[0] not in held})
    left_out = chosen(tests, lines, given.seconds, given.case, given.tests)
    COVERED.write_text(HEADER + "\n".join(shortened(left_out, tests)) + "\n", encoding="utf-8")
    saved = sum(tests[name].seconds for name in left_out)
    total = sum(one.seconds + one.child_seconds for one in tests.values())
    print(f"{len(left_out)} of {len(tests)} tests, {saved:.0f} of {total:.0f} s of processor time")


def measure(folder: Path, asked: Iterable[str] = ("tests",)) -> None:
    """Run the tests asked for that are not in tests/slow.txt: their times and lines go to a folder."""
    from tests_of_lines import with_coverage

    folder = folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    environment = os.environ | {
        "PYTHONPATH": str(Path(__file__).parent),
        "COVERAGE_FILE": str(folder / "lines.coverage"),
        "SLOW_TESTS_FOLDER": str(folder),
    }
    marks = "not slow or covered"
    command = [
        *with_coverage(folder, marks),
        "-q",
        "-n",
        "2",
        "--dist",
        "loadfile",
        "-p",
        "slow_tests",
        *asked,
    ]
    for path in folder.glob("*.json"):
        path.unlink()
    subprocess.run(command, cwd=ROOT, env=environment, check=True)


def lines_of(path: Path, tests: set[str]) -> dict[str, set[tuple[str, int]]]:
    """Files and lines of the package that each test runs; what runs while a module is imported counts for none."""
    from coverage import CoverageData

    data = CoverageData(str(path))
    data.read()
    lines: dict[str, set[tuple[str, int]]] = defaultdict(set)
    for file in data.measured_files():
        for line, contexts in data.contexts_by_lineno(file).items():
            for name in tests & {context.rpartition("|")[0] for context in contexts}:
                lines[name].add((file, line))
    return lines


def chosen(
    tests: dict[str, Measured],
    lines: dict[str, set[tuple[str, int]]],
    seconds: float,
    case: float,
    enough: int,
) -> list[str]:
    """Names of the tests to leave out, the longest first."""
    left = Counter(place for places in lines.values() for place in places)
    needed = {place: min(count, enough) for place, count in left.items()}
    quickest: dict[str, str] = {}
    for name in sorted(tests, key=lambda name: tests[name].seconds):
        quickest.setdefault(name.split("[")[0], name)
    stay = {n for n in quickest.values() if tests[n].seconds < case or n.startswith("tests/physics/")}
    found = []
    for name in sorted(tests, key=lambda name: -tests[name].seconds):
        if (
            tests[name].seconds < seconds
            or tests[name].child_seconds > CHILD
            or name in stay
            or not lines.get(name)
        ):
            continue
        if all(left[place] > needed[place] for place in lines[name]):
            for place in lines[name]:
                left[place] -= 1
            found.append(name)
    return found


def shortened(names: Iterable[str], tests: Iterable[str]) -> list[str]:
    """Lines of the list: the function, where all its cases are left out."""
    cases, left_out = defaultdict(set), defaultdict(set)
    for name in tests:
        cases[name.split("[")[0]].add(name)
    for name in names:
        left_out[name.split("[")[0]].add(name)
    return sorted(
        line
        for function, those in left_out.items()
        for line in ([function] if those == cases[function] else those)
    )


class Recorder:
    """A plugin of pytest: times of the tests of a process, written to a folder at its end."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / f"{os.environ.get('PYTEST_XDIST_WORKER', 'main')}.json"
        self._tests: dict[str, Measured] = {}

    # The call alone: what a fixture of several tests makes is made for the next one too.
    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Generator[None, object, object]:
        before = os.times()
        try:
            return (yield)
        finally:
            own, children = (
                sum(
                    after - start
                    for after, start in zip(os.times()[k : k + 2], before[k : k + 2], strict=True)
                )
                for k in (0, 2)
            )
            self._tests[item.nodeid] = Measured(round(own, 3), round(children, 3))

    def pytest_sessionfinish(self) -> None:
        tests = {name: asdict(one) for name, one in self._tests.items()}
        if tests:
            self._path.write_text(json.dumps(tests), encoding="utf-8")


def pytest_configure(config: pytest.Config) -> None:
    """As a plugin, which `measure` asks for."""
    config.pluginmanager.register(Recorder(Path(os.environ["SLOW_TESTS_FOLDER"])))


if __name__ == "__main__":
    main()
