"""`fieldmap currents` against closed forms: a thin loop and a dipole, a bead of soft iron, eight coils from a map."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.constants import mu_0

import fieldmap as fm
from fieldmap.errors import Infeasible
from tests.cli.thin_loop import MASS, MOMENT, flux, gravity, lift_current, slope

LINE = "currents --at 0 0 -0.09"


@pytest.mark.parametrize("source", ["device", "map"])
def test_the_loop_carries_its_payload(answer, machine, source):
    found = answer(LINE, "--lift", getattr(machine, source))
    expected = lift_current(-0.09)
    assert found["by_name"] == {"loop": pytest.approx(expected, rel=1e-3)}
    assert found["sum_of_squares"] == pytest.approx(expected**2, rel=2e-3)
    assert found["force"] == pytest.approx([0, 0, MASS * gravity], abs=1e-7 * MASS * gravity)
    assert found["asked"] == {"force": [None, None, pytest.approx(MASS * gravity)]}


def test_the_loop_makes_a_flux_density(answer, machine):
    found = answer(f"{LINE} --field nan nan 2e-3", machine.device)
    assert found["currents"] == [pytest.approx(2e-3 / flux(-0.09), rel=2e-4)]
    assert found["asked"] == {"field": [None, None, 2e-3]}
    assert "force" not in found


def test_a_moment_of_ones_own_and_a_torque(answer, machine):
    found = answer(f"{LINE} --moment 0.5 0 0 --torque 0 1e-3 0", machine.device)
    assert found["currents"] == [pytest.approx(-1e-3 / (0.5 * flux(-0.09)), rel=2e-4)]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_magnet_that_follows_the_field(answer, command, machine, sign):
    """The loop attracts it at either sign; a magnet that is repelled would turn over."""
    way = f"--direction=0,0,{2 * sign:g} --moment={MOMENT}"
    found = answer(f"{LINE} {way} --force nan nan {MASS * gravity}", machine.device)
    assert found["currents"] == [pytest.approx(sign * lift_current(-0.09), rel=1e-3)]
    assert found["moment"] == pytest.approx([0.0, 0.0, sign * MOMENT], abs=1e-7)
    assert (found["asked"]["direction"], found["held"]) == (
        [0, 0, 2 * sign],
        "moment along the field, free to turn",
    )
    held = answer(f"{LINE} {way} --least-field 2e-3", machine.device)
    assert held["currents"] == [pytest.approx(sign * 2e-3 / flux(-0.09), rel=2e-4)]
    code, _, told = command(f"{LINE} {way} --force nan nan {-MASS * gravity}", machine.device)
    assert (code, "least_field" in told) == (1, True)


def test_what_can_be_had_where_the_limit_binds(command, answer, machine):
    words = (f"{LINE} --lift --limit", 0.25 * lift_current(-0.09), machine.device)
    code, _, told = command(*words)
    assert code == 1
    assert "coil loop at" in told
    share = float(told.split("the limits allow ")[1].split(" of the demand")[0])
    assert share == pytest.approx(0.25, rel=1e-3)
    found = answer(*words, ends=1)
    assert (found["error"], found["exit_code"]) == ("Infeasible", 1)
    assert found["share"] == pytest.approx(share, rel=1e-4)
    assert found["reachable"] == [pytest.approx(0.25 * MASS * gravity, rel=1e-3)]
    assert found["binding"] == {"loop": pytest.approx(words[1])}
    (problem,) = found["problems"]
    assert set(problem) == {"where", "must_hold", "received", "remedy"}


def test_a_bead_of_soft_iron(answer, machine, tmp_path):
    """A sphere of mu_r = 1e6 has the moment 3 V B / mu0, so that F = 3 V / mu0 B dB/dz i^2."""
    payload = (
        '[payload]\nmass_g = 0.2\n[[payload.piece]]\nshape = "soft_sphere"\ndiameter_mm = 4\nmu_r = 1e6\n\n'
    )
    path = tmp_path / "bead.toml"
    path.write_text(re.sub(r"(?s)\[payload\].*?(?=\n\[)", payload, Path(machine.device).read_text()))
    found = answer(LINE, "--lift", path)
    squared = 2e-4 * gravity / (np.pi * 4e-3**3 / 2 / mu_0 * flux(-0.09) * slope(-0.09))
    assert abs(found["currents"][0]) == pytest.approx(np.sqrt(squared), rel=1e-3)
    assert any("soft iron" in words for words in found["assumptions"])


def test_a_solved_device_has_the_currents_of_its_map(tmp_path):
    """Six coils, three rows: the least currents are those of the pseudo-inverse."""
    m, at = fm.open_map("sample"), np.array([0.002, 0.001, -0.1])
    asked = {"force": [1e-3, 0.0, 5e-3], "moment": [0.0, 0.0, 0.5]}

    class Plain:
        """The map as a field known only as a weighted sum."""

        coil_names, bounds, proportional, affine, assumptions = m.coil_names, m.bounds, True, True, ()
        field, gradient = staticmethod(m.field), staticmethod(m.gradient)

    found = fm.lookup.currents_for(Plain(), at, **asked)
    rows = 0.5 * m.unit_gradient(at)[:, 2, :].T
    np.testing.assert_allclose(found, np.linalg.pinv(rows) @ asked["force"], rtol=1e-6)
    np.testing.assert_allclose(found, m.currents_for(at, **asked), rtol=1e-6)
    with pytest.raises(Infeasible) as caught:
        fm.lookup.currents_for(Plain(), at, **asked, limits=0.5 * np.abs(found).max())
    assert 0.4 < caught.value.share < 1.0


def test_iron_that_saturates(answer):
    """The currents of --nonlinear give the field when their state is solved anew; linear iron needs less current."""
    there = "magnet_core --at-mm 0 0 -40 --refinement 0.5"
    asked = f"currents {there} --field nan nan 4e-3"
    linear = answer(f"{asked} --mu-r 1000 --limit 10")["currents"][0]
    found = answer(f"{asked} --nonlinear --limit 10")
    (current,) = found["currents"]
    assert found["kind"] == "device, nonlinear iron"
    assert abs(current) > 1.015 * abs(linear)
    probed = answer(f"probe {there} --nonlinear --currents", current)
    assert probed["B"][2] == pytest.approx(4e-3, rel=1e-4)
    told = answer(f"{asked} --nonlinear --limit", 0.5 * abs(current), ends=1)
    assert told["error"] == "Infeasible"
    assert 0.0 < told["reachable"][0] < 4e-3
    assert list(told["binding"]) == ["1"]


def test_lift_of_a_payload_that_may_turn(answer, tmp_path):
    """Six coils on a ring at two heights: the field is along the moment, and its gradient carries the payload."""
    ring = "".join(
        f'[[coil]]\nname = "{k}"\nkind = "circular"\ninner_radius_mm = 8\nouter_radius_mm = 12\nheight_mm = 10\n'
        f"turns = 200\nposition_mm = [{30 * np.cos(k)}, {30 * np.sin(k)}, {10 * (k % 2)}]\n\n"
        for k in range(6)
    )
    text = 'format = 1\nname = "six"\ntitle = "six"\n\n{}[payload]\nmass_g = 1\nmoment_A_m2 = 0.1\n{}\n'
    path, forces = tmp_path / "six.toml", []
    for words in ('direction = "down"\nturning = "free"', 'direction = "down"'):
        path.write_text(text.format(ring, words))
        found = answer(
            "currents --at-mm 3 2 -20 --lift --least-field 1e-3"
            if "free" in words
            else "currents --at-mm 3 2 -20 --lift",
            str(path),
        )
        forces.append(found["force"])
        assert found["force"] == pytest.approx([0, 0, 1e-3 * gravity], abs=1e-9)
        assert found["moment"] == pytest.approx([0, 0, -0.1], abs=1e-9)
        flux_density = np.array(found["B"])
        along = -flux_density[2] / np.linalg.norm(flux_density)
        assert (along == pytest.approx(1.0, abs=1e-9)) == ("free" in words)
        if "free" in words:
            assert flux_density[2] <= -1e-3 * (1 - 1e-9)
