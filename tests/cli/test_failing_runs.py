"""Runs that fail, through the command line: the named event, the state at that moment, the data so far, exit code 1."""

import csv
import json
from functools import partial

import numpy as np
import pytest

from fieldmap.store import read_runs

# What fails, and by what: a controller that does nothing, a gust, a wall in the way.
QUIET = ("--set", "control.z.Kc=0.0", "--set", "noise.off=true", "--set", "duration_s=3.0")
GUST = "disturbance=[{{force_mN=[{}, 0.0, {}], from_s=0.1, until_s=3.0}}]"
FAILING = {
    "fell out": (*QUIET, "--set", "start.shift_mm=[0.0, 0.0, 1.0]"),
    "hit the pole": (*QUIET, "--set", "start.shift_mm=[0.0, 0.0, -1.0]"),
    "left the map": ("--set", GUST.format(40.0, 0.0), "--set", "duration_s=3.0"),
    "current saturates": (
        *("--set", GUST.format(0.0, -400.0), "--set", "duration_s=3.0"),
        *("--set", "coils.longest_saturation_s=0.03"),
    ),
    "hit the floor": (*QUIET, "--set", "start.shift_mm=[0.0, 0.0, 1.0]", "--set", "walls={floor_mm=-112.0}"),
    "hit the tube": ("--set", GUST.format(40.0, 0.0), "--set", "walls={tube_radius_mm=8.0}"),
}


def at_the_edge(name, state, currents):
    """Whether the state at the event is where the event happens; lengths in m."""
    x, y, z = state[:3]
    return {
        "fell out": z < -0.139,
        "hit the pole": z > -0.077,
        "left the map": np.hypot(x, y) > 0.0199,
        "current saturates": max(currents) > 0.8 * 3.55,
        "hit the floor": abs(z - 0.005 + 0.112) < 1e-4,  # the body ends with the magnet
        "hit the tube": abs(x - 2.1e-3) < 1e-3,
    }[name]


@pytest.fixture
def simulated(command, six_coils):
    """Runs the shipped step on a map made up, with changes: exit code, what is printed, errors."""

    return partial(command, "simulate", "vertical_step", "--map", six_coils)


@pytest.mark.parametrize("name", FAILING)
def test_a_failing_run_ends_with_its_event_and_keeps_its_data(simulated, tmp_path, name):
    file = tmp_path / "run.h5"
    code, out, err = simulated(*FAILING[name], "-o", file)
    assert code == 1, err
    (run,), about = read_runs(file)
    assert run.about["event"] == name
    state, currents, end = run.about["state"], run.about["currents"], run.about["end_s"]
    assert len(state) == 13
    assert at_the_edge(name, state, currents), (state, currents)
    time = run.arrays["time"][0]
    # One row a control period up to the event, and none after it.
    assert 10 < len(time) < 1500
    assert end - 2.1e-3 < time[-1] <= end
    assert all(len(values) == len(time) and np.isfinite(values).all() for values, *_ in run.arrays.values())
    # The last row is the state of one period before at most: that far the body moves in that time.
    travel = np.linalg.norm(run.arrays["position"][0][-1] - state[:3])
    assert travel <= 2.2e-3 * np.linalg.norm(state[3:6]) + 1e-6
    assert "step" in about["scenario"].lower()
    words = " ".join(out.split())
    assert f"{name}: 1, first at {end:.3f} s: x {round(1e3 * state[0], 2) + 0.0:.2f}" in words


def test_a_failing_run_as_a_table_and_as_numbers(simulated, tmp_path):
    file = tmp_path / "run.csv"
    code, out, _ = simulated(*FAILING["fell out"], "-o", file, "--json")
    assert code == 1
    (run,) = json.loads(out)["batches"][0]["runs"]
    assert run["event"] == "fell out"
    assert run["end_mm"][2] > 140 - 77 - 15 - 1
    assert run["end_mm_per_s"][2] > 0
    assert len(run["end_A"]) == 6
    rows = list(csv.reader(file.read_text().splitlines()))
    assert len(rows) - 1 == pytest.approx(run["end_s"] / 2e-3, abs=1.01)


def test_one_run_of_several_that_fails_is_no_failure_of_all(simulated):
    words = ("--set", "start.shift_mm=[0.0, 0.0, 1.0]", "--set", "duration_s=3.0", "--set", "reference=[]")
    code, out, _ = simulated(*words, "--vary", "control.z.Kc=0.0,0.5")
    assert code == 0
    assert "fell out: 1" in out
    assert "events none" in " ".join(out.split())
