"""`fieldmap study`: files, table, JSON, exit codes."""

import json
import warnings
from pathlib import Path

import pytest

from fieldmap.cli import main

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # of its own imports
    import xarray  # noqa: F401

STUDY = """
format = 1
title = "Turns of a thin loop"
device = "{device}"
vary = [{{ name = "turns", key = "coil.loop.turns", values = {values} }}]
currents = [{{ name = "carries", carries_at_mm = [0, 0, -90] }}]
record = {{ quantities = ["currents", "equilibrium", "equilibrium_area"] }}
"""


@pytest.fixture
def study(machine, tmp_path):
    path = tmp_path / "turns.toml"
    path.write_text(STUDY.format(device=machine.device, values=[500, 1000]))
    return path


def test_files_table_and_numbers(study, tmp_path, capsys):
    target = tmp_path / "out" / "turns.nc"
    assert main(["study", str(study), "-o", str(target)]) == 0
    printed = capsys.readouterr().out
    files = [target.with_suffix(suffix) for suffix in (".nc", ".csv", ".png")]
    assert all(path.is_file() and str(path) in printed for path in files)
    assert main(["study", str(study), "-o", str(target), "--json", "--no-plot"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert [Path(path).suffix for path in answer["files"]] == [".nc", ".csv"]
    few, many = answer["rows"]
    assert (few["turns"], few["currents"], few["problem"]) == (500, "carries", "")
    assert few["common_current"] == pytest.approx(2 * many["common_current"], rel=1e-9)
    assert few["equilibrium_z"] == pytest.approx(-0.09, abs=1e-9)
    assert f"{few['common_current']:.4g}" in printed


def test_exit_codes(study, machine, tmp_path, capsys):
    # A place that the currents cannot carry at: outside the workspace, in every variant.
    study.write_text(study.read_text().replace("-90]", "-900]"))
    assert main(["study", str(study), "-o", str(tmp_path / "turns.nc")]) == 1
    out = capsys.readouterr()
    assert "OutsideMapError" in out.out
    assert "OutsideMapError" in out.err
    # One document for programs: the rows say why each variant failed.
    words = ["study", str(study), "-o", str(tmp_path / "again.nc"), "--json", "--no-plot"]
    assert main(words) == 1
    out = capsys.readouterr()
    assert all("OutsideMapError" in row["problem"] for row in json.loads(out.out)["rows"])
    assert "remedy" in out.err
