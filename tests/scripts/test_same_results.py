"""Allowed differences of two versions: exact arrays, runs that may diverge, and runs that may not."""

import json

import h5py
import numpy as np
import pytest

ROWS = 100
PLAIN = "[control.z]\nkind = 'pid'\nlower = 0.0\nupper = 10.0\n"
CONVERTER = f"{PLAIN}[coils]\noutput_bits = 16\n"


@pytest.fixture(scope="module")
def script(program):
    return program("same_results", "dev")


def run_file(path, away=0.0, first=0, at_limit=ROWS, scenario=PLAIN, **about):
    """A made-up run of 1 s whose position is off from row `first` on, with its lift at a limit from `at_limit` on."""
    time = np.linspace(0.0, 1.0, ROWS)
    position, outputs = np.cos(np.outer(time, [1.0, 2.0, 3.0])), np.full((ROWS, 3), 5.0)
    position[first:] += away
    outputs[at_limit:, 0] = 10.0
    path.parent.mkdir(exist_ok=True)
    with h5py.File(path, "w") as file:
        file.attrs.update(format="fieldmap run 1", scenario=scenario)
        run = file.create_group("run_0000")
        run.attrs["about"] = json.dumps({"event": "", "touched": [], **about})
        # The body hardly moves: its velocity is rounding noise, and is not compared relative to its own size.
        velocity = np.full((ROWS, 3), 1e-15 + 1e-14 * (away > 0))
        for name, values in {
            "time": time,
            "position": position,
            "velocity": velocity,
            "outputs": outputs,
        }.items():
            run[name] = values
    return path


def folders(tmp_path, before, after):
    run_file(tmp_path / "before" / "a.h5", **before)
    run_file(tmp_path / "after" / "a.h5", **after)
    return tmp_path / "before", tmp_path / "after"


@pytest.mark.parametrize(
    ("after", "code"),
    [
        ({}, 0),
        ({"away": 5e-10}, 0),
        ({"away": 2e-9}, 1),
        # Nothing is compared from the row on where an output is at a limit.
        ({"away": 1e-3, "first": 60, "at_limit": 50}, 0),
        ({"away": 1e-3, "first": 40, "at_limit": 50}, 1),
        # Runs that touch a wall or have a converter may diverge, but not at once; with a converter only to a bound.
        ({"away": 1e-2, "first": 50, "touched": ["floor"]}, 0),
        ({"away": 1e-5, "first": 50, "scenario": CONVERTER}, 0),
        ({"away": 1e-5, "first": 10, "scenario": CONVERTER}, 1),
        ({"away": 1e-2, "first": 50, "scenario": CONVERTER}, 1),
    ],
)
def test_runs(script, tmp_path, after, code):
    before = {name: value for name, value in after.items() if name not in ("away", "first")}
    assert script.compare(*folders(tmp_path, before, after), None) == code


def test_runs_that_end_otherwise_differ(script, tmp_path):
    assert script.compare(*folders(tmp_path, {}, {"event": "fell out"}), None) == 1
    assert script.compare(*folders(tmp_path, {}, {"touched": ["floor"]}), None) == 1


@pytest.mark.parametrize(
    ("name", "before", "after", "code"),
    [
        ("probe_a", {"B": [1.0, 1e-16]}, {"B": [1.0, 3e-16]}, 0),
        ("probe_a", {"B": [1.0]}, {"B": [1.0 + 1e-11]}, 1),
        ("probe_a", {"points": [{"B": 1.0}, {"B": 0.0}]}, {"points": [{"B": 1.0}, {"B": 1e-14}]}, 0),
        ("probe_a", {"B": [1.0]}, {"B": [1.0], "G": [1.0]}, 1),
        ("equilibrium_a", {"position": [0.0, 0.01]}, {"position": [0.0, 0.01 + 5e-10]}, 0),
        ("equilibrium_a", {"position": [0.0, 0.01]}, {"position": [0.0, 0.01 + 2e-9]}, 1),
        ("simulate_a", {"batches": [{"runs": [{"rms": 1.0}]}]}, {"batches": [{"runs": [{"rms": 2.0}]}]}, 0),
    ],
)
def test_answers(script, tmp_path, name, before, after, code):
    for folder, values in (("before", before), ("after", after)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / f"{name}.json").write_text(json.dumps(values))
    assert script.compare(tmp_path / "before", tmp_path / "after", None) == code


def test_cases_name_maps_that_are_made_before(script):
    names = [case.name for case in script.cases()]
    assert len(set(names)) == len(names) > 30
    quick = [name for name in names if script.QUICK.match(name)]
    assert {"map_quick", "simulate_hold", "export_c"} <= set(quick)
    assert not any("division" in name for name in quick)
