"""`fieldmap fit`: what is printed and written, exit codes."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.constants import mu_0

import fieldmap as fm
from fieldmap.cli import main
from tests.conftest import DEVICES

KEY = "coil.loop.position_mm.3"
HEIGHT_MM = 1.5


def on_axis(z_mm):
    """B, mT, of the loop at HEIGHT_MM as a filament, 2 A."""
    d, radius = 1e-3 * (z_mm - HEIGHT_MM), 0.044
    return 1e3 * 0.5 * mu_0 * 2000 * radius**2 / (radius**2 + d**2) ** 1.5


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


def test_json(fit_file, command):
    code, out, _ = command("fit", fit_file, "--json")
    assert code == 0
    answer = json.loads(out)
    assert answer["values"][KEY] == pytest.approx(HEIGHT_MM, abs=0.01)
    near, far = answer["tables"]
    assert (near["used"], far["used"]) == (True, False)
    np.testing.assert_allclose(far["after"], [1e-3 * on_axis(-110)], rtol=1e-3)
    assert Path(answer["file"]) == fit_file


def test_exit_codes(fit_file, tmp_path, capsys):
    for name in ("fitted.h5", "height.toml", "thin_loop.toml"):
        before = fit_file.read_text()
        assert main(["fit", str(fit_file), "-o", str(tmp_path / name)]) == 2
        assert fit_file.read_text() == before
    assert main(["study", str(fit_file)]) == 2
    assert "`fieldmap fit` takes it" in " ".join(capsys.readouterr().err.split())
    fit_file.write_text(fit_file.read_text().replace(KEY, "coil.loop.position_mm.4"))
    assert main(["fit", str(fit_file)]) == 2
    assert "unknown.1.key" in capsys.readouterr().err
