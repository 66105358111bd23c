"""Build wheel and source distribution, and test the wheel in a fresh environment, as a user installs it.

    python scripts/dev/release_check.py [--folder FOLDER] [--only build core levitation all citation wheels]

1. build: `python -m build`, in an environment of its own, makes the source distribution, and the wheel from it. Both
   must hold the tracked shipped files and nothing else, except for the compiled core in the wheel.
2. core: the wheel alone in a fresh environment, with its size printed. It opens the shipped map, looks up fields,
   forces and currents, and names the command that installs a missing extra.
3. levitation: `pip install "fieldmap[levitation]"` in the same environment; a magnet levitates on the map and is
   simulated.
4. all: `pip install "fieldmap[all]"` in the same environment keeps the installed wheel; `fieldmap map quick` makes a
   map there.
5. citation: `cffconvert --validate` for CITATION.cff, which must state the version of the package.
6. wheels: of the other systems, built from the source distribution and checked by scripts/dev/wheels.py (on Linux).

Takes about 1.5 GB of disk in a folder that is deleted at the end, and downloads. The exit code is 1 if anything fails.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
import tomllib
import venv
import zipfile
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parents[2]
LARGEST_MB = 200.0
STEPS = ("build", "core", "levitation", "all", "citation", "wheels")

ASK = """
import json, sys, time
start = time.perf_counter()
import fieldmap as fm
imported = time.perf_counter()
m = fm.open_map("sample")
opened = time.perf_counter()
place, moment = [0.0, 0.0, -0.1], [0.0, 0.0, 1.0]
currents = m.currents_for(place, [0.0, 0.0, 0.1], moment)
print(json.dumps({
    "where": fm.__file__, "import_s": imported - start, "open_map_s": opened - imported,
    "Bz_T": m.field(place, 1.0)[2], "lift_N": round(m.wrench(place, moment, currents)[2], 9),
    "scipy": "scipy" in sys.modules,
}))
"""
USE = """
import json
import fieldmap as fm
m = fm.open_map("sample")
device = fm.read_device("disk_six_cores", changes={"driver.current_limit_A": 15.0})
e = fm.find_equilibrium(m, 9.0, device.payload)
run = fm.simulate("hold", {"start.depth_mm": 95, "field.scale": 2.15}, field_map=m, device=device)
print(json.dumps({
    "floats_at_mm": 1e3 * e.position[2], "run": str(run.event or "held"), "samples": len(run.time),
}))
"""


class Environment:
    """A fresh virtual environment."""

    def __init__(self, folder: Path) -> None:
        venv.create(folder, with_pip=True)
        self.scripts = folder / ("Scripts" if sys.platform == "win32" else "bin")
        self.python = self.scripts / "python"
        self.packages = Path(self.run("-c", "import sysconfig; print(sysconfig.get_path('purelib'))").strip())

    def run(self, *arguments: str, folder: Path | None = None, fails: bool = False) -> str:
        """Output of `python ARGUMENTS`. Raises RuntimeError if it fails, or succeeds where `fails` is True."""
        clean = {
            name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONHOME")
        }
        done = subprocess.run(
            [str(self.python), *arguments],
            capture_output=True,
            text=True,
            encoding="utf-8",
            cwd=folder,
            env=clean,
        )
        if (done.returncode != 0) != fails:
            raise RuntimeError(f"python {' '.join(arguments)}\n{done.stdout}\n{done.stderr}")
        return done.stdout + done.stderr if fails else done.stdout

    def install(self, *what: str) -> None:
        """`pip install` with the versions in constraints.txt."""
        constraints = str(ROOT / "constraints.txt")
        self.run("-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-c", constraints, *what)

    def megabytes(self) -> float:
        """Size of the environment, pip included, 1e6 bytes."""
        files = (path for path in self.packages.rglob("*") if path.is_file() and not path.is_symlink())
        return sum(path.stat().st_size for path in files) / 1e6


def build(folder: Path) -> tuple[Path, Path]:
    """Build the wheel and the source distribution in `folder`/dist, which then holds nothing else."""
    shutil.rmtree(folder / "dist", ignore_errors=True)
    builder = Environment(folder / "builder")
    builder.install("build")
    builder.run("-m", "build", "--outdir", str(folder / "dist"), str(ROOT))
    (wheel,), (source,) = (folder / "dist").glob("*.whl"), (folder / "dist").glob("*.tar.gz")
    _contents(wheel, source)
    shutil.rmtree(folder / "builder")
    return wheel, source


def _contents(wheel: Path, source: Path) -> None:
    """Raises RuntimeError unless both hold only the tracked files, and the wheel also the compiled core."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True)
    tracked = set(filter(None, listed.stdout.split("\0")))
    with tarfile.open(source) as archive:
        names = {name.partition("/")[2] for name in archive.getnames() if not name.endswith("/PKG-INFO")}
        folders = {str(parent) for name in names for parent in Path(name).parents}
    strange = {name for name in names - tracked - folders if name}
    missing = {name for name in tracked - names if not name.startswith(".")}
    with zipfile.ZipFile(wheel) as archive:
        inside = {name for name in archive.namelist() if ".dist-info/" not in name}
    expected = {name for name in tracked if name.startswith("fieldmap/")}
    compiled = {name for name in inside if re.fullmatch(r"fieldmap/core/library[^/]*\.(so|pyd)", name)}
    if not compiled:
        raise RuntimeError(f"{wheel.name} holds no compiled core")
    expected |= compiled
    expected |= {f"fieldmap/shipped/{name}" for name in tracked if name.startswith(("geometry/", "maps/"))}
    for what, wrong in {
        "strange in the source distribution": strange,
        "missing in the source distribution": missing,
        "strange in the wheel": inside - expected,
        "missing in the wheel": expected - inside,
    }.items():
        if wrong:
            raise RuntimeError(f"{what}: {', '.join(sorted(wrong)[:20])}")
    print(f"  {wheel.name} {wheel.stat().st_size / 1e6:.1f} MB, {len(inside)} files")
    print(
        f"  {source.name} {source.stat().st_size / 1e6:.1f} MB, {len(names)} files and folders, those of git"
    )


