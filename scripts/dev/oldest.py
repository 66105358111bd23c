"""Run tests with the oldest versions that pyproject.toml allows, in a fresh environment.

    python scripts/dev/oldest.py [--folder FOLDER] [--extras make plot cli mujoco jax] [-- TEST ...]

Every lower bound of the core and of these extras becomes the exact version. Dependencies of these libraries have their
newest compatible versions, except for the entries of BESIDE, because old libraries do not bound later dependencies.
Takes about 1.2 GB of disk in a folder that is deleted at the end. The exit code is that of pytest.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import venv
from pathlib import Path

ROOT = Path(__file__).parents[2]
EXTRAS = ("make", "plot", "cli", "mujoco", "jax")
# TOOLS: requirements of the tests. BESIDE: older versions of dependencies that old libraries need without stating it.
TOOLS = ("pytest>=8.2", "pytest-xdist>=3.6", "jsonschema>=4.22")
BESIDE: tuple[str, ...] = ()
TESTS = (
    "tests/test_slim_installation.py",
    "tests/store",
    "tests/device",
    "tests/lookup",
    "tests/levitation",
    "tests/sources",
    "tests/maps/test_sample.py",
    "tests/iron/test_solve_linear.py",
    "tests/iron/test_bh_laws.py",
    "tests/plot/test_figures.py",
    "tests/plot/test_device_drawing.py",
    "tests/cli/test_manners.py",
    "tests/interop/test_mujoco.py",
    "tests/interop/test_jax.py",
)


def oldest(extras: list[str]) -> list[str]:
    """Requirements of exactly the lower bounds: "numpy==2.0".

    Raises ValueError for a requirement without a lower bound.
    """
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    optional = project["optional-dependencies"]
    waiting = [*project["dependencies"], *(one for name in extras for one in optional[name])]
    exact: dict[str, tuple[tuple[int, ...], str]] = {}
    while waiting:
        one = waiting.pop(0)
        if named := re.fullmatch(r"fieldmap\[([\w,-]+)\]", one):
            waiting += [part for name in named[1].split(",") for part in optional[name]]
            continue
        found = re.fullmatch(r"([\w.-]+)>=([\w.]+)(,<[\w.]+)?(;.*)?", one)
        if found is None:
            raise ValueError(f"{one}: no lower bound")
        # Extras may have different lower bounds of a library; pip needs the highest.
        bound = tuple(int(part) for part in found[2].split("."))
        exact[found[1]] = max(
            exact.get(found[1], ((), "")), (bound, f"{found[1]}=={found[2]}{found[4] or ''}")
        )
    return [requirement for _, requirement in exact.values()]


def main() -> int:
    """Make the environment, print what is in it, and run the tests there."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--folder", type=Path, help="where the environment goes; deleted at the end unless given"
    )
    parser.add_argument("--extras", nargs="*", default=list(EXTRAS))
    parser.add_argument("tests", nargs="*", default=list(TESTS))
    given = parser.parse_args()
    folder = given.folder or Path(tempfile.mkdtemp(prefix="fieldmap_oldest_"))
    python = str(folder / ("Scripts" if sys.platform == "win32" else "bin") / "python")
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONHOME"}
    clean |= {
        "PYTHONPATH": str(ROOT),
        "NUMBA_CACHE_DIR": str(folder / "kernels"),
        "PYTHONPYCACHEPREFIX": str(folder / "bytecode"),
    }
    pip = [python, "-m", "pip", "--disable-pip-version-check"]
    try:
        if not Path(python).exists():
            venv.create(folder, with_pip=True)
        exact = oldest(given.extras)
        subprocess.run([*pip, "install", "--quiet", *exact, *BESIDE, *TOOLS], check=True)
        subprocess.run([*pip, "freeze"], check=True)
        tests = [python, "-P", "-m", "pytest", "-q", "-m", "not slow", "-p", "no:cacheprovider"]
        # Old libraries warn of changes in newer ones.
        quiet = ["-W", "ignore::DeprecationWarning", "-W", "ignore::FutureWarning"]
        # Tests with other programs' readers of maps, which are not among the extras.
        without = [f"--ignore=tests/store/test_{name}.py" for name in ("openpmd", "xarray")]
        # The schema files have the text of the newest pydantic.
        without.append(
            "--deselect=tests/device/test_json_schema.py::test_the_schema_file_is_in_step_with_the_reader"
        )
        return subprocess.run([*tests, *quiet, *without, *given.tests], cwd=ROOT, env=clean).returncode
    finally:
        if given.folder is None:
            shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main())
