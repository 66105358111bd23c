"""`fieldmap solve --design`: windings, inductances and forces, in numbers."""

import json

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