def core(folder: Path, wheel: Path) -> Environment:
    """Make and test an environment with the wheel alone."""
    environment = Environment(folder / "environment")
    before, began = environment.megabytes(), time.monotonic()
    environment.install(str(wheel))
    whole, seconds = environment.megabytes(), time.monotonic() - began
    size = whole - before
    print(f"  installed in {seconds:.0f} s: {size:.0f} MB (bound {LARGEST_MB:.0f}), {whole:.0f} with pip")
    if size > LARGEST_MB:
        raise RuntimeError(f"the core takes {size:.0f} MB, more than {LARGEST_MB:.0f}")
    for state in ("first", "again"):
        began = time.monotonic()
        printed = environment.run("-c", ASK, folder=folder)
        print(f"  {state}, {time.monotonic() - began:.1f} s: {printed.strip()}")
        _expect('"lift_N": 0.1, "scipy": false', printed)
    told = environment.run("-m", "fieldmap", "check", "drive_unit", folder=folder, fails=True)
    _expect('pip install "fieldmap[cli]"', told)
    for call, extra in (
        ("find_equilibrium(fm.open_map('sample'), 9.0, None)", "levitation"),
        ("generate('quick', 'q.h5')", "make"),
    ):
        told = environment.run("-c", f"import fieldmap as fm; fm.{call}", folder=folder, fails=True)
        _expect(f'pip install "fieldmap[{extra}]"', told)
    print("  without extras: fieldmap names [cli], find_equilibrium [levitation], generate [make]")
    return environment


def levitation(folder: Path, environment: Environment) -> None:
    """Test the same environment with scipy."""
    before, began = environment.megabytes(), time.monotonic()
    environment.install("fieldmap[levitation]")
    print(f"  installed in {time.monotonic() - began:.0f} s: {environment.megabytes() - before:.0f} MB more")
    began = time.monotonic()
    printed = environment.run("-c", USE, folder=folder)
    print(f"  {time.monotonic() - began:.1f} s: {printed.strip()}")
    _expect('"run": "held"', printed)


