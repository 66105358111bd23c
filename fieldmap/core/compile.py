"""Compiles the run time: the C files beside this module become modules of Python beside them.

    python fieldmap/core/compile.py

The compiler is the one that the environment variable CC names, with any options of its own, or the one of the wheel
`ziglang`, which needs nothing else on the machine, and compiles for other systems too (scripts/dev/wheels.py). An
installation runs this once. Nothing of the package is imported here, because an installation runs it before there is
anything else.
"""

import importlib.util
import os
import platform
import shlex
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

import numpy

FOLDER = Path(__file__).parent
COMPILER = "ziglang==0.17.1"
"""Requirement of an installation without CC."""
# Products and sums are fused within an expression only, so that a point has the same bits alone and among others; and
# mathematical functions set no error numbers. Nothing else changes results. With exceptions of floating-point
# numbers, which nobody reads, gcc would not compute both sides of a choice in vectors.
_OPTIONS = (
    "-std=c99",
    "-O3",
    "-ffp-contract=on",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fvisibility=hidden",
    "-shared",
)
# By machine: processors for which a library is compiled, from the one that any has to the newest.
_PROCESSORS = {"x86_64": ("x86-64-v2", "x86-64-v3", "x86-64-v4")}
_MACHINES = {"AMD64": "x86_64", "x86-64": "x86_64", "arm64": "aarch64"}
# By system: how zig calls it (the oldest C library or system that it may have), and how modules end.
_SYSTEMS = {
    "linux": ("linux-gnu.2.17", "so"),
    "darwin": ("macos.13.0", "so"),
    "win32": ("windows-gnu", "pyd"),
}
# By system: what a module needs so that its names of Python are found when it is loaded; Windows has an import library
# for these. On macOS a module would also keep the path under which it was written.
_LINKING = {
    "linux": ("-fPIC",),
    "darwin": ("-fPIC", "-Wl,-undefined,dynamic_lookup", "-Wl,-install_name,library"),
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


def wheel_tag(machine: str, system: str) -> str:
    """The tag of wheels for a system: the oldest for which zig compiles, and all Pythons from 3.11 on."""
    platform = {
        "linux": f"manylinux_2_17_{machine}",
        "darwin": f"macosx_13_0_{'arm64' if machine == 'aarch64' else machine}",
        "win32": "win_amd64" if machine == "x86_64" else "win_arm64",
    }
    return f"cp311-abi3-{platform[system]}"


def compile_libraries(
    machine: str, system: str, compiler: str | None, target: Path | None = None
) -> list[Path]:
    """Compile for every processor of an architecture; the modules.

    compiler: a command, or None for zig's. target: a folder with what differs on another system than this one, headers
    in include/ and Python's import library in libs/. Raises RuntimeError with what the compiler said.
    """
    written, include = [], [sysconfig.get_path("include"), numpy.get_include()]
    if target is not None:
        include.insert(0, str(target / "include"))
    headers = [word for folder in include for word in ("-isystem", folder)]
    linked = _LINKING.get(system, _LINKING["linux"])
    if system == "win32":
        linked = (str((target or Path(sys.base_prefix)) / "libs" / "python3.lib"),)
    own: list[str] = []
    for processor, path in libraries(machine, system).items():
        newer = [] if processor == machine else [processor]
        if compiler is None:
            # Without symbols, which zig would write, for Windows into a file beside.
            chosen = [sys.executable, "-m", "ziglang", "cc", "-s"]
            chosen += ["-target", f"{machine}-{_SYSTEMS[system][0]}"]
            chosen += [f"-mcpu={name.replace('-', '_')}" for name in newer]
        else:
            first, *own = shlex.split(compiler)
            chosen = [first, *(f"-march={name}" for name in newer)]
        # In its place only when it is whole: another process may be loading the old one. What a compiler writes beside
        # it stays behind.
        with tempfile.TemporaryDirectory(dir=FOLDER) as folder:
            new = Path(folder, path.name)
            # The user's own options come behind, and win.
            command = [*chosen, *_OPTIONS, *own, *headers, "-o", str(new), str(FOLDER / "python.c"), *linked]
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
