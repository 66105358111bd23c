"""Commands on a device whose payload is a bead of soft iron below a thin loop, i = 5 A: closed forms on the axis."""

import numpy as np
import pytest
from scipy.constants import g as gravity
from scipy.constants import mu_0

from tests.conftest import DEVICES

TURNS, RADIUS, MASS, DIAMETER = 1000, 0.02, 2e-4, 4e-3
BEAD = DEVICES / "bead_below_loop.toml"


def force(z, current):
    """m dBz/dz with m = 3 V Bz / mu0."""
    scale = mu_0 * TURNS * current * RADIUS**2 / 2
    flux = scale / (RADIUS**2 + z**2) ** 1.5
    slope = -3 * z * scale / (RADIUS**2 + z**2) ** 2.5
    return np.pi * DIAMETER**3 / 2 / mu_0 * flux * slope


def test_probe(answer):
    found = answer("probe --at 0 0 -0.02 --currents 5 --payload", BEAD)
    assert found["force"][2] == pytest.approx(force(-0.02, 5.0), rel=1e-4)
    assert found["moment"][2] == pytest.approx(np.pi * DIAMETER**3 / 2 / mu_0 * found["B"][2], rel=1e-4)
    assert any("soft iron" in words for words in found["assumptions"])


def test_equilibrium(answer, command):
    found = answer("equilibrium --currents 5", BEAD)
    assert force(found["position"][2], 5.0) == pytest.approx(MASS * gravity, rel=1e-4)
    lift = answer("equilibrium --height-mm -25", BEAD)
    assert force(-0.025, lift["lift_current"]) == pytest.approx(MASS * gravity, rel=1e-4)
    for line in ("equilibrium --currents 5", "check"):
        assert "soft sphere of 4 mm" in command(line, BEAD)[1]
    assert command("equilibrium --currents 5 --orientation aligned", BEAD)[0] == 2


@pytest.mark.parametrize(("amperes", "told"), [("5", "coils above"), ("0", "turn the currents on")])
def test_no_balance_has_a_remedy(command, tmp_path, amperes, told):
    """A loop below the box attracts soft iron downward at either sign of its current."""
    path = tmp_path / "bead.toml"
    path.write_text(BEAD.read_text().replace("position_mm = [0, 0, 0]", "position_mm = [0, 0, -60]"))
    code, _, err = command("equilibrium --currents", amperes, path)
    remedy = err.split("remedy")[1]
    assert code == 1
    assert told in remedy
    assert ("fieldmap currents --lift" in remedy) == (amperes != "0")
    assert "polarity" not in remedy
    code, _, err = command("equilibrium --height-mm -25", path)
    assert (code, "fieldmap currents --lift" in err.split("remedy")[1]) == (1, True)
