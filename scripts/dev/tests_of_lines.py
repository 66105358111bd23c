"""The tests that run a line of the package, and the time of each, from which scripts/dev/mutants.py selects its tests.

The tests run once with coverage.py, with one context per test. Results of a file of tests are kept until it changes.
Tests that fail, and tests that `make test` leaves out, do not count. Lines run in other processes are not seen.
"""

import ast
import hashlib
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

# Largest sum of the times of the tests for one error, s. The least useful tests beyond it are left out: most errors are
# caught within a few seconds, and a survivor costs the whole time.
LIMIT = 60.0
_PASSED = re.compile(r"^(tests/\S+\.py::.*?) PASSED\b", re.MULTILINE)
_SECONDS = re.compile(r"^([\d.]+)s (?:setup|call|teardown) +(tests/.*)$", re.MULTILINE)


class TestsOfLines:
    """Tests by the lines that they run, kept in a folder.

    checkout: the folder with the package and its tests; keep: the folder of the results; tests: files and folders of
    tests that count, relative to the checkout.
    """

    def __init__(self, checkout: Path, keep: Path, tests: list[str], environment: dict[str, str]) -> None:
        self._checkout, self._keep = checkout, keep
        self._environment = environment
        keep.mkdir(parents=True, exist_ok=True)
        kept = keep / "known.json"
        known = (
            json.loads(kept.read_text(encoding="utf-8")) if kept.is_file() else {"files": {}, "package": {}}
        )
        files = [file for test in tests for file in self._files(test)]
        stale = [file for file in files if known["files"].get(file, {}).get("hash") != self._hash(file)]
        if stale:
            known["files"] |= self._run(stale, f"{len(list(keep.glob('*.coverage')))}.coverage")
            # Line numbers belong to the package at the first run; `of` checks the hash of a file.
            for path in (checkout / "fieldmap").rglob("*.py"):
                name = path.relative_to(checkout).as_posix()
                known["package"].setdefault(name, self._hash(name))
            kept.write_text(json.dumps(known), encoding="utf-8")
        # Imported here, because it belongs to the extra `mutants` and tests of this program do not need it.
        from coverage import CoverageData

        self._package = known["package"]
        self.seconds: dict[str, float] = {}
        for file in files:
            self.seconds |= known["files"].get(file, {}).get("seconds", {})
        self._data = []
        for path in sorted(keep.glob("*.coverage")):
            data = CoverageData(str(path))
            data.read()
            self._data.append(data)
        self._lines: dict[str, dict[int, set[str]]] = {}
        walking = {file for file in files if reads_definitions(checkout / file)}
        self._of_all_modules = {name for name in self.seconds if name.split("::")[0] in walking}

    def of(self, file: str, line: int, package: str) -> list[str]:
        """Names of tests that run the statement at a line, the quickest first, then other tests of their files, which
        may use cached results of these tests; at most `LIMIT` s in all. Empty if no test runs the line."""
        lines, defining = self._lines_of(file), self._defines(file, line)
        module = _module(file)
        if self._package.get(file) != self._hash(file):
            found = set().union(*lines.values()) if lines else set()
        else:
            found = set().union(*(lines.get(k, set()) for k in self._statement(file, line)))
            if "" in found or defining:
                # The line runs at import, so it may affect every test that uses the module.
                found = set().union(*lines.values()) | self._of_all_modules | self._beside(module)
        running = {name for name in found if name in self.seconds}
        near = {
            test
            for test in {name.split("::")[0] for name in running}
            if test.startswith(f"tests/{package}/")
            or module in (self._checkout / test).read_text(encoding="utf-8")
        }

        def cost(name: str) -> float:
            if defining and name in self._of_all_modules:
                return 0.0
            return (self.seconds[name] + 0.02) * (1.0 if name.split("::")[0] in near else 3.0)

        beside = [name for name in self.seconds if name.split("::")[0] in near and name not in running]
        chosen, total = [], 0.0
        for name in [*sorted(running, key=cost), *beside]:
            if total + self.seconds[name] <= LIMIT:
                chosen.append(name)
                total += self.seconds[name]
        return chosen

    def _beside(self, module: str) -> set[str]:
        """Tests that use definitions of a module without running its lines: tests in files that name the module, and
        tests that run modules that import it."""
        files = {name.split("::")[0] for name in self.seconds}
        naming = {test for test in files if module in (self._checkout / test).read_text(encoding="utf-8")}
        found = {name for name in self.seconds if name.split("::")[0] in naming}
        for path in (self._checkout / "fieldmap").rglob("*.py"):
            if module in imported(path.read_text(encoding="utf-8")):
                found.update(*self._lines_of(path.relative_to(self._checkout).as_posix()).values())
        return found

    def _files(self, test: str) -> Iterator[str]:
        path = self._checkout / test
        for file in sorted(path.rglob("test_*.py")) if path.is_dir() else [path]:
            yield file.relative_to(self._checkout).as_posix()

    def _hash(self, file: str) -> str:
        """Hash of a file, and of the list of its left-out tests."""
        content = (self._checkout / file).read_bytes()
        lines = (self._checkout / "tests" / "slow.txt").read_text(encoding="utf-8").splitlines()
        content += "\n".join(line for line in lines if line.startswith(f"{file}::")).encode()
        return hashlib.sha256(content).hexdigest()[:16]

    def _run(self, files: list[str], name: str) -> dict[str, dict[str, object]]:
        """Run tests with coverage. Returns the hash of each file and the seconds of each test that passed."""
        settings = self._keep / "coverage.ini"
        settings.write_text("[run]\nsource = fieldmap\nrelative_files = true\n", encoding="utf-8")
        command = [
            sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-p", "pytest_cov", "-m", "not slow",
            "--cov=fieldmap", f"--cov-config={settings}", "--cov-context=test", "--cov-report=",
            "--durations=0", "-vv", *files,
        ]  # fmt: skip
        environment = self._environment | {"COVERAGE_FILE": str(self._keep / name)}
        done = subprocess.run(command, cwd=self._checkout, env=environment, capture_output=True, text=True)
        return self.read(files, done.stdout)

    def read(self, files: list[str], printed: str) -> dict[str, dict[str, object]]:
        """Read hash and seconds of these files from the output of pytest."""
        taken: dict[str, float] = {}
        for seconds, name in _SECONDS.findall(printed):
            taken[name] = taken.get(name, 0.0) + float(seconds)
        found: dict[str, dict[str, object]] = {
            file: {"hash": self._hash(file), "seconds": {}} for file in files
        }
        for name in _PASSED.findall(printed):
            found[name.split("::")[0]]["seconds"][name] = round(taken.get(name, 0.0), 3)  # type: ignore[index]
        return found

    def _lines_of(self, file: str) -> dict[int, set[str]]:
        """For each line that was run, the tests that ran it; "" stands for the import of the module."""
        if file not in self._lines:
            lines: dict[int, set[str]] = {}
            for data in self._data:
                for line, contexts in data.contexts_by_lineno(file).items():
                    lines.setdefault(line, set()).update(context.rpartition("|")[0] for context in contexts)
            self._lines[file] = lines
        return self._lines[file]

    def _defines(self, file: str, line: int) -> bool:
        """Whether a line is outside all bodies of functions and therefore runs while the module is imported."""
        tree = ast.parse((self._checkout / file).read_text(encoding="utf-8"))
        functions = (one for one in ast.walk(tree) if isinstance(one, ast.FunctionDef | ast.AsyncFunctionDef))
        return not any(one.body[0].lineno <= line <= (one.end_lineno or line) for one in functions)

    def _statement(self, file: str, line: int) -> range:
        """Lines of the innermost statement at a line; for a statement with a body, the lines before the body."""
        best = range(line, line + 1)
        for node in ast.walk(ast.parse((self._checkout / file).read_text(encoding="utf-8"))):
            if not isinstance(node, ast.stmt):
                continue
            body = getattr(node, "body", None)
            last = body[0].lineno - 1 if body else node.end_lineno or node.lineno
            if node.lineno <= line <= max(last, node.lineno):
                best = range(node.lineno, max(last, node.lineno) + 1)
        return best


def imported(text: str) -> set[str]:
    """Modules that a text imports: of `from a.b import c` both a.b and a.b.c."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom):
            found |= {f"{node.module}", *(f"{node.module}.{one.name}" for one in node.names)}
        elif isinstance(node, ast.Import):
            found |= {one.name for one in node.names}
    return found


def _module(file: str) -> str:
    return file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def reads_definitions(file: Path) -> bool:
    """Whether a file of tests compares definitions, such as signatures and keys of files with their bounds, with pages
    and schemas. Coverage does not show such tests, because definitions run while a module is imported, in any test."""
    text = file.read_text(encoding="utf-8")
    return any(word in text for word in ("walk_packages", "api_signatures", "key_pages", "schema_files"))


def environment_of(checkout: Path) -> dict[str, str]:
    """Environment variables of a process that imports the package from a checkout, not an installed one."""
    others = [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]
    # Another checkout on the path would hide the copy with errors. Other folders on the path stay.
    others = [path for path in others if not (Path(path) / "fieldmap").is_dir()]
    one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    return os.environ | one | {"PYTHONPATH": os.pathsep.join([str(checkout), *others]), "PYTHONSAFEPATH": "1"}
