"""`fieldmap export` and `fieldmap import`: the files written, compared with the Python functions."""

import json
import shutil
from zipfile import ZipFile

import numpy as np
import pytest

from fieldmap.core.headers import in_one
from fieldmap.device import read_device
from fieldmap.dynamics import body_of_payload
from fieldmap.interop import (
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


@pytest.fixture
def exported(command, machine, tmp_path):
    """exported(name, line): stdout of `fieldmap export LINE` of the thin loop's map, written to this name."""

    def export(name, line, source=machine.map):
        code, out, err = command(f"export --to {line} -o", tmp_path / name, source)
        assert code == 0, err
        return out

    return export


@pytest.mark.parametrize(
    ("line", "header"), [("c", "fieldmap.h"), ("c32 --kind global --outside clamp", "fieldmap32.h")]
)
def test_a_map_for_c_and_its_header(exported, machine, tmp_path, line, header):
    name = "loop.fmap" if line == "c" else "loop.h"
    target, again = tmp_path / name, tmp_path / "again" / name
    assert exported(name, line).split() == [str(target), str(tmp_path / header)]
    assert (tmp_path / header).read_text() == in_one(header)
    if line == "c":
        write_c_map(open_map(machine.map, outside="nan"), again)
    else:
        write_c32_files(open_map(machine.map, "global", "clamp"), again)
    assert target.read_bytes() == again.read_bytes()


def test_fixed_currents_scale_the_coefficients(exported, tmp_path):
    for current in (1, 2):
        exported(f"{current}.fmap", f"c --kind global --currents {current}")
    unit, double = (
        np.frombuffer((tmp_path / f"{current}.fmap").read_bytes()[56 + 24 * 8 :]) for current in (1, 2)
    )
    assert unit.size == 17**2
    np.testing.assert_allclose(double, 2 * unit, rtol=1e-12)


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc on this machine")
def test_units_of_fmi(exported, machine, tmp_path):
    one, other = tmp_path / "loop.fmu", tmp_path / "body.fmu"
    exported(one.name, "fmu --moment 0.5")
    told = exported(other.name, "fmu --fmi 3 --body drive_unit --sources --json")
    assert json.loads(told)["written"] == [str(other)]
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


def test_for_mag_manip(exported, machine, tmp_path):
    target, opened = tmp_path / "loop.yaml", open_map(machine.map)
    exported("loop.yaml", "mag-manip")
    first = target.read_text().splitlines()[0]
    assert (first[0], first.split(": ")[1]) == ("#", "loop")
    assert write_mag_manip(opened, tmp_path / "same.yaml").read_bytes() == target.read_bytes()
    said = json.loads(exported("loop.yaml", "mag-manip --currents 2 --spacing-mm 5 --json"))
    assert said["written"] == [str(target)]
    assert said["nodes"] == [max(sample_grid(opened, 5e-3).shape)] * 3
    same = write_mag_manip(opened, tmp_path / "same.yaml", 5e-3, [2.0])
    assert same.read_bytes() == target.read_bytes()


WRITERS = {"csv": write_csv, "vti": write_vti}


@pytest.mark.parametrize(("to", "currents"), [("csv", None), ("csv", [2.0]), ("vti", [2.0])])
def test_tables_and_pictures(exported, machine, tmp_path, to, currents):
    """The command writes the same file as the function."""
    target = tmp_path / f"loop.{to}"
    assert exported(target.name, to if currents is None else f"{to} --currents 2").split() == [str(target)]
    same = WRITERS[to](open_map(machine.map), tmp_path / f"same.{to}", currents)
    assert same.read_bytes() == target.read_bytes()


@pytest.mark.parametrize("to", ["csv", "vti"])
def test_the_field_of_a_device(exported, machine, tmp_path, to):
    """The file equals the function's for the solution, on nodes that divide the box around the workspace."""
    target = tmp_path / f"loop.{to}"
    exported(target.name, f"{to} --spacing-mm 10 --currents 2", machine.device)
    solved = open_field(machine.device)
    same = WRITERS[to](solved, tmp_path / f"same.{to}", [2.0], spacing=0.010, device="thin_loop")
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
    rows = np.column_stack([1e3 * points, np.full(300, 2.0), 1e6 * flux])
    path = tmp_path / "readings.csv"
    head = "x_mm,y_mm,z_mm,I_loop_A,Bx_uT,By_uT,Bz_uT"
    np.savetxt(path, rows, fmt="%.17g", delimiter=",", header=head, comments="")
    return path


def test_a_table_becomes_a_map(command, readings, tmp_path):
    target = tmp_path / "measured.h5"
    assert command("import --spacing-mm 4 -o", target, readings)[0] == 0
    opened = open_map(target)
    np.testing.assert_allclose(opened.gradient([0.002, 0.001, -0.003], [1.5]), 1.5 * GRADIENT, atol=2e-3)
    assert (opened.upper - opened.lower).max() / (np.array(opened.info.grid.shape) - 1).max() < 0.004
    assert command("check", target)[0] == command("info", target)[0] == 0


def test_json_has_the_residual_in_tesla(answer, readings, tmp_path):
    found = answer("import --degree 2 -o", tmp_path / "m.h5", readings)
    assert found["coils"] == ["loop"]
    assert found["report"]["degree"] == 2
    assert found["report"]["residual"] == pytest.approx(NOISE, rel=0.1)
    assert found["report"]["standard_error"]["flux_density"] < NOISE


def test_a_constant_current_and_a_unit_are_given_beside_the_table(answer, command, readings, tmp_path):
    """The same readings with a column less and one unit less, given as options, and with a column more."""
    whole = answer("import --degree 2 -o", tmp_path / "whole.h5", readings)
    rows = np.loadtxt(readings, delimiter=",", skiprows=1)
    rows[:, 3] = np.arange(300)
    bare = tmp_path / "bare.csv"
    np.savetxt(bare, rows, delimiter=";", header="x;y_mm;z_mm;No.;Bx_uT;By_uT;Bz_uT", comments="")
    found = answer(f"import {bare} --degree 2 --currents loop=2 --unit x=mm -o", tmp_path / "bare.h5")
    assert whole["unread"] == []
    assert found["unread"] == ["No."]
    assert found["report"]["residual"] == pytest.approx(whole["report"]["residual"], rel=1e-9)
    code, _, errors = command("import --currents loop=two --unit x -o", tmp_path / "no.h5", bare)
    assert code == 2
    assert [line.split()[-1] for line in errors.splitlines() if line.startswith("error")] == [
        "--unit",
        "--currents",
    ]
    assert not (tmp_path / "no.h5").exists()
