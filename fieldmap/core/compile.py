"""Compiles the run time: the C files beside this module become modules of Python beside them.

    python fieldmap/core/compile.py

The compiler is the one that the environment variable CC names, with any options of its own, or the one of the wheel
`ziglang`, which needs nothing else on the machine. An installation runs this once. Nothing of the package is imported
here, because an installation runs it before there is anything else.
"""

import importlib.util
import os
import platform
import shlex
import subprocess
import sys
import sysconfig
from pathlib import Path

import numpy

FOLDER = Path(__file__).parent
COMPILER = "ziglang==0.17.1"
"""Requirement of an installation without CC."""
# Products and sums are fused within an expression only, so that a point has the same bits alone and among others; and
# mathematical functions set no error numbers. Nothing else changes results.
_OPTIONS = ("-std=c99", "-O3", "-ffp-contract=on", "-fno-math-errno", "-fvisibility=hidden", "-shared")
# By machine: processors for which a library is compiled, from the one that any has to the newest.
_PROCESSORS = {"x86_64": ("x86-64-v2", "x86-64-v3")}
_MACHINES = {"AMD64": "x86_64", "x86-64": "x86_64", "arm64": "aarch64"}
# By system: how zig calls it (the oldest C library that Linux may have), and how modules end.
_SYSTEMS = {
    "linux": ("linux-gnu.2.17", "so"),
    "darwin": ("macos", "so"),
    "win32": ("windows-gnu", "pyd"),
}


def machine() -> str:
    """The processor's architecture, as compilers call it."""
    name = platform.machine()
    return _MACHINES.get(name, name)


def libraries(machine: str, system: str) -> dict[str, Path]:
    """By processor, from the one that any machine of this architecture has to the newest: where its module lies.

    The dot in its name hides it from programs that look for modules to import.
    """
    ending = _SYSTEMS.get(system, _SYSTEMS["linux"])[1]
    processors = _PROCESSORS.get(machine, (machine,))
    return {name: FOLDER / f"library.{name}.{ending}" for name in processors}


def compile_libraries(machine: str, system: str, compiler: str | None) -> list[Path]:
    """Compile for every processor of an architecture; the modules. compiler: a command, or None for zig's. Raises
    RuntimeError with what the compiler said."""
    written, include = [], [sysconfig.get_path("include"), numpy.get_include()]
    headers = [word for folder in include for word in ("-isystem", folder)]
    own: list[str] = []
    for processor, path in libraries(machine, system).items():
        newer = [] if processor == machine else [processor]
        if compiler is None:
            target = f"{machine}-{_SYSTEMS[system][0]}"
            chosen = [sys.executable, "-m", "ziglang", "cc", "-target", target]
            chosen += [f"-mcpu={name.replace('-', '_')}" for name in newer]
        else:
            first, *own = shlex.split(compiler)
            chosen = [first, *(f"-march={name}" for name in newer)]
        position = [] if system == "win32" else ["-fPIC"]
        # In its place only when it is whole: another process may be loading the old one.
        new = path.with_name(f"{path.name}.new")
        # The user's own options come behind, and win.
        command = [*chosen, *_OPTIONS, *own, *position, *headers, "-o", str(new), str(FOLDER / "python.c")]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"{shlex.join(command)}\n{done.stderr}")
        new.replace(path)
        written.append(path)
    return written


def main() -> int:
    """Compile for this machine."""
    compiler = os.environ.get("CC")
    if compiler is None and importlib.util.find_spec("ziglang") is None:
        print(f'no compiler: pip install "{COMPILER}", or set CC', file=sys.stderr)
        return 1
    for path in compile_libraries(machine(), sys.platform, compiler):
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
