"""Six loops on a ring above a box, whose field has a closed form, for everything that leaves or enters a map.

Also other programs in environments of their own, in the user's cache folder. With FIELDMAP_OTHER_PROGRAMS=1, as in
`make validate`, tests make the missing environments; otherwise they are skipped.
"""

import importlib
import os
import shutil
import subprocess
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.interop import fmu
from fieldmap.kernels.coils.loop import loop_flux_density_and_gradient
from fieldmap.lookup import interpolate
from fieldmap.store import Grid, MapData

STRICT = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-Wconversion", "-Wshadow"]
SCRIPTS = Path(__file__).parents[2] / "scripts"
ANGLES = np.arange(6) * np.pi / 3
CENTRES = np.stack([0.044 * np.cos(ANGLES), 0.044 * np.sin(ANGLES), np.full(6, 0.026)], axis=1)
GRID = Grid([-0.02, -0.02, -0.12], [0.005, 0.005, 0.005], (9, 9, 13))
TURNS = 1e4


def fields(points):
    """B (6, n, 3) and G (6, n, 3, 3) per ampere."""
    parts = [loop_flux_density_and_gradient(points - centre, 0.016) for centre in CENTRES]
    return tuple(TURNS * np.stack(part) for part in zip(*parts, strict=True))


@pytest.fixture(scope="session")
def ring():
    """`fields`, the data of a map of them, and that map opened."""
    flux, slope = fields(GRID.points())
    shape = (6, *GRID.shape, 3)
    data = MapData(
        GRID, tuple("123456"), np.ones(6), flux_density=flux.reshape(shape), gradient=slope.reshape(*shape, 3)
    )
    return SimpleNamespace(fields=fields, data=data, map=interpolate(data), grid=GRID)


@pytest.fixture(scope="session")
def validation():
    """A module of scripts/validation, by its name."""

    def module(name):
        with pytest.MonkeyPatch.context() as patch:
            patch.syspath_prepend(str(SCRIPTS))
            return importlib.import_module(f"validation.{name}")

    return module


@pytest.fixture(scope="session")
def usable(validation):
    """The interpreter of an `OwnEnvironment`; skips where that cannot be had."""

    def python(program):
        if not (program.is_installed() or os.environ.get("FIELDMAP_OTHER_PROGRAMS")):
            pytest.skip(f"no environment of {program.program} yet; FIELDMAP_OTHER_PROGRAMS=1 makes one")
        try:
            return program.python()
        except validation("own_environment").UnavailableError as error:
            pytest.skip(str(error))

    return python


@pytest.fixture(scope="session")
def fmpy(validation, usable):
    """Runs a task in FMPy, where fieldmap is not installed, and returns the answer's arrays."""
    program = validation("own_environment").OwnEnvironment("FMPy", ("FMPy==0.3.32", "numpy==2.4.6"))
    python = usable(program)

    def run(folder, **task):
        np.savez(folder / "task.npz", **task)
        reader = SCRIPTS / "validation" / "fmpy_reader.py"
        program.run(str(python), str(reader), str(folder / "task.npz"), str(folder / "answer.npz"))
        with np.load(folder / "answer.npz") as answer:
            return dict(answer)

    run.program, run.python = program, python
    return run


@pytest.fixture(scope="session")
def write_fmu_quickly():
    """write_fmu without optimisation by the compiler, which takes a fifth of the time for iron and drives. Other units
    of the same kind are compiled with the options of users."""

    def write(*arguments, **named):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(fmu, "_FLAGS", tuple("-O0" if flag == "-O2" else flag for flag in fmu._FLAGS))
            return fmu.write_fmu(*arguments, **named)

    return write


@pytest.fixture
def clean_under_valgrind():
    """clean(program, *arguments) checks that it reads and writes only memory of its own and frees all of it."""
    if shutil.which("valgrind") is None:
        pytest.skip("no valgrind on this machine")

    def clean(*command):
        checked = ["valgrind", "--error-exitcode=99", "--leak-check=full", *command]
        done = subprocess.run(checked, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr[-2000:]
        assert "no leaks are possible" in done.stderr

    return clean
