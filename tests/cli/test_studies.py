"""`fieldmap study`, `optimise` and `fit`: files, tables, JSON, exit codes."""

import json
import re
import warnings
from pathlib import Path

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.plot.rendering import can_render
from tests.cli.thin_loop import flux
from tests.conftest import DEVICES
from tests.studies.test_design_file import GOOD

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # warnings of its own imports
    import xarray  # noqa: F401


@pytest.fixture
def study(machine, tmp_path):
    """Two numbers of turns for the thin loop, with the current that carries the payload 90 mm below it."""
    text = (Path(__file__).parent / "files" / "turns.toml").read_text().split("[[currents]]")
    path = tmp_path / "turns.toml"
    path.write_text("[[currents]]".join(text[:2]).replace("thin_loop.toml", machine.device))
    return path


def test_files_table_and_numbers(study, tmp_path, command, answer):
    target = tmp_path / "out" / "turns.nc"
    code, printed, _ = command("study -o", target, study)
    files = [target.with_suffix(suffix) for suffix in (".nc", ".csv", ".png")]
    assert code == 0
    assert all(path.is_file() and str(path) in printed for path in files)
    found = answer("study --no-plot -o", target, study)
    assert [Path(path).suffix for path in found["files"]] == [".nc", ".csv"]
    few, many = found["rows"]
    assert (few["turns"], few["currents"], few["problem"]) == (500, "carries low", "")
    assert few["common_current"] == pytest.approx(2 * many["common_current"], rel=1e-9)
    assert few["equilibrium_z"] == pytest.approx(-0.09, abs=1e-9)
    assert f"{few['common_current']:.4g}" in printed


def test_a_study_in_which_every_variant_fails(study, command, tmp_path):
    # Outside the workspace the payload cannot be carried, so every variant fails.
    study.write_text(study.read_text().replace("-90]", "-900]"))
    code, out, err = command("study -o", tmp_path / "turns.nc", study)
    assert code == 1
    assert "OutsideMapError" in out
    assert "OutsideMapError" in err
    # With --json one document is printed, and its rows say why each variant failed.
    code, out, err = command("study --json --no-plot -o", tmp_path / "again.nc", study)
    assert code == 1
    assert all("OutsideMapError" in row["problem"] for row in json.loads(out)["rows"])
    assert "remedy" in err


def test_a_map_of_each_variant(study, machine, tmp_path, command, answer):
    study.write_text(study.read_text().replace(machine.device, "thin_loop.toml"))
    over = Path(machine.recipe).with_name("turns.toml")
    over.write_text(study.read_text())
    index = tmp_path / "out" / "turns.nc"
    words = ("map", machine.recipe, "--over", over, "-o", index)
    code, printed, _ = command("", *words, "--part", "1/2")
    assert (code, printed, index.exists()) == (0, "", False)
    found = answer("", *words)
    assert (found["maps"], found["failed"]) == (2, {})
    assert [Path(path).suffix for path in found["files"]] == [".nc", ".csv"]
    fields = [
        fm.open_map(tmp_path / "out" / "turns" / f"{k}.h5").field([0.0, 0.0, -0.09], [1.0]) for k in (1, 2)
    ]
    np.testing.assert_allclose(fields[1], 2.0 * fields[0], rtol=1e-6)
    assert fields[0][2] == pytest.approx(flux(-0.09) * 500 / 1000, rel=1e-3)
    code, printed, _ = command("", *words)
    assert code == 0
    assert str(index) in printed
    for wrong in (("--part", "3/2"), ("--part", "half"), ("--summary",), ("--set", "coil.loop.turns=3")):
        assert command("", *words, *wrong)[0] == 2
    assert command("", "map", machine.recipe, "--part", "1/2")[0] == 2


def test_maps_of_variants_that_all_fail(study, machine, tmp_path, command):
    made = Path(machine.recipe)
    over = made.with_name("turns.toml")
    over.write_text(study.read_text().replace(machine.device, "thin_loop.toml"))
    # Too few nodes in every variant.
    recipe = made.with_name("wide.toml")
    recipe.write_text(re.sub(r"spacing_mm = .*", "spacing_mm = 1000.0", made.read_text()))
    code, out, _ = command("", "map", recipe, "--over", over, "-o", tmp_path / "turns.nc")
    assert (code, "nan" in out) == (1, False)
    assert out.count("nodes along each axis") == 2


