"""`fieldmap solve`: forces, sections, `--tolerance` and `--design`, against closed forms and each other."""

import json
from pathlib import Path

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.cli import main


def test_what_a_designer_asks_for(capsys):
    arguments = ["solve", "loop_and_sphere", "--currents", "2", "--refinement", "0.5", "--design", "--json"]
    assert main([*arguments, "--thermal-resistance", "3"]) == 0
    found = json.loads(capsys.readouterr().out)
    device = fm.read_device("loop_and_sphere")
    assert [one["coil"] for one in found["windings"]] == list(device.coil_names)
    for one in found["windings"]:
        assert one["current"] == 2.0
        assert one["power"] == pytest.approx(4.0 * one["resistance"])
        assert one["temperature_rise"] == pytest.approx(3.0 * one["power"])
        assert one["time_constant"] == pytest.approx(one["inductance"] / one["resistance"])
    assert found["power"] == pytest.approx(sum(one["power"] for one in found["windings"]))
    whole = [part["force"] for part in (*found["coil_forces"], *found["iron_forces"])]
    # Action and reaction.
    assert sum(force[2] for force in whole) == pytest.approx(0.0, abs=0.05 * max(abs(f[2]) for f in whole))


DEVICES = Path(__file__).parents[1] / "devices"
DEVICE = (DEVICES / "ball_and_slabs.toml").read_text()


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    path = tmp_path_factory.mktemp("table") / "table.toml"
    path.write_text(DEVICE)
    return str(path)


@pytest.mark.parametrize("iron", [[], ["--nonlinear"]], ids=["linear", "state"])
def test_forces_and_sections(answer, table, iron):
    words = ["--force", "ball", "--force", "lid, slab", "--force", "loop", "--currents", "2"]
    found = answer("solve", table, *iron, *words)
    forces = {",".join(row["names"]): row for row in found["forces"]}
    pull = np.array(forces["ball"]["force"])
    assert pull[2] < 0
    total = sum(np.array(row["force"]) for row in forces.values())
    assert np.abs(total).max() < 5e-3 * np.abs(pull).max()
    torque = sum(np.array(row["torque"]) for row in forces.values())
    assert np.abs(torque).max() < 5e-3 * 0.01 * np.abs(pull).max()
    equator, joint = found["sections"]
    assert equator["area"] == pytest.approx(np.pi * 9e-6, rel=0.02)
    assert equator["flux"] == pytest.approx(equator["flux_density"] * equator["area"])
    assert joint["area"] == pytest.approx(8e-5)
    assert (equator["flux_density"] > 0) != (joint["flux_density"] > 0)
    for text, shown in ((["--section", "joint"], ["joint"]), ([], ["equator", "joint"])):
        rows = answer("solve", table, *iron, "--currents", "2", *text)["sections"]
        assert [row["section"] for row in rows] == shown


def test_tolerance_refines(answer):
    found = answer("solve", "loop_and_sphere", "--tolerance", "2e-2")
    assert found["report"]["error"]["flux_density"] < 2e-2
    assert all(abs(row["deviation"]) < 2e-2 for row in found["references"] if row["quantity"] == "Bz")


def test_bodies_that_touch_are_named_in_the_error(capsys, table):
    assert main(["solve", table, "--force", "lid"]) == 2
    assert "'lid', 'slab'" in capsys.readouterr().err


def test_a_barrier_in_a_state_is_told_in_the_words_of_the_command_line(capsys, tmp_path):
    path = tmp_path / "barrier.toml"
    text = DEVICE.replace('name = "slab"\nmaterial = "iron"', 'name = "slab"\nmaterial = "wall"')
    path.write_text(text + '\n[material.wall]\nkind = "flux_barrier"\n')
    assert main(["solve", str(path), "--nonlinear", "--currents", "1"]) == 2
    error = capsys.readouterr().err
    assert "--nonlinear" in error
    assert "body 'slab'" in error
