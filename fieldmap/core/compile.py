"""Compile the C files of this folder to modules of Python in the same folder.

    python fieldmap/core/compile.py

The environment variable CC names the compiler, with any options. Without CC the compiler is that in the wheel
`ziglang`, which needs nothing else on the machine and also compiles for other systems (scripts/dev/wheels.py). An
installation runs this file before the package exists, so this file imports nothing of the package.
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
"""An installation without CC requires this wheel."""
# Products and sums are fused only within an expression, so that a point has the same bits alone and in a batch.
# Mathematical functions do not set errno. Floating-point exceptions are not supported, because gcc would not
# vectorise conditional expressions with them. No other option changes results.
_OPTIONS = (
    "-std=c99",
    "-O3",
    "-ffp-contract=on",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fvisibility=hidden",
    "-shared",
)
# By architecture: the processor levels for which a library is compiled, oldest first.
_PROCESSORS = {"x86_64": ("x86-64-v2", "x86-64-v3", "x86-64-v4")}
_MACHINES = {"AMD64": "x86_64", "x86-64": "x86_64", "arm64": "aarch64"}
# By system: the target name of zig, with the oldest supported C library or system version, and the suffix of modules.
_SYSTEMS = {
    "linux": ("linux-gnu.2.17", "so"),
    "darwin": ("macos.13.0", "so"),
    "win32": ("windows-gnu", "pyd"),
}
# By system: linker options with which the symbols of Python are resolved when a module is loaded. Windows has an
# import library for them. On macOS `-install_name` keeps the path of the build out of the module.
_LINKING = {
    "linux": ("-fPIC",),
    "darwin": ("-fPIC", "-Wl,-undefined,dynamic_lookup", "-Wl,-install_name,library"),
}


def machine() -> str:
    """Return the architecture of the processor by its name in compilers."""
    name = platform.machine()
    return _MACHINES.get(name, name)


def libraries(machine: str, system: str) -> dict[str, Path]:
    """Return the path of the module for each processor level, oldest first.

    The dot in the file name hides the module from programs that search for modules to import.
    """
    ending = _SYSTEMS.get(system, _SYSTEMS["linux"])[1]
    processors = _PROCESSORS.get(machine, (machine,))
    return {name: FOLDER / f"library.{name}.{ending}" for name in processors}


def wheel_tag(machine: str, system: str) -> str:
    """Return the tag of wheels for the oldest supported version of a system, and for Python from 3.11 on."""
    platform = {
        "linux": f"manylinux_2_17_{machine}",
        "darwin": f"macosx_13_0_{'arm64' if machine == 'aarch64' else machine}",
        "win32": "win_amd64" if machine == "x86_64" else "win_arm64",
    }
    return f"cp311-abi3-{platform[system]}"


def compile_libraries(
    machine: str, system: str, compiler: str | None, target: Path | None = None
) -> list[Path]:
    """Compile for every processor level of an architecture, and return the paths of the modules.

    compiler: a command, or None for zig. target: a folder for another system, with its headers in include/ and the
    import library of Python in libs/. Raises RuntimeError with the output of the compiler.
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
            # -s leaves out debugging symbols, which zig otherwise writes, on Windows into another file.
            chosen = [sys.executable, "-m", "ziglang", "cc", "-s"]
            chosen += ["-target", f"{machine}-{_SYSTEMS[system][0]}"]
            chosen += [f"-mcpu={name.replace('-', '_')}" for name in newer]
        else:
            first, *own = shlex.split(compiler)
            chosen = [first, *(f"-march={name}" for name in newer)]
        # The module replaces the old one only when it is complete, because another process may be loading the old
        # one. Other files that the compiler writes are deleted with the temporary folder.
        with tempfile.TemporaryDirectory(dir=FOLDER) as folder:
            new = Path(folder, path.name)
            # Options of the user come later, so they take precedence.
            command = [*chosen, *_OPTIONS, *own, *headers, "-o", str(new), str(FOLDER / "python.c"), *linked]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                raise RuntimeError(f"{shlex.join(command)}\n{done.stderr}")
            new.replace(path)
        written.append(path)
    return written


def main() -> int:
    """Compile for this machine, and return the exit status."""
    compiler = os.environ.get("CC")
    if compiler is None and importlib.util.find_spec("ziglang") is None:
        print(f'no compiler: pip install "{COMPILER}", or set CC', file=sys.stderr)
        return 1
    for path in compile_libraries(machine(), sys.platform, compiler):
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