@pytest.fixture
def best(tmp_path):
    """Path of a study file with [optimise]; its device is in the same folder."""
    (tmp_path / "thin_loop.toml").write_text((DEVICES / "thin_loop_with_driver.toml").read_text())
    (tmp_path / "best.toml").write_text(GOOD.replace('method = "trust-constr"', ""))
    return tmp_path / "best.toml"


@pytest.mark.usefixtures("unsmoothed")
def test_the_best_design(best, tmp_path, command, answer):
    target = tmp_path / "best.nc"
    code, printed, _ = command("optimise -o", target, best)
    assert code == 0
    for part in (
        "coil.loop.inner_radius_mm",
        "gradient 1 z z",
        "<= 2",
        "holds, active",
        "exact: all",
        "best.csv",
    ):
        assert part in printed
    assert target.is_file()
    assert (tmp_path / "best.png").is_file()
    assert (tmp_path / "best_device.png").is_file() == can_render()
    told = answer("optimise --no-plot -o", target, best)
    assert told["solves"] == 0
    assert told["kept"] == len(told["path"]) > 3
    assert told["values"]["current.loop"] == pytest.approx(2.0, rel=1e-5)


def test_limits_that_cannot_hold(best, tmp_path, command):
    assert command("study", best)[0] == 2
    best.write_text(best.read_text().replace("upper = 2.0", "upper = 0.1"))
    code, _, err = command("optimise -o", tmp_path / "best.nc", best)
    assert (code, "common_current" in err) == (1, True)


KEY = "coil.loop.position_mm.3"
HEIGHT_MM = 1.5


def on_axis(z_mm):
    """B, mT, of the loop at HEIGHT_MM, 2 A."""
    return 2e3 * flux(1e-3 * (z_mm - HEIGHT_MM))


@pytest.fixture
def fit_file(tmp_path):
    (tmp_path / "thin_loop.toml").write_text((DEVICES / "thin_loop.toml").read_text())
    tables = ""
    for name, use, heights in (("near", "fit", [-70, -80]), ("far", "predict", [-110])):
        tables += f"""
[[flux_density]]
name = "{name}"
use = "{use}"
components = ["z"]
currents_A = 2.0
points_mm = {[[0, 0, z] for z in heights]}
measured_mT = {[[float(on_axis(z))] for z in heights]}
deviation_mT = 0.01
"""
    path = tmp_path / "height.toml"
    path.write_text(f"""format = 1
title = "Where the loop hangs"
device = "thin_loop.toml"
unknown = [{{ key = "{KEY}", start = 0.0, lower = -5.0, upper = 5.0 }}]
{tables}""")
    return path


def test_values_are_printed_and_the_device_is_written(fit_file, command, tmp_path):
    target = tmp_path / "out" / "fitted.toml"
    code, out, err = command("fit", fit_file, "-o", target)
    assert code == 0
    assert KEY in err
    written = fm.read_device(target).coils[0].placement.position[2]
    assert 1e3 * written == pytest.approx(HEIGHT_MM, abs=0.01)
    assert f"{1e3 * written:.6g}" in out
    rows = [line.split() for line in out.splitlines()]
    at_70 = next(row for row in rows if row[:2] == ["Bz", "at"] and "-70)" in row)
    measured, computed, _, before = map(float, at_70[-4:])
    assert measured == pytest.approx(on_axis(-70), rel=1e-4)
    assert computed == pytest.approx(measured, rel=1e-4)
    assert before != pytest.approx(measured, rel=0.01)
    assert str(target) in out.replace("\n", "")


def test_a_fit_as_json(fit_file, answer):
    found = answer("fit", fit_file)
    assert found["values"][KEY] == pytest.approx(HEIGHT_MM, abs=0.01)
    near, far = found["tables"]
    assert (near["used"], far["used"]) == (True, False)
    np.testing.assert_allclose(far["after"], [1e-3 * on_axis(-110)], rtol=1e-3)
    assert Path(found["file"]) == fit_file


def test_files_that_a_fit_does_not_write(fit_file, tmp_path, command):
    before = fit_file.read_text()
    for name in ("fitted.h5", "height.toml", "thin_loop.toml"):
        assert command("fit", fit_file, "-o", tmp_path / name)[0] == 2
        assert fit_file.read_text() == before
    code, _, err = command("study", fit_file)
    assert (code, "`fieldmap fit` takes it" in " ".join(err.split())) == (2, True)
    fit_file.write_text(before.replace(KEY, "coil.loop.position_mm.4"))
    code, _, err = command("fit", fit_file)
    assert (code, "unknown.1.key" in err) == (2, True)
