"""Commands on a device whose payload is a bead of soft iron below a thin loop, i = 5 A: closed forms on the axis."""

from pathlib import Path

import numpy as np
import pytest
from scipy.constants import g as gravity
from scipy.constants import mu_0

from fieldmap.cli import main

TURNS, RADIUS, MASS, DIAMETER, MU_R = 1000, 0.02, 2e-4, 4e-3, 1e6
DEVICE = f"""
format = 1
name = "bead"
title = "A bead below a loop"
[[coil]]
name = "loop"
kind = "circular"
inner_radius_mm = {1e3 * RADIUS - 0.05}
outer_radius_mm = {1e3 * RADIUS + 0.05}
height_mm = 0.1
turns = {TURNS}
position_mm = [0, 0, 0]
[payload]
mass_g = {1e3 * MASS}
[[payload.piece]]
shape = "soft_sphere"
diameter_mm = {1e3 * DIAMETER}
mu_r = {MU_R}
[workspace]
shape = "box"
lower_mm = [-6, -6, -50]
upper_mm = [6, 6, -10]
"""


def force(z, current):
    """m dBz/dz with m = 3 V Bz / mu0."""
    scale = mu_0 * TURNS * current * RADIUS**2 / 2
    flux = scale / (RADIUS**2 + z**2) ** 1.5
    slope = -3 * z * scale / (RADIUS**2 + z**2) ** 2.5
    return np.pi * DIAMETER**3 / 2 / mu_0 * flux * slope


@pytest.fixture
def bead(tmp_path):
    path = tmp_path / "bead.toml"
    path.write_text(DEVICE)
    return str(path)


def test_probe(bead, answer):
    found = answer("probe", bead, "--at", "0", "0", "-0.02", "--currents", "5", "--payload")
    assert found["force"][2] == pytest.approx(force(-0.02, 5.0), rel=1e-4)
    assert found["moment"][2] == pytest.approx(np.pi * DIAMETER**3 / 2 / mu_0 * found["B"][2], rel=1e-4)
    assert any("soft iron" in words for words in found["assumptions"])
    assert main(["probe", bead, "--at", "0", "0", "-0.02", "--currents", "5", "--payload"]) == 0


def test_equilibrium(bead, answer, capsys):
    found = answer("equilibrium", bead, "--currents", "5")
    assert force(found["position"][2], 5.0) == pytest.approx(MASS * gravity, rel=1e-4)
    lift = answer("equilibrium", bead, "--height-mm", "-25")
    assert force(-0.025, lift["lift_current"]) == pytest.approx(MASS * gravity, rel=1e-4)
    assert main(["equilibrium", bead, "--currents", "5"]) == 0
    assert "soft sphere of 4 mm" in capsys.readouterr().out
    assert main(["equilibrium", bead, "--currents", "5", "--orientation", "aligned"]) == 2


@pytest.mark.parametrize(("amperes", "told"), [("5", "coils above"), ("0", "turn the currents on")])
def test_no_balance_has_a_remedy(bead, capsys, amperes, told):
    """A loop below the box pulls soft iron down whatever the sign of its current."""
    Path(bead).write_text(DEVICE.replace("position_mm = [0, 0, 0]", "position_mm = [0, 0, -60]"))
    assert main(["equilibrium", bead, "--currents", amperes]) == 1
    remedy = capsys.readouterr().err.split("remedy")[1]
    assert told in remedy
    assert ("fieldmap currents --lift" in remedy) == (amperes != "0")
    assert "polarity" not in remedy
    assert main(["equilibrium", bead, "--height-mm", "-25"]) == 1
    assert "fieldmap currents --lift" in capsys.readouterr().err.split("remedy")[1]


def test_check_and_map(bead, capsys, tmp_path):
    assert main(["check", bead]) == 0
    assert "soft sphere of 4 mm" in capsys.readouterr().out
