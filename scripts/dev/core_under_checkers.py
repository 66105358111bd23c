"""Run the tests of the C core, and of the modules that use it, under checkers of memory and undefined behaviour.

    python scripts/dev/core_under_checkers.py [--quick]

In a copy of the working tree the core is compiled by gcc with AddressSanitizer and UndefinedBehaviorSanitizer, and the
tests run on it; --quick: tests/core alone. Then valgrind, if installed, runs some of tests/core on a plain build and
finds reads of uninitialised values. The exit code is 1 if anything is found.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[2]
TESTS = ("tests/core", "tests/dynamics", "tests/lookup", "tests/interop/test_levitation_env.py")
OF_VALGRIND = tuple(f"tests/core/test_{name}.py" for name in ("machine", "map", "iron", "current_table"))
SANITIZERS = "gcc -fsanitize=address,undefined -fno-sanitize-recover=undefined -g -O1"


def copied(folder: Path) -> Path:
    """Copy the files of the working tree that git tracks."""
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout
    for name in names.decode().split("\0"):
        source, target = ROOT / name, folder / name
        if name and source.is_file():
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(source, target)
    return folder


def compiled(folder: Path, compiler: str) -> None:
    """Compile the core of a tree by a compiler with options."""
    command = [sys.executable, "fieldmap/core/compile.py"]
    subprocess.run(
        command, cwd=folder, env=os.environ | {"CC": compiler}, check=True, stdout=subprocess.DEVNULL
    )


def run(folder: Path, before: list[str], tests: tuple[str, ...], **environment: str) -> int:
    """The exit code of the tests in a tree."""
    pytest = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not slow", *tests]
    return subprocess.run(
        [*before, *pytest], cwd=folder, env=os.environ | {"PYTHONPATH": "."} | environment, check=False
    ).returncode


def sanitized(folder: Path, tests: tuple[str, ...]) -> int:
    """Run tests on a core compiled with sanitizers."""
    compiled(folder, SANITIZERS)
    libraries = [
        subprocess.run(
            ["gcc", f"-print-file-name=lib{name}.so"], capture_output=True, text=True, check=True
        ).stdout.strip()
        for name in ("asan", "ubsan")
    ]
    # Python itself does not free all memory at its end.
    return run(folder, [], tests, LD_PRELOAD=" ".join(libraries), ASAN_OPTIONS="detect_leaks=0")


def under_valgrind(folder: Path) -> int:
    """Number of errors that valgrind finds with the core on the stack."""
    compiled(folder, "gcc -g -O1")
    log = folder / "valgrind.log"
    code = run(
        folder,
        ["valgrind", f"--log-file={log}", "--num-callers=20"],
        (*OF_VALGRIND, "-k", "v2"),
        PYTHONMALLOC="malloc",
        OPENBLAS_NUM_THREADS="1",
    )
    errors = [part for part in log.read_text().split("==\n") if "library.x86-64" in part and " at 0x" in part]
    for error in errors:
        print(error, file=sys.stderr)
    return code or len(errors)


def main() -> int:
    """Run all checkers."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="tests/core under the sanitizers alone")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = copied(Path(name))
        found = sanitized(folder, TESTS[:1] if options.quick else TESTS)
        if not options.quick and shutil.which("valgrind"):
            found = under_valgrind(folder) or found
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
