"""`fieldmap currents` against closed forms: a thin loop and a dipole, a bead of soft iron, eight coils by their map."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.constants import g as gravity
from scipy.constants import mu_0

import fieldmap as fm
from fieldmap.cli import main
from fieldmap.errors import Infeasible

TURNS, RADIUS, MASS, MOMENT = 1000, 0.044, 0.010, 0.8


def flux(z):
    """Bz per ampere on the axis of the loop."""
    return mu_0 * TURNS * RADIUS**2 / (2 * (RADIUS**2 + z**2) ** 1.5)


def slope(z):
    """dBz/dz per ampere."""
    return -3 * z * flux(z) / (RADIUS**2 + z**2)


AT = ("--at", "0", "0", "-0.09")


@pytest.mark.parametrize("source", ["device", "map"])
def test_the_loop_carries_its_payload(answer, machine, source):
    found = answer("currents", getattr(machine, source), *AT, "--lift")
    expected = MASS * gravity / (MOMENT * slope(-0.09))
    assert found["by_name"] == {"loop": pytest.approx(expected, rel=1e-3)}
    assert found["sum_of_squares"] == pytest.approx(expected**2, rel=2e-3)
    assert found["force"] == pytest.approx([0, 0, MASS * gravity], abs=1e-7 * MASS * gravity)
    assert found["asked"] == {"force": [None, None, pytest.approx(MASS * gravity)]}


def test_the_loop_makes_a_flux_density(answer, machine):
    found = answer("currents", machine.device, *AT, "--field", "nan", "nan", "2e-3")
    assert found["currents"] == [pytest.approx(2e-3 / flux(-0.09), rel=2e-4)]
    assert found["asked"] == {"field": [None, None, 2e-3]}
    assert "force" not in found


def test_a_moment_of_ones_own_and_a_torque(answer, machine):
    words = ["--moment", "0.5", "0", "0", "--torque", "0", "1e-3", "0"]
    found = answer("currents", machine.device, *AT, *words)
    assert found["currents"] == [pytest.approx(-1e-3 / (0.5 * flux(-0.09)), rel=2e-4)]


def test_what_can_be_had_where_the_limit_binds(capsys, machine):
    limit = 0.25 * MASS * gravity / (MOMENT * slope(-0.09))
    assert main(["currents", machine.device, *AT, "--lift", "--limit", str(limit)]) == 1
    told = capsys.readouterr().err
    assert "coil loop at" in told
    share = float(told.split("the limits allow ")[1].split(" of the demand")[0])
    assert share == pytest.approx(0.25, rel=1e-3)
    assert main(["currents", machine.device, *AT, "--lift", "--limit", str(limit), "--json"]) == 1
    printed = capsys.readouterr()
    found = json.loads(printed.out)
    assert found["error"] == "Infeasible"
    assert found["exit_code"] == 1
    assert found["share"] == pytest.approx(share, rel=1e-4)
    assert found["reachable"] == [pytest.approx(0.25 * MASS * gravity, rel=1e-3)]
    assert found["binding"] == {"loop": pytest.approx(limit)}
    (problem,) = found["problems"]
    assert set(problem) == {"where", "must_hold", "received", "remedy"}
    # People read what they read without.
    assert printed.err.endswith(told[told.index("error") :])


def test_a_bead_of_soft_iron(answer, capsys, machine, tmp_path):
    """A sphere of mu_r = 1e6 has the moment 3 V B / mu0, so that F = 3 V / mu0 B dB/dz i^2."""
    text = Path(machine.device).read_text()
    payload = (
        '[payload]\nmass_g = 0.2\n[[payload.piece]]\nshape = "soft_sphere"\ndiameter_mm = 4\nmu_r = 1e6\n\n'
    )
    path = tmp_path / "bead.toml"
    path.write_text(re.sub(r"(?s)\[payload\].*?(?=\n\[)", payload, text))
    found = answer("currents", str(path), *AT, "--lift")
    squared = 2e-4 * gravity / (np.pi * 4e-3**3 / 2 / mu_0 * flux(-0.09) * slope(-0.09))
    assert abs(found["currents"][0]) == pytest.approx(np.sqrt(squared), rel=1e-3)
    assert main(["currents", str(path), *AT, "--lift"]) == 0
    assert "soft iron" in capsys.readouterr().out


def test_a_solved_device_has_the_currents_of_its_map(tmp_path):
    """Six coils, three rows: the least currents are those of the pseudo-inverse."""
    m, at = fm.open_map("sample"), np.array([0.002, 0.001, -0.1])
    asked = {"force": [1e-3, 0.0, 5e-3], "moment": [0.0, 0.0, 0.5]}

    class Plain:
        """The map as a field that is only known to be a sum."""

        coil_names, bounds, proportional, affine, assumptions = m.coil_names, m.bounds, True, True, ()
        field, gradient = staticmethod(m.field), staticmethod(m.gradient)

    found = fm.lookup.currents_for(Plain(), at, **asked)
    rows = 0.5 * m.unit_gradient(at)[:, 2, :].T
    np.testing.assert_allclose(found, np.linalg.pinv(rows) @ asked["force"], rtol=1e-6)
    np.testing.assert_allclose(found, m.currents_for(at, **asked), rtol=1e-6)
    with pytest.raises(Infeasible) as caught:
        fm.lookup.currents_for(Plain(), at, **asked, limits=0.5 * np.abs(found).max())
    assert 0.4 < caught.value.share < 1.0


def test_iron_that_saturates(answer, capsys):
    """The answer of --nonlinear gives what was asked for when its state is solved anew; linear iron needs less."""
    asked = [
        "currents",
        "magnet_core",
        "--at-mm",
        "0",
        "0",
        "-40",
        "--field",
        "nan",
        "nan",
        "4e-3",
        "--refinement",
        "0.5",
    ]
    linear = answer(*asked, "--mu-r", "1000", "--limit", "10")["currents"][0]
    found = answer(*asked, "--nonlinear", "--limit", "10")
    (current,) = found["currents"]
    assert found["kind"] == "device, nonlinear iron"
    assert abs(current) > 1.015 * abs(linear)
    words = ["probe", "magnet_core", "--at-mm", "0", "0", "-40", "--nonlinear", "--refinement", "0.5"]
    probed = answer(*words, "--currents", repr(current))
    assert probed["B"][2] == pytest.approx(4e-3, rel=1e-4)
    assert main([*asked, "--nonlinear", "--limit", str(0.5 * abs(current)), "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert told["error"] == "Infeasible"
    assert 0.0 < told["reachable"][0] < 4e-3
    assert list(told["binding"]) == ["1"]
    assert main([*asked, "--nonlinear", "--mu-r", "1000", "--json"]) == 2
    assert json.loads(capsys.readouterr().out)["problems"][0]["where"] == "--nonlinear"
