"""Saturating iron on the command line, against the exact sphere in a uniform field and against proportion."""

import json
import re

import numpy as np
import pytest
from scipy.constants import g as gravity
from scipy.constants import mu_0

from fieldmap.cli import main

# A small iron ball on the axis of a wide thin loop, at its centre: the field of the loop is uniform to
# 1.5 (radius of the ball / radius of the loop)^2 = 1.3e-3 over the ball.
LOOP, BALL, TURNS = 0.1, 0.003, 10000
# The B-H curve: straight to the half of these, bent up to these, slope mu0 beyond.
KNEE_H, KNEE_B = 500.0, 1.2

DEVICE = f"""
format = 1
name = "ball"
title = "A ball that saturates, in a loop"

[material.steel]
kind = "bh_table"
H_A_per_m = [{KNEE_H / 2}, {KNEE_H}]
B_T = [{KNEE_B / 2}, {KNEE_B}]
below = "straight line to the origin"
above = "slope mu0"

[[body]]
name = "ball"
material = "steel"
shape = "sphere"
radius_mm = {1e3 * BALL}
mesh_size_mm = 1.0
position_mm = [0.0, 0.0, 0.0]

[[coil]]
name = "loop"
kind = "circular"
inner_radius_mm = 99.5
outer_radius_mm = 100.5
height_mm = 1.0
turns = {TURNS}
position_mm = [0.0, 0.0, 0.0]

[payload]
mass_g = 0.2
moment_A_m2 = 0.01

[workspace]
shape = "box"
lower_mm = [-1.0, -1.0, -8.0]
upper_mm = [1.0, 1.0, -4.5]

[[reference]]
quantity = "Bz"
at_mm = [0.0, 0.0, -6.0]
currents_A = [1.0]
value_T = 1.0
source = "a value to be compared at its own currents only"

[[reference]]
quantity = "Bz"
at_mm = [0.0, 0.0, -6.0]
currents_A = [1.0]
mu_r = 7.0
value_T = 1.0
source = "a value for linear iron"
"""


def loop(z):
    """Flux density of the loop on its axis per ampere, T."""
    return mu_0 * TURNS * LOOP**2 / 2 / (LOOP**2 + z**2) ** 1.5


def loop_slope(z):
    return -1.5 * mu_0 * TURNS * LOOP**2 * z / (LOOP**2 + z**2) ** 2.5


def ball_moment(current):
    """Moment of a sphere in a uniform field: H = H0 - M/3; M = chi H, or the saturated M, outside the bend; A m^2."""
    chi = KNEE_B / (mu_0 * KNEE_H) - 1
    saturation = KNEE_B / mu_0 - KNEE_H
    linear = chi / (1 + chi / 3) * loop(0.0) * current / mu_0
    assert not 0.45 < linear / saturation < 1.05
    magnetisation = min(linear, saturation)
    return magnetisation * 4 / 3 * np.pi * BALL**3


def on_axis(z, current):
    """Bz and dBz/dz on the axis: the loop's, and those of a dipole in the ball's centre."""
    dipole = mu_0 * ball_moment(current) / (2 * np.pi)
    field = current * loop(z) + dipole / abs(z) ** 3
    return field, current * loop_slope(z) + 3 * dipole / abs(z) ** 4 * -np.sign(z)


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    path = tmp_path_factory.mktemp("ball") / "ball.toml"
    path.write_text(DEVICE)
    return str(path)


@pytest.fixture(scope="module")
def heavy(tmp_path_factory):
    """The same with a payload that only a saturated ball carries at -6 mm."""
    path = tmp_path_factory.mktemp("heavy") / "ball.toml"
    path.write_text(DEVICE.replace("mass_g = 0.2", "mass_g = 60.0"))
    return str(path)


# Straight up to B = 3 B0 = 0.6 T, saturated from 3 B0 = 1.2 T on: below 3.2 A and above 6.4 A.
@pytest.mark.parametrize("current", [1.0, 20.0])
def test_solve(answer, ball, current):
    words = ["--nonlinear", "--currents", f"{current}", "--at-mm", "0 0 -6"]
    found = answer("solve", ball, *words)
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


