"""`fieldmap optimise`: table, files, JSON, exit codes, and a second run that solves nothing."""

import json

import pytest

from fieldmap.cli import main
from fieldmap.plot.rendering import can_render
from tests.conftest import DEVICES
from tests.studies.test_design_file import GOOD


@pytest.fixture
def best(tmp_path):
    """Path of a study file with [optimise], its device beside it."""
    (tmp_path / "thin_loop.toml").write_text((DEVICES / "thin_loop_with_driver.toml").read_text())
    (tmp_path / "best.toml").write_text(GOOD.replace('method = "trust-constr"', ""))
    return tmp_path / "best.toml"


@pytest.mark.usefixtures("unsmoothed")
def test_table_files_and_numbers(best, tmp_path, capsys):
    target = tmp_path / "best.nc"
    assert main(["optimise", str(best), "-o", str(target)]) == 0
    printed = capsys.readouterr().out
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
    assert main(["optimise", str(best), "-o", str(target), "--no-plot", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["solves"] == 0
    assert told["kept"] == len(told["path"]) > 3
    assert told["values"]["current.loop"] == pytest.approx(2.0, rel=1e-5)


def test_exit_codes(best, tmp_path, capsys):
    assert main(["study", str(best)]) == 2
    capsys.readouterr()
    best.write_text(best.read_text().replace("upper = 2.0", "upper = 0.1"))
    assert main(["optimise", str(best), "-o", str(tmp_path / "best.nc")]) == 1
    assert "common_current" in capsys.readouterr().err
