"""Build the wheels of all systems on one machine with Linux, and check them.

    pip install build hatchling numpy abi3audit ziglang
    python scripts/dev/wheels.py fieldmap-0.2.0.tar.gz [--folder dist] [--only aarch64-darwin x86_64-win32]

The source is a source distribution, so that no library of a checkout is overwritten. A wheel that exists in the folder
is checked, not built again. zig compiles for every system. Files that another system needs are in a folder, which
scripts/dev/build_hook.py passes to the compiler:

- the headers of numpy, from numpy's own wheel for that system;
- for Windows scripts/dev/pyconfig_windows.h instead of this machine's pyconfig.h, and an import library of
  python3.dll, made by zig from the names of the stable interface, which the package abi3info lists.

Builds for macOS and other processors use this machine's headers of Python, because the stable interface depends on the
sizes of types only, which are the same there.

Each wheel must hold the libraries of its system, in the system's format and for its processor. They may use only the
stable interface of Python 3.11 (abi3audit), and only versions of Linux's C library that the wheel's tag allows. Nothing
is run; docs/release.md says what was run. The exit code is 1 if anything fails.
"""

import argparse
import os
import re
import runpy
import shutil
import struct
import subprocess
import sys
import sysconfig
import tempfile
import zipfile
from importlib.metadata import version
from pathlib import Path

ROOT = Path(__file__).parents[2]
CORE = runpy.run_path(str(ROOT / "fieldmap" / "core" / "compile.py"))
TARGETS = {
    "x86_64-linux": "manylinux_2_28_x86_64",
    "aarch64-linux": "manylinux_2_28_aarch64",
    "x86_64-darwin": "macosx_13_0_x86_64",
    "aarch64-darwin": "macosx_13_0_arm64",
    "x86_64-win32": "win_amd64",
    "aarch64-win32": "win_arm64",
}
"""Machine and system -> tag of the wheel. numpy has wheels for all of them."""
_NUMPY_HEADERS = "numpy/_core/include/"
# By system: the first bytes of a library, and the numbers of the processors in its header.
_FORMATS = {
    "linux": (b"\x7fELF", {"x86_64": 62, "aarch64": 183}),
    "darwin": (b"\xcf\xfa\xed\xfe", {"x86_64": 0x01000007, "aarch64": 0x0100000C}),
    "win32": (b"MZ", {"x86_64": 0x8664, "aarch64": 0xAA64}),
}
_OLDEST_GLIBC = 17


def _run(*command: str, **environment: str) -> None:
    # CC would name a compiler for this system.
    given = {name: value for name, value in os.environ.items() if name != "CC"}
    done = subprocess.run(
        [sys.executable, "-m", *command], capture_output=True, text=True, env={**given, **environment}
    )
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}\n{done.stdout}\n{done.stderr}")


def files_of(target: str, folder: Path) -> None:
    """Write the files of a system into `folder`: include, and libs if modules are linked with Python there."""
    machine, system = target.split("-")
    options = ["--platform", TARGETS[target], "--only-binary=:all:", "--no-deps", "--quiet"]
    _run("pip", "download", *options, "--dest", str(folder / "numpy"), f"numpy=={version('numpy')}")
    (numpy,) = (folder / "numpy").glob("*.whl")
    with zipfile.ZipFile(numpy) as archive:
        for name in archive.namelist():
            if name.startswith(_NUMPY_HEADERS) and name.endswith(".h"):
                path = folder / "include" / name.removeprefix(_NUMPY_HEADERS)
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(archive.read(name))
    if system == "win32":
        shutil.copytree(sysconfig.get_path("include"), folder / "include", dirs_exist_ok=True)
        shutil.copy(ROOT / "scripts" / "dev" / "pyconfig_windows.h", folder / "include" / "pyconfig.h")
        _import_library(machine, folder / "libs")


def _import_library(machine: str, folder: Path) -> None:
    from abi3info import DATAS, FUNCTIONS

    names = [*(one.name for one in FUNCTIONS), *(f"{one.name} DATA" for one in DATAS)]
    folder.mkdir()
    (folder / "python3.def").write_text("LIBRARY python3.dll\nEXPORTS\n" + "\n".join(sorted(names)) + "\n")
    kind = "i386:x86-64" if machine == "x86_64" else "arm64"
    _run(
        *("ziglang", "dlltool", "-m", kind),
        *("-d", str(folder / "python3.def"), "-l", str(folder / "python3.lib")),
    )


def build(source: Path, target: str, wheel: Path) -> None:
    """Write the wheel of a system."""
    with tempfile.TemporaryDirectory(prefix="fieldmap_wheel_") as files:
        files_of(target, Path(files))
        command = ("build", "--wheel", "--no-isolation", "--outdir", str(wheel.parent), str(source))
        _run(*command, FIELDMAP_TARGET=target, FIELDMAP_TARGET_FILES=files)


def check(wheel: Path, target: str) -> list[str]:
    """Describe the libraries in a wheel. Raises RuntimeError unless they are for the system."""
    machine, system = target.split("-")
    wanted = {path.name for path in CORE["libraries"](machine, system).values()}
    with zipfile.ZipFile(wheel) as archive:
        inside = {
            Path(name).name: archive.read(name)
            for name in archive.namelist()
            if Path(name).name.startswith("library.") and not name.endswith(".py")
        }
    if set(inside) != wanted:
        raise RuntimeError(f"{wheel.name} has {sorted(inside)}, not {sorted(wanted)}")
    told = [f"{name}: {of_library(content, machine, system)}" for name, content in sorted(inside.items())]
    _run("abi3audit", "--strict", str(wheel))
    return told


def of_library(content: bytes, machine: str, system: str) -> str:
    """Describe a library. Raises RuntimeError unless it is for the machine and system, and a module of Python."""
    start, numbers = _FORMATS[system]
    if system == "linux":
        (found,) = struct.unpack_from("<H", content, 18)
    elif system == "darwin":
        (found,) = struct.unpack_from("<I", content, 4)
    else:
        (header,) = struct.unpack_from("<I", content, 60)
        (found,) = struct.unpack_from("<H", content, header + 4)
    if not content.startswith(start) or found != numbers[machine]:
        raise RuntimeError(f"not a library for {machine} and {system}: {content[:4]!r}, {found:#x}")
    if b"PyInit_library" not in content:
        raise RuntimeError("not a module of Python: PyInit_library is not there")
    told = f"{len(content) / 1e6:.2f} MB"
    if system == "linux":
        newest = max(int(minor) for minor in re.findall(rb"GLIBC_2\.(\d+)", content))
        if newest > _OLDEST_GLIBC:
            raise RuntimeError(f"needs glibc 2.{newest}, newer than 2.{_OLDEST_GLIBC}")
        told += f", glibc 2.{newest}"
    return told


def main() -> int:
    """Build and check; 1 if one fails."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("source", type=Path, help="the source distribution")
    parser.add_argument("--folder", type=Path, default=Path("dist"), help="where the wheels go")
    parser.add_argument("--only", nargs="+", choices=list(TARGETS), default=list(TARGETS))
    given = parser.parse_args()
    try:
        for target in given.only:
            name = given.source.name.removesuffix(".tar.gz")
            wheel = given.folder / f"{name}-{CORE['wheel_tag'](*target.split('-'))}.whl"
            if not wheel.exists():
                build(given.source, target, wheel)
            told = check(wheel, target)
            print(f"  {wheel.name} {wheel.stat().st_size / 1e6:.1f} MB; {'; '.join(told)}", flush=True)
    except RuntimeError as error:
        print(f"FAILED: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
