"""Saturating iron on the command line, against the exact sphere in a uniform field and against proportionality."""

import json
import re

import numpy as np
import pytest
from scipy.constants import g as gravity
from scipy.constants import mu_0

from tests.conftest import DEVICES

# From the device's file: radii, turns, and the end of the bend of the B-H curve.
LOOP, BALL, TURNS, KNEE_H, KNEE_B = 0.1, 0.003, 10000, 500.0, 1.2
DEVICE = DEVICES / "saturating_ball_in_loop.toml"


def loop(z):
    """Flux density of the loop on its axis per ampere, T."""
    return mu_0 * TURNS * LOOP**2 / 2 / (LOOP**2 + z**2) ** 1.5


def loop_slope(z):
    return -1.5 * mu_0 * TURNS * LOOP**2 * z / (LOOP**2 + z**2) ** 2.5


def ball_moment(current):
    """Moment, A m^2, of a sphere in a uniform field, outside the bend: H = H0 - M/3, M = chi H or the saturated M."""
    chi = KNEE_B / (mu_0 * KNEE_H) - 1
    saturation = KNEE_B / mu_0 - KNEE_H
    linear = chi / (1 + chi / 3) * loop(0.0) * current / mu_0
    assert not 0.45 < linear / saturation < 1.05
    magnetisation = min(linear, saturation)
    return magnetisation * 4 / 3 * np.pi * BALL**3


def on_axis(z, current):
    """Bz and dBz/dz on the axis: of the loop plus a dipole in the ball's centre."""
    dipole = mu_0 * ball_moment(current) / (2 * np.pi)
    field = current * loop(z) + dipole / abs(z) ** 3
    return field, current * loop_slope(z) + 3 * dipole / abs(z) ** 4 * -np.sign(z)


@pytest.fixture
def heavy(tmp_path):
    """The device with a payload that only a saturated ball carries at -6 mm."""
    path = tmp_path / "ball.toml"
    path.write_text(DEVICE.read_text().replace("mass_g = 0.2", "mass_g = 60.0"))
    return path


# The curve is straight up to B = 3 B0 = 0.6 T, below 3.2 A, and saturated from 3 B0 = 1.2 T, above 6.4 A.
@pytest.mark.parametrize("current", [1.0, 20.0])
def test_solve(answer, current):
    found = answer("solve --nonlinear --at-mm '0 0 -6' --currents", current, DEVICE)
    field, slope = on_axis(-0.006, current)
    row = found["points"][0]
    assert row["B"][2] == pytest.approx(field, rel=5e-3)
    assert row["gradient"][2][2] == pytest.approx(slope, rel=0.02)
    inside = current * loop(0.0) + 2 / 3 * mu_0 * ball_moment(current) / (4 / 3 * np.pi * BALL**3)
    (body,) = found["bodies"]
    assert body["mean"] == pytest.approx([0, 0, inside], rel=5e-3, abs=5e-3 * inside)
    assert body["mean_magnitude"] == pytest.approx(inside, rel=5e-3)
    assert body["largest_magnitude"] == pytest.approx(found["report"]["largest_flux_density"], rel=1e-9)
    report = found["report"]
    all_and_none = (report["tetrahedra"], 0)
    assert (report["beyond_table"], report["below_table"]) == (
        all_and_none if current > 6.4 else all_and_none[::-1]
    )


def test_probe_and_solve_agree(answer):
    words = ("--nonlinear --currents 20 --at-mm '0.5 0 -6'", DEVICE)
    answered = answer(f"solve {words[0]}", DEVICE)
    solved, largest = answered["points"][0], answered["report"]["largest_flux_density"]
    probed = answer(f"probe --payload {words[0]}", DEVICE)
    assert probed["kind"].endswith("nonlinear iron")
    assert probed["B"] == pytest.approx(solved["B"], rel=1e-12)
    assert probed["force"] == pytest.approx([0.01 * row for row in solved["gradient"][2]], rel=1e-12)
    assert any(f"{largest:.2f} T" in text for text in probed["assumptions"])


@pytest.mark.parametrize(("device", "mass"), [("ball", 2e-4), ("heavy", 6e-2)])
def test_lift_current(command, heavy, device, mass):
    path = heavy if device == "heavy" else DEVICE
    code, out, err = command("equilibrium --nonlinear --height-mm -6 --json", path)
    assert code == 0
    found = json.loads(out)
    shares = [float(share) for share in re.findall(r"([\d.]+) %", err) if "." in share]
    assert shares == pytest.approx([100 * s["lift"] / (mass * gravity) for s in found["states"]], abs=0.01)
    lift = 0.01 * on_axis(-0.006, found["lift_current"])[1]
    assert lift == pytest.approx(mass * gravity, rel=0.02)
    assert found["force"][2] == pytest.approx(mass * gravity, rel=1e-4)
    assert found["states"][-1] == {"current": found["lift_current"], "lift": pytest.approx(found["force"][2])}
    assert found["measured"] is None
    # Below the knee the force is proportional to the current; above it only the loop's own field grows.
    i = found["lift_current"]
    slope = (on_axis(-0.006, 1.001 * i)[1] - on_axis(-0.006, 0.999 * i)[1]) / (0.002 * i)
    assert found["force_per_ampere"][2] == pytest.approx(0.01 * slope, rel=0.03)


def test_equilibrium_of_a_state(answer, heavy):
    found = answer("equilibrium --nonlinear --currents 20", heavy)
    assert found["position"][:2] == pytest.approx([0, 0], abs=1e-4)
    force = 0.01 * on_axis(found["position"][2], 20.0)[1]
    assert force == pytest.approx(6e-2 * gravity, rel=0.02)
    # Second gradients are differences over 0.1 mm, at 5 mm from the ball's centre.
    assert abs(found["trace"]) < 5e-3 * np.abs(found["stiffness"]).max()


def test_known_values_hold_for_their_own_iron_and_currents(answer):
    rows = answer("solve --nonlinear --currents 1", DEVICE)["references"]
    assert rows[0]["ours"] == pytest.approx(on_axis(-0.006, 1.0)[0], rel=5e-3)
    assert rows[1]["ours"] is None
    assert "--mu-r 7" in rows[1]["why_not"]
    rows = answer("solve --nonlinear --currents 2", DEVICE)["references"]
    assert [row["ours"] for row in rows] == [None, None]
    assert "other currents" in rows[0]["why_not"]


def test_linear_iron_keeps_its_known_values_in_a_state(answer):
    """A sphere of constant mu_r is the same in both solvers, so its closed form holds at the given currents."""
    found = answer("solve loop_and_sphere --nonlinear --currents 1 --refinement 0.6")
    assert all(abs(row["deviation"]) < 5e-3 for row in found["references"])


def test_form_and_refinement_reach_the_solver(answer):
    line = "solve loop_and_sphere --refinement 0.5"
    coarse, flux, state = (
        answer(f"{line} {more}")["report"] for more in ("", "--form flux", "--nonlinear --currents 1")
    )
    assert (coarse["form"], flux["form"]) == ("potential", "flux")
    assert coarse["tetrahedra"] == flux["tetrahedra"] == state["tetrahedra"] < 1000