def test_probe_and_solve_agree(answer, ball):
    words = ["--nonlinear", "--currents", "20", "--at-mm", "0.5 0 -6"]
    answered = answer("solve", ball, *words)
    solved, largest = answered["points"][0], answered["report"]["largest_flux_density"]
    probed = answer("probe", ball, *words, "--payload")
    assert probed["kind"].endswith("nonlinear iron")
    assert probed["B"] == pytest.approx(solved["B"], rel=1e-12)
    assert probed["force"] == pytest.approx([0.01 * row for row in solved["gradient"][2]], rel=1e-12)
    assert any(f"{largest:.2f} T" in text for text in probed["assumptions"])


@pytest.mark.parametrize(("device", "mass"), [("ball", 2e-4), ("heavy", 6e-2)])
def test_lift_current(capsys, request, device, mass):
    path = request.getfixturevalue(device)
    assert main(["equilibrium", path, "--nonlinear", "--height-mm", "-6", "--json"]) == 0
    told = capsys.readouterr()
    found = json.loads(told.out)
    shares = [float(share) for share in re.findall(r"([\d.]+) %", told.err) if "." in share]
    assert shares == pytest.approx([100 * s["lift"] / (mass * gravity) for s in found["states"]], abs=0.01)
    lift = 0.01 * on_axis(-0.006, found["lift_current"])[1]
    assert lift == pytest.approx(mass * gravity, rel=0.02)
    assert found["force"][2] == pytest.approx(mass * gravity, rel=1e-4)
    assert found["states"][-1] == {"current": found["lift_current"], "lift": pytest.approx(found["force"][2])}
    assert found["measured"] is None
    # Below the knee force is proportional to current; above it only the loop's own share grows.
    i = found["lift_current"]
    slope = (on_axis(-0.006, 1.001 * i)[1] - on_axis(-0.006, 0.999 * i)[1]) / (0.002 * i)
    assert found["force_per_ampere"][2] == pytest.approx(0.01 * slope, rel=0.03)


def test_equilibrium_of_a_state(answer, heavy):
    found = answer("equilibrium", heavy, "--nonlinear", "--currents", "20")
    assert found["position"][:2] == pytest.approx([0, 0], abs=1e-4)
    force = 0.01 * on_axis(found["position"][2], 20.0)[1]
    assert force == pytest.approx(6e-2 * gravity, rel=0.02)
    # Second gradients by differences over 0.1 mm, 5 mm from the ball's centre.
    assert abs(found["trace"]) < 5e-3 * np.abs(found["stiffness"]).max()


def test_known_values_hold_for_their_own_iron_and_currents(answer, ball):
    rows = answer("solve", ball, "--nonlinear", "--currents", "1")["references"]
    assert rows[0]["ours"] == pytest.approx(on_axis(-0.006, 1.0)[0], rel=5e-3)
    assert rows[1]["ours"] is None
    assert "--mu-r 7" in rows[1]["why_not"]
    rows = answer("solve", ball, "--nonlinear", "--currents", "2")["references"]
    assert [row["ours"] for row in rows] == [None, None]
    assert "other currents" in rows[0]["why_not"]


def test_linear_iron_keeps_its_known_values_in_a_state(answer):
    """A sphere of constant mu_r is the same in both solvers, and its closed form holds at its currents."""
    found = answer("solve", "loop_and_sphere", "--nonlinear", "--currents", "1", "--refinement", "0.6")
    assert all(abs(row["deviation"]) < 5e-3 for row in found["references"])


def test_form_and_refinement_reach_the_solver(answer):
    coarse = answer("solve", "loop_and_sphere", "--refinement", "0.5")["report"]
    flux = answer("solve", "loop_and_sphere", "--refinement", "0.5", "--form", "flux")["report"]
    state = answer("solve", "loop_and_sphere", "--refinement", "0.5", "--nonlinear", "--currents", "1")[
        "report"
    ]
    assert (coarse["form"], flux["form"]) == ("potential", "flux")
    assert coarse["tetrahedra"] == flux["tetrahedra"] == state["tetrahedra"] < 1000
