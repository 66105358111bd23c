"""The readers on the page of file formats read the program's files without it; the page lists all of them."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fieldmap.dynamics.loop_run import recorded
from fieldmap.dynamics.scenario.batches import simulate_batches, write_simulation
from fieldmap.interop import write_c_map
from fieldmap.lookup import open_map, unit_block
from fieldmap.store import read_map, read_runs

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "file_formats.md").read_text()
PROGRAMS = {
    name: code
    for code in re.findall(r"^```(?:python|c)\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
    for name in re.findall(r"\A(?:# |/\* )(\w+\.\w+):", code)
}
LONGEST = 40


def hdf5_flags() -> list[str]:
    """Compiler flags for the HDF5 library; skips if it is not installed."""
    if shutil.which("gcc") is None or shutil.which("pkg-config") is None:
        pytest.skip("no gcc or pkg-config on this machine")
    found = subprocess.run(
        ["pkg-config", "--cflags", "--libs", "hdf5"], capture_output=True, text=True, check=False
    )
    if found.returncode:
        pytest.skip("no development files of HDF5 (libhdf5-dev) on this machine")
    return found.stdout.split()


@pytest.fixture
def run(tmp_path):
    """run(program, *arguments): the words printed by a program of the page."""

    def printed(name: str, *arguments: object) -> str:
        source = tmp_path / name
        source.write_text(PROGRAMS[name])
        command = [sys.executable, "-I", str(source)]
        if source.suffix == ".c":
            flags = hdf5_flags() if "hdf5.h" in PROGRAMS[name] else []
            if shutil.which("gcc") is None:
                pytest.skip("no gcc on this machine")
            program = tmp_path / source.stem
            strict = ["-std=c11", "-Wall", "-Wextra", "-Werror", "-pedantic"]
            subprocess.run(["gcc", *strict, str(source), "-o", str(program), *flags], check=True)
            command = [str(program)]
        done = subprocess.run([*command, *map(str, arguments)], capture_output=True, text=True, check=True)
        return done.stdout

    return printed


@pytest.fixture(scope="module")
def run_file(six_coils, tmp_path_factory):
    """Two recorded runs of a simulation, as `fieldmap simulate --runs 2 -o run.h5` writes them."""
    folder = tmp_path_factory.mktemp("runs")
    scenario = folder / "step.toml"
    text = (ROOT / "tests" / "scenarios" / "step.toml").read_text().replace("six.h5", str(six_coils))
    scenario.write_text(text.replace("duration_s = 1.0", "duration_s = 0.3"))
    return write_simulation(folder / "run.h5", simulate_batches(scenario, runs=2, keep_signals=True))


def test_the_programs_are_short():
    assert sorted(PROGRAMS) == [
        "read_fmap.c", "read_map.c", "read_map.py", "read_run.c", "read_run.py", "read_study.py",
    ]  # fmt: skip
    assert {
        name: len(code.splitlines()) for name, code in PROGRAMS.items() if code.count("\n") > LONGEST
    } == {}
    assert all(
        "fieldmap" not in re.findall(r"^(?:import|from) (\w+)", code, re.M) for code in PROGRAMS.values()
    )


def test_python_reads_a_map(run, six_coils):
    data = read_map(six_coils)
    currents = np.array([1.5, -0.5, 2.0, 0.0, 1.0, 0.25])
    node = (1, 2, 3)
    point = data.grid.lower + np.array(node) * data.grid.spacing
    expected = np.tensordot(currents, data.flux_density, 1)[node]
    words = run("read_map.py", six_coils, *point, *currents).split()
    np.testing.assert_allclose(np.array(words, float), expected, rtol=1e-12)
    np.testing.assert_allclose(np.array(words, float), open_map(six_coils).field(point, currents), rtol=1e-3)


def test_c_reads_a_map(run, six_coils):
    data = read_map(six_coils)
    words = run("read_map.c", six_coils, data.coil_names[1], 1, 2, 3, 2.5).split()
    np.testing.assert_allclose(np.array(words, float), 2.5 * data.flux_density[1][1, 2, 3], rtol=1e-15)


def test_python_reads_runs(run, run_file):
    records, _ = read_runs(run_file)
    printed = run("read_run.py", run_file)
    assert len(records) == 2
    for number, record in enumerate(records):
        assert f"run_{number:04d}" in printed
        for name, (values, unit, _) in record.arrays.items():
            assert f"  {name} {values.shape} {unit} [" in printed


def test_c_reads_runs(run, run_file):
    records, _ = read_runs(run_file)
    words = run("read_run.c", run_file, "run_0001/position").split()
    position = records[1].arrays["position"][0]
    np.testing.assert_array_equal(np.array(words, float).reshape(-1, 3), position)


def test_python_reads_a_study(run, tmp_path):
    xarray = pytest.importorskip("xarray")
    from fieldmap.studies.run import write_netcdf

    values = np.arange(6.0).reshape(2, 3)
    data = xarray.Dataset(
        {"largest_flux_density": (("radius", "currents"), values, {"units": "T"})},
        {"radius": ("radius", [8.0, 10.0], {"units": "mm"}), "currents": ("currents", ["a", "b", "c"])},
    )
    write_netcdf(data, tmp_path / "study.nc")
    lines = run("read_study.py", tmp_path / "study.nc").splitlines()
    assert "largest_flux_density ('radius', 'currents') (2, 3) T" in lines


@pytest.mark.parametrize("kind", ["harmonic", "global"])
def test_c_reads_a_map_for_c(run, six_coils, tmp_path, kind):
    field = open_map(six_coils, kind=kind)
    words = run("read_fmap.c", write_c_map(field, tmp_path / "map.fmap")).split("\n")
    assert words[: len(field.coil_names)] == [f"coil {name}" for name in field.coil_names]
    box = np.array([line.split()[1:] for line in words[6:9]], float)
    np.testing.assert_allclose(box, np.column_stack([field.lower, field.upper]), rtol=1e-12)
    block = unit_block(field)
    coefficients = np.array(words[9:-1], float)
    assert len(coefficients) == (int(block[3]) + 1) ** 2
    np.testing.assert_array_equal(coefficients, block[24 : 24 + len(coefficients)])


def test_the_page_names_all_signals_of_a_run(run_file):
    section = PAGE.split("## Runs of a simulation")[1].split("## ")[0]
    records, about = read_runs(run_file)
    assert [
        name for name in (*records[0].arrays, *records[0].about, *about) if f"`{name}`" not in section
    ] == ["value"]
    assert recorded.__module__ == "fieldmap.dynamics.loop_run"


def test_the_page_names_all_columns_of_the_numbers():
    from fieldmap.thesis.report import COLUMNS

    (row,) = re.findall(r"^\| `numbers.csv` \| .* \| (.*) \|$", PAGE, re.MULTILINE)
    assert [part.strip() for part in row.split(",")] == list(COLUMNS)


def test_the_page_has_every_file_that_a_command_writes():
    """By the endings named in the help of the commands."""
    text = (ROOT / "docs" / "commands.md").read_text()
    written = set(re.findall(r"(?:-o|--output) \S+(\.\w+)", text)) | {
        ".h5",
        ".csv",
        ".nc",
        ".npz",
        ".fmap",
        ".fmu",
    }
    assert {ending for ending in written if f"{ending}`" not in PAGE} == set()
