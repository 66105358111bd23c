"""`fieldmap solve`: forces, sections, `--tolerance` and `--design`, against closed forms and each other."""

import numpy as np
import pytest

import fieldmap as fm
from tests.conftest import DEVICES


def test_what_a_designer_asks_for(answer):
    line = "solve loop_and_sphere --currents 2 --refinement 0.5 --design --thermal-resistance 3"
    found = answer(line)
    device = fm.read_device("loop_and_sphere")
    assert [one["coil"] for one in found["windings"]] == list(device.coil_names)
    for one in found["windings"]:
        assert one["current"] == 2.0
        assert one["power"] == pytest.approx(4.0 * one["resistance"])
        assert one["temperature_rise"] == pytest.approx(3.0 * one["power"])
        assert one["time_constant"] == pytest.approx(one["inductance"] / one["resistance"])
    assert found["power"] == pytest.approx(sum(one["power"] for one in found["windings"]))
    whole = [part["force"] for part in (*found["coil_forces"], *found["iron_forces"])]
    # Action equals reaction.
    assert sum(force[2] for force in whole) == pytest.approx(0.0, abs=0.05 * max(abs(f[2]) for f in whole))


TABLE = DEVICES / "ball_and_slabs.toml"


@pytest.mark.parametrize("iron", ["", "--nonlinear"], ids=["linear", "state"])
def test_forces_and_sections(answer, iron):
    line = f"solve --currents 2 {iron}"
    found = answer(f"{line} --force ball --force 'lid, slab' --force loop", TABLE)
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
    assert all(0 < one["error"] < 0.3 * abs(one["flux"]) for one in (equator, joint))
    assert (equator["flux_density"] > 0) != (joint["flux_density"] > 0)
    for text, shown in (("--section joint", ["joint"]), ("", ["equator", "joint"])):
        rows = answer(f"{line} {text}", TABLE)["sections"]
        assert [row["section"] for row in rows] == shown


def test_tolerance_refines(answer):
    found = answer("solve loop_and_sphere --tolerance 2e-2")
    assert found["report"]["error"]["flux_density"] < 2e-2
    assert all(abs(row["deviation"]) < 2e-2 for row in found["references"] if row["quantity"] == "Bz")


def test_bodies_that_touch_are_named_in_the_error(command):
    code, _, err = command("solve --force lid", TABLE)
    assert (code, "'lid', 'slab'" in err) == (2, True)


def test_a_barrier_in_a_state_is_told_in_the_words_of_the_command_line(command, tmp_path):
    path = tmp_path / "barrier.toml"
    text = TABLE.read_text().replace('name = "slab"\nmaterial = "iron"', 'name = "slab"\nmaterial = "wall"')
    path.write_text(text + '\n[material.wall]\nkind = "flux_barrier"\n')
    code, _, err = command("solve --nonlinear --currents 1", path)
    assert (code, "--nonlinear" in err, "body 'slab'" in err) == (2, True, True)
