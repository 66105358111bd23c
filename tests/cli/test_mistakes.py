"""What a newcomer gets wrong first: one message that says what the file is, and which command takes it."""

import pytest

from fieldmap.cli import main

SCENARIO = 'format = 1\ntitle = "Held"\nmap = "a.h5"\nduration_s = 1.0\n'
STUDY = 'format = 1\ntitle = "Varied"\ndevice = "drive_unit"\n[[vary]]\nkey = "a"\nvalues = [1]\n'


@pytest.fixture
def files(machine, tmp_path):
    (tmp_path / "scenario.toml").write_text(SCENARIO)
    (tmp_path / "study.toml").write_text(STUDY)
    return {
        "device": machine.device,
        "recipe": machine.recipe,
        "map": machine.map,
        "scenario": str(tmp_path / "scenario.toml"),
        "study": str(tmp_path / "study.toml"),
    }


@pytest.mark.parametrize(
    ("command", "given", "wanted", "takes"),
    [
        ("map", "device", "recipe", "`fieldmap check`"),
        ("map", "scenario", "recipe", "`fieldmap simulate`"),
        ("check", "recipe", "device", "`fieldmap map`"),
        ("solve", "study", "device", "`fieldmap study`"),
        ("simulate", "device", "scenario", "`fieldmap check`"),
        ("linearise", "recipe", "scenario", "`fieldmap map`"),
        ("study", "recipe", "study", "`fieldmap map`"),
    ],
)
def test_a_file_of_another_kind_is_named(files, capsys, command, given, wanted, takes):
    assert main([command, files[given]]) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert f"must be a {wanted} file" in told
    assert f"a {given} file" in told
    assert takes in told
    assert "1 problem found" in told


def test_a_map_in_the_place_of_a_scenario(files, capsys):
    assert main(["simulate", files["map"]]) == 2
    assert f"--map {files['map']}" in " ".join(capsys.readouterr().err.split())


def test_a_map_in_the_place_of_a_text(files, capsys):
    assert main(["map", files["map"]]) == 2
    assert "HDF5" in capsys.readouterr().err


def test_millimetres_in_the_place_of_metres(files, capsys):
    assert main(["probe", files["map"], "--at", "0", "0", "-80", "--currents", "1"]) == 2
    assert "--at-mm" in capsys.readouterr().err
