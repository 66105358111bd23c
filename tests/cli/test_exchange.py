"""`fieldmap export` and `fieldmap import`: what is written, beside the functions that write it."""

import json
import shutil
from zipfile import ZipFile

import numpy as np
import pytest

from fieldmap.cli import main
from fieldmap.core.headers import in_one
from fieldmap.device import read_device
from fieldmap.dynamics import body_of_payload
from fieldmap.interop import (
    c_header,
    read_measurements,
    write_c32_files,
    write_c_map,
    write_csv,
    write_fmu,
    write_mag_manip,
)
from fieldmap.interop.sampling import sample_grid
from fieldmap.io import open_field
from fieldmap.lookup import open_map
from fieldmap.plot.vti import write_vti


def test_writes_the_map_and_its_header(machine, tmp_path, capsys):
    target = tmp_path / "loop.fmap"
    assert main(["export", machine.map, "--to", "c", "-o", str(target)]) == 0
    assert capsys.readouterr().out.split() == [str(target), str(tmp_path / "fieldmap.h")]
    assert (tmp_path / "fieldmap.h").read_text() == in_one(c_header().name)
    again = write_c_map(open_map(machine.map, outside="nan"), tmp_path / "again.fmap")
    assert target.read_bytes() == again.read_bytes()


def test_fixed_currents_scale_the_coefficients(machine, tmp_path):
    paths = [tmp_path / f"{name}.fmap" for name in ("unit", "double")]
    for path, current in zip(paths, ("1", "2"), strict=True):
        arguments = ["--to", "c", "-o", str(path), "--kind", "global", "--currents", current]
        assert main(["export", machine.map, *arguments]) == 0
    unit, double = (np.frombuffer(path.read_bytes()[56 + 24 * 8 :]) for path in paths)
    assert unit.size == 17**2
    np.testing.assert_allclose(double, 2 * unit, rtol=1e-12)


def test_constants_in_single_precision(machine, tmp_path, capsys):
    target = tmp_path / "loop.h"
    arguments = ["--to", "c32", "-o", str(target), "--kind", "global", "--outside", "clamp"]
    assert main(["export", machine.map, *arguments]) == 0
    assert capsys.readouterr().out.split() == [str(target), str(tmp_path / "fieldmap32.h")]
    assert (tmp_path / "fieldmap32.h").read_text() == in_one("fieldmap32.h")
    opened = open_map(machine.map, "global", "clamp")
    (tmp_path / "again").mkdir()
    again, _ = write_c32_files(opened, tmp_path / "again" / "loop.h")
    assert target.read_bytes() == again.read_bytes()


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc on this machine")
def test_units_of_fmi(machine, tmp_path, capsys):
    one, other = tmp_path / "loop.fmu", tmp_path / "body.fmu"
    assert main(["export", machine.map, "--to", "fmu", "-o", str(one), "--moment", "0.5"]) == 0
    arguments = ["--to", "fmu", "-o", str(other), "--fmi", "3", "--body", "drive_unit", "--sources", "--json"]
    capsys.readouterr()
    assert main(["export", machine.map, *arguments]) == 0
    assert json.loads(capsys.readouterr().out)["written"] == [str(other)]
    m = open_map(machine.map, outside="nan")
    (tmp_path / "again").mkdir()
    for path, what in (
        (one, {"magnet": [0, 0, 0.5]}),
        (other, {"body": body_of_payload(read_device("drive_unit").payload), "version": 3}),
    ):
        again = write_fmu(m, tmp_path / "again" / path.name, **what, binary=False)
        with ZipFile(path) as written, ZipFile(again) as wanted:
            compiled = [name for name in written.namelist() if name.startswith("binaries/")]
            assert len(compiled) == (path == one)
            assert {*written.namelist()} - {*compiled} == {*wanted.namelist()}
            for name in wanted.namelist():
                assert written.read(name) == wanted.read(name)


def test_for_mag_manip(machine, tmp_path):
    target = tmp_path / "loop.yaml"
    assert main(["export", machine.map, "--to", "mag-manip", "-o", str(target)]) == 0
    first = target.read_text().splitlines()[0]
    assert (first[0], first.split(": ")[1]) == ("#", "loop")
    same = write_mag_manip(open_map(machine.map), tmp_path / "same.yaml")
    assert same.read_bytes() == target.read_bytes()