def everything(folder: Path, environment: Environment) -> None:
    """Test the same environment with all extras."""
    began = time.monotonic()
    # pip must keep the installed wheel, although a registry may have a package of this name.
    environment.install("fieldmap[all]")
    version = environment.run("-c", "import fieldmap; print(fieldmap.__version__)", folder=folder).strip()
    _expect(
        tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"], version
    )
    print(
        f"  installed in {time.monotonic() - began:.0f} s: {environment.megabytes():.0f} MB with kernels and pip"
    )
    began = time.monotonic()
    environment.run("-m", "fieldmap", "map", "quick", "-o", "quick.h5", "--summary", folder=folder)
    found = environment.run("-m", "fieldmap", "equilibrium", "quick.h5", "--currents", "9", folder=folder)
    _expect("-10[67]", found)
    pictures = sorted(path.name for path in folder.glob("*.png"))
    print(
        f"  fieldmap map quick and fieldmap equilibrium: {time.monotonic() - began:.0f} s, kernels cold; {pictures}"
    )


def citation(folder: Path) -> None:
    """Check that CITATION.cff is valid and states the version of the package."""
    reader = Environment(folder / "citation")
    reader.run(
        "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "cffconvert", "setuptools<81"
    )
    command = [str(reader.scripts / "cffconvert"), "--validate", "-i", str(ROOT / "CITATION.cff")]
    done = subprocess.run(command, capture_output=True, text=True)
    print("  cffconvert --validate:", (done.stdout + done.stderr).strip())
    _expect("valid according to schema", done.stdout)


def wheels(folder: Path, source: Path) -> None:
    """Build the wheels of the other systems, in the folder of the source distribution."""
    builder = Environment(folder / "builder")
    builder.install("build", "hatchling", "numpy", "abi3audit")
    compiling = ROOT / "fieldmap" / "core" / "compile.py"
    builder.install(
        builder.run("-c", f"import runpy; print(runpy.run_path({str(compiling)!r})['COMPILER'])").strip()
    )
    print(
        builder.run(str(ROOT / "scripts" / "dev" / "wheels.py"), str(source), "--folder", str(source.parent)),
        end="",
    )
    shutil.rmtree(folder / "builder")


def _expect(pattern: str, text: str) -> None:
    if not (pattern in text or re.search(pattern, text)):
        raise RuntimeError(f"{pattern!r} is not in\n{text}")


def main() -> int:
    """Run the steps; 1 if one fails."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--folder", type=Path, help="where to work; deleted at the end unless given")
    parser.add_argument("--only", nargs="+", choices=STEPS, default=list(STEPS))
    given = parser.parse_args()
    folder = given.folder or Path(tempfile.mkdtemp(prefix="fieldmap_release_"))
    folder.mkdir(parents=True, exist_ok=True)
    made: dict[str, object] = {}

    def of_wheel() -> None:
        made["environment"] = core(folder, made["wheel"])  # type: ignore[arg-type]

    def of_levitation() -> None:
        levitation(folder, made["environment"])  # type: ignore[arg-type]

    def of_all() -> None:
        everything(folder, made["environment"])  # type: ignore[arg-type]

    def built() -> None:
        made["wheel"], made["source"] = build(folder)

    steps: dict[str, Callable[[], None]] = {
        "build": built,
        "core": of_wheel,
        "levitation": of_levitation,
        "all": of_all,
        "citation": lambda: citation(folder),
        "wheels": lambda: wheels(folder, made["source"]),  # type: ignore[arg-type]
    }
    needed = {
        "core": {"build"},
        "levitation": {"build", "core"},
        "all": {"build", "core"},
        "wheels": {"build"},
    }
    wanted = set(given.only).union(*(needed.get(step, set()) for step in given.only))
    try:
        for step in STEPS:
            if step in wanted:
                print(step, flush=True)
                steps[step]()
    except RuntimeError as error:
        print(f"FAILED: {error}", file=sys.stderr)
        return 1
    finally:
        if given.folder is None:
            shutil.rmtree(folder, ignore_errors=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