def test_for_mag_manip_at_fixed_currents(machine, tmp_path, capsys):
    target = tmp_path / "loop.yaml"
    arguments = ["--to", "mag-manip", "-o", str(target), "--currents", "2", "--spacing-mm", "5", "--json"]
    assert main(["export", machine.map, *arguments]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["written"] == [str(target)]
    assert said["nodes"] == [max(sample_grid(open_map(machine.map), 5e-3).shape)] * 3
    same = write_mag_manip(open_map(machine.map), tmp_path / "same.yaml", 5e-3, [2.0])
    assert same.read_bytes() == target.read_bytes()


@pytest.mark.parametrize(
    ("to", "arguments"), [("csv", []), ("csv", ["--currents", "2"]), ("vti", ["--currents", "2"])]
)
def test_tables_and_pictures(machine, tmp_path, capsys, to, arguments):
    """The command writes what the function does."""
    target = tmp_path / f"loop.{to}"
    assert main(["export", machine.map, "--to", to, "-o", str(target), *arguments]) == 0
    assert capsys.readouterr().out.split() == [str(target)]
    write = write_csv if to == "csv" else write_vti
    same = write(open_map(machine.map), tmp_path / f"same.{to}", [2.0] if arguments else None)
    assert same.read_bytes() == target.read_bytes()


@pytest.mark.parametrize("to", ["csv", "vti"])
def test_the_field_of_a_device(machine, tmp_path, to):
    """What the function writes of the solution, on nodes that divide the box around the workspace."""
    target = tmp_path / f"loop.{to}"
    arguments = ["--to", to, "-o", str(target), "--spacing-mm", "10", "--currents", "2"]
    assert main(["export", machine.device, *arguments]) == 0
    solved = open_field(machine.device)
    write = write_csv if to == "csv" else write_vti
    same = write(solved, tmp_path / f"same.{to}", [2.0], spacing=0.010, device="thin_loop")
    assert same.read_bytes() == target.read_bytes()
    grid = sample_grid(solved, 0.010)
    np.testing.assert_allclose([grid.lower, grid.upper], solved.bounds, atol=1e-15)
    assert grid.spacing.max() <= 0.010 + 1e-12
    if to == "csv":
        rows = read_measurements(target)
        np.testing.assert_array_equal(rows.flux_density, solved.field(rows.points, [2.0]))


GRADIENT, NOISE = np.diag([0.2, 0.2, -0.4]), 10e-6


@pytest.fixture
def readings(tmp_path):
    """300 readings of B = G r per ampere at 2 A, within 10 mm of the origin."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.01, 0.01, (300, 3))
    flux = 2.0 * points @ GRADIENT + NOISE * rng.standard_normal((300, 3))
    lines = ["x_mm,y_mm,z_mm,I_loop_A,Bx_uT,By_uT,Bz_uT"]
    lines += [
        ",".join(map(repr, [*row[:3], 2.0, *row[3:]]))
        for row in np.hstack([1e3 * points, 1e6 * flux]).tolist()
    ]
    path = tmp_path / "readings.csv"
    path.write_text("\n".join(lines))
    return path


def test_a_table_becomes_a_map(readings, tmp_path):
    target = tmp_path / "measured.h5"
    assert main(["import", str(readings), "-o", str(target), "--spacing-mm", "4"]) == 0
    opened = open_map(target)
    np.testing.assert_allclose(opened.gradient([0.002, 0.001, -0.003], [1.5]), 1.5 * GRADIENT, atol=2e-3)
    assert (opened.upper - opened.lower).max() / (np.array(opened.info.grid.shape) - 1).max() < 0.004
    assert main(["check", str(target)]) == 0
    assert main(["info", str(target)]) == 0


def test_json_has_the_residual_in_tesla(readings, tmp_path, capsys):
    arguments = ["import", str(readings), "-o", str(tmp_path / "m.h5"), "--degree", "2", "--json"]
    assert main(arguments) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["coils"] == ["loop"]
    assert found["report"]["degree"] == 2
    assert found["report"]["residual"] == pytest.approx(NOISE, rel=0.1)
    assert found["report"]["standard_error"]["flux_density"] < NOISE
