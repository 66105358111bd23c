"""`fieldmap simulate` and `fieldmap linearise`: runs, files, events, logs laid over a run."""

import csv
import json
import shlex
import sys

import numpy as np
import pytest

from fieldmap.cli.arguments import parse_settings
from fieldmap.dynamics import simulate
from fieldmap.store import read_runs


def test_a_run_is_written_and_drawn(command, answer, written, tmp_path):
    path, again = written(), simulate(written(), seed=0)
    found = answer("simulate", path, "-o", tmp_path / "run.h5", "--save", tmp_path / "run.png")
    assert found["batches"][0]["runs"][0]["event"] == ""
    assert (tmp_path / "run.png").stat().st_size > 10_000
    (run,), about = read_runs(tmp_path / "run.h5")
    np.testing.assert_array_equal(run.arrays["sensed"][0], again.sensed)
    assert run.arrays["sensed"][1] == "m"
    assert about["scenario"] == path.read_text()
    assert any("upright" in words for words in run.about["assumptions"])
    assert command("simulate", path, "-o", tmp_path / "run.csv")[0] == 0
    table = np.genfromtxt(tmp_path / "run.csv", delimiter=",", names=True)
    np.testing.assert_allclose(table["sensed_z_m"], again.sensed[:, 2], rtol=1e-8)


def test_many_runs_and_values(answer, written, tmp_path):
    line = "simulate --runs 3 --vary control.z.Kc=0.4,0.6 --set duration_s=0.5 -o"
    batches = answer(line, tmp_path / "many.h5", written())["batches"]
    assert [batch["value"] for batch in batches] == ["control.z.Kc = 0.4", "control.z.Kc = 0.6"]
    errors = {run["axes"][2]["rms_error_mm"] for batch in batches for run in batch["runs"]}
    assert len(errors) == len(read_runs(tmp_path / "many.h5")[0]) == 6


OWN = """
from fieldmap.control import FunctionController

def steady(time, measured, reference, state):
    state[0] += 1.0
    return 4.0 + 0.5 * (1e3 * (reference[2] - measured[2])), 0.0, 0.0

def late(time, measured, reference, state):
    if time > 0.02:
        raise ValueError("late")
    return 4.0, 0.0, 0.0

counted = FunctionController(steady, state=1, upper=[10.0, 1.0, 1.0])
"""


@pytest.fixture
def own(tmp_path):
    """The controller of OWN, as the value of --controller."""
    (tmp_path / "own.py").write_text(OWN)
    return f"{tmp_path / 'own.py'}:counted"


SHORT = "simulate --set duration_s=0.02"


def test_a_function_of_a_file_is_the_controller(command, written, tmp_path, own):
    code, _, err = command(SHORT, written(), "--controller", own, "-o", tmp_path / "a.h5")
    assert code == 0, err
    (run,), _ = read_runs(tmp_path / "a.h5")
    outputs, seen, wanted = (run.arrays[name][0] for name in ("outputs", "seen", "reference"))
    np.testing.assert_allclose(outputs[:, 0], 4.0 + 500.0 * (wanted[:, 2] - seen[:, 2]), rtol=1e-12)


def test_the_output_names_the_function_and_its_limits(command, answer, written, tmp_path, own):
    words = (SHORT, written(), "--controller", own)
    _, out, _ = command(*words)
    assert "steady of own.py" in " ".join(out.split("at rest")[0].split())
    assumptions = answer(*words, "-o", tmp_path / "run.h5")["assumptions"]
    (told,) = [text for text in assumptions if "controller" in text]
    assert all(part in told for part in ("steady of own.py", "(Python)", "10, 1, 1", "1 number"))
    (run,), _ = read_runs(tmp_path / "run.h5")
    assert told in run.about["assumptions"]
    assert not any("controller" in text for text in answer(*words[:2])["assumptions"])


def test_what_lies_beside_the_file_of_a_controller_is_found(command, written, tmp_path):
    (tmp_path / "beside_the_controller.py").write_text("LIFT = 4.0")
    own = "import beside_the_controller\n\ndef f(time, measured, reference, state):\n"
    (tmp_path / "own.py").write_text(f"{own}    return beside_the_controller.LIFT, 0.0, 0.0\n")
    before = list(sys.path)
    code, _, err = command(SHORT, written(), "--controller", tmp_path / "own.py:f")
    assert code == 0, err
    assert sys.path == before
    sys.modules.pop("beside_the_controller")


def test_a_run_that_does_not_settle_says_so(command, written):
    """Its magnet stays off its reference; the RMS error printed is recomputed from the samples."""
    path = written()
    half = {"control.z.Kc": 0.4, "duration_s": 0.5}
    run = simulate(path, half, seed=0)
    step = run.metrics.axes[2].step
    assert not np.isfinite(step.settling_time)
    line = "simulate --seed 0 --set control.z.Kc=0.4 --set duration_s=0.5"
    code, out, _ = command(line, path)
    assert code == 0
    after = run.time >= 0.2 + 0.75 * (run.time[-1] - 0.2) - 1e-9
    (line,) = [line for line in out.splitlines() if line.startswith("settling")]
    off = float(line.split(":")[1].split()[0])
    wanted = 1e3 * np.sqrt(np.mean((run.sensed - run.references)[after, 2] ** 2))
    assert off == pytest.approx(wanted, rel=5e-3)
    # A longer run settles.
    code, out, _ = command("simulate --seed 0 --set duration_s=20.0 --set noise.off=true", path)
    assert code == 0
    assert "settling " not in [line[:9] for line in out.splitlines()]


@pytest.mark.parametrize(
    "name", ["own.py:none", "own.py", "no.py:steady", "broken.py:f", "own.py:steady", "own.py:late"]
)
@pytest.mark.usefixtures("own")
def test_a_controller_that_fails_is_bad_input(command, written, tmp_path, name):
    (tmp_path / "broken.py").write_text("1 / 0")
    code, _, err = command("simulate", written(), "--controller", tmp_path / name)
    # `steady` writes to a state although it declares none.
    where = {"own.py:late": "own.py, line 10", "own.py:steady": "own.py, line 5"}
    assert (code, where.get(name, "--controller") in err) == (2, True)


def test_a_log_is_laid_over_the_run(command, answer, written, tmp_path):
    """A log of another run, later by 0.1 s, shifted by 20 um, with 5 um of noise, in mm and as depth."""
    path = written()
    other = simulate(path, {"duration_s": 0.6}, seed=0)
    noise = np.random.default_rng(2).normal(scale=0.005, size=len(other.time))
    depth = -1e3 * other.sensed[:, 2] - 77.0 + 0.02 + noise
    rows = np.column_stack([other.time + 7.0, depth, 1e3 * other.sensed[:, 0], other.currents[:, 2]])[::3]
    lines = [
        "t (s);depth [mm];x [mm];I_3 [A]",
        *(";".join(f"{v:.7f}".replace(".", ",") for v in row) for row in rows),
    ]
    (tmp_path / "rig.csv").write_text("\n".join(lines))
    words = ("simulate --set duration_s=0.6", path, "--measured", tmp_path / "rig.csv")
    more = (*words, "--begins", 0.0, "--seed", 0)
    found = answer(*more, "--save", tmp_path / "both.png")["log"]
    assert found["samples"] == len(rows)
    apart = found["differences"]
    assert set(apart) == {"x", "depth", "3"}
    assert apart["depth"]["mean"] == pytest.approx(0.02, abs=0.0015)
    assert apart["depth"]["rms"] == pytest.approx(np.hypot(0.02, 0.005), abs=0.001)
    assert apart["x"]["rms"] < 1e-6
    assert apart["3"]["rms"] < 1e-6
    assert apart["3"]["unit"] == "A"
    code, out, _ = command(*more)
    assert (code, "depth, mm" in out) == (0, True)
    code, _, err = command(*words)
    assert (code, "begins" in err) == (2, True)


@pytest.mark.parametrize(
    ("text", "words", "where"),
    [
        ("t (s),up (mm)\n0,1\n1,1\n", (), "rig.csv"),
        ("t (s),depth (V)\n0,1\n1,1\n", (), "column depth"),
        ("t (s),depth\n0,1\n1,1\n", (), "column depth"),
        ("t (s),depth (mm)\n0,1\n1,1\n", ("--column", "depth"), "--column"),
        ("t (s),depth (mm)\n0,1\n1,1\n", ("--column", "x=up"), "--column"),
        ("t (s),depth (mm)\n0,1\n1,1\n", ("--runs", "2"), "--measured"),
    ],
)
def test_a_log_that_does_not_fit_is_bad_input(command, written, tmp_path, text, words, where):
    (tmp_path / "rig.csv").write_text(text)
    code, _, err = command(SHORT, written(), "--measured", tmp_path / "rig.csv", *words)
    assert (code, where in err) == (2, True)


@pytest.mark.parametrize(("step", "samples"), [(0.01, 2), (0.018, 2), (0.019, 0)])
def test_a_log_needs_two_samples_within_the_run(command, written, tmp_path, step, samples):
    (tmp_path / "rig.csv").write_text(f"t (s),depth (mm)\n0,13\n{step},13\n")
    code, out, _ = command(SHORT, written(), "--measured", tmp_path / "rig.csv", "--begins=0.0", "--json")
    assert code == (0 if samples else 2)
    if samples:
        assert json.loads(out)["log"]["samples"] == samples


def test_a_log_in_the_frame_of_the_map_is_what_simulate_writes(command, answer, written, tmp_path):
    words = ("simulate --set duration_s=0.1", written())
    assert command(*words, "-o", tmp_path / "run.csv")[0] == 0
    apart = answer(*words, "--measured", tmp_path / "run.csv")["log"]["differences"]
    assert apart["depth"]["rms"] == pytest.approx(0.01, rel=0.4)
    assert apart["1"]["rms"] < 1e-8


# Event that ends a run -> options, and where the magnet is then, m. tests/dynamics/test_closed_loop.py has all events.
DOWN = "--set 'start.shift_mm=[0.0, 0.0, 1.0]'"
GUST = "--set 'disturbance=[{force_mN=[40.0, 0.0, 0.0], from_s=0.1, until_s=3.0}]'"
FAILING = {
    "fell out": (
        f"--set control.z.Kc=0.0 --set noise.off=true --set duration_s=3.0 {DOWN}",
        lambda place: place[2] < -0.139,
    ),
    "hit the tube": (
        f"{GUST} --set duration_s=3.0 --set walls={{tube_radius_mm=8.0}}",
        lambda place: abs(place[0] - 2.1e-3) < 1e-3,
    ),
}


@pytest.fixture
def simulated(command, six_coils):
    """simulated(line, *words): the shipped step on a made-up map, with changes."""
    return lambda line, *words: command(f"simulate vertical_step {line} --map", six_coils, *words)


@pytest.mark.parametrize("name", FAILING)
def test_a_failing_run_ends_with_its_event_and_keeps_its_data(simulated, tmp_path, name):
    file = tmp_path / "run.h5"
    code, out, err = simulated(FAILING[name][0], "-o", file)
    assert code == 1, err
    (run,), about = read_runs(file)
    assert run.about["event"] == name
    state, currents, end = run.about["state"], run.about["currents"], run.about["end_s"]
    assert len(state) == 13
    assert FAILING[name][1](state[:3]), state
    assert len(currents) == 6
    time = run.arrays["time"][0]
    # One row per control period up to the event, none after it.
    assert 10 < len(time) < 1500
    assert end - 2.1e-3 < time[-1] <= end
    assert all(len(values) == len(time) and np.isfinite(values).all() for values, *_ in run.arrays.values())
    # The last row is at most one period before the event, which bounds the distance to the final state.
    travel = np.linalg.norm(run.arrays["position"][0][-1] - state[:3])
    assert travel <= 2.2e-3 * np.linalg.norm(state[3:6]) + 1e-6
    assert "step" in about["scenario"].lower()
    words = " ".join(out.split())
    assert f"{name}: 1, first at {end:.3f} s: x {round(1e3 * state[0], 2) + 0.0:.2f}" in words


def test_a_failing_run_as_a_table_and_as_numbers(simulated, tmp_path):
    file = tmp_path / "run.csv"
    code, out, _ = simulated(FAILING["fell out"][0], "-o", file, "--json")
    assert code == 1
    (run,) = json.loads(out)["batches"][0]["runs"]
    assert run["event"] == "fell out"
    assert run["end_mm"][2] > 140 - 77 - 15 - 1
    assert run["end_mm_per_s"][2] > 0
    assert len(run["end_A"]) == 6
    rows = list(csv.reader(file.read_text().splitlines()))
    assert len(rows) - 1 == pytest.approx(run["end_s"] / 2e-3, abs=1.01)


def test_one_run_of_several_that_fails_is_no_failure_of_all(simulated):
    code, out, _ = simulated(f"{DOWN} --set duration_s=3.0 --set reference=[] --vary control.z.Kc=0.0,0.5")
    assert (code, "fell out: 1" in out, "events none" in " ".join(out.split())) == (0, True, True)


def test_models_are_written(command, answer, six_coils, tmp_path):
    words = ("linearise horizontal_pid --set plate.thickness_mm=1.0 --depths 9,11 --map", six_coils)
    code, _, err = command(*words, "-o", tmp_path / "linear.npz")
    assert code == 0, err
    stored = np.load(tmp_path / "linear.npz")
    assert stored["A"].shape == (2, 6, 6)
    assert stored["loop_A"].shape[0] == 2
    points = answer(*words)["points"]
    np.testing.assert_allclose([point["A"] for point in points], stored["A"])
    poles = np.linalg.eigvals(stored["A"][1])
    fastest = max(mode["pole"][0] for mode in points[1]["modes"])
    assert fastest == pytest.approx(poles.real.max())
    assert command(*words, "--set", "control.z.Kc=0.0")[0] == 1


def test_what_rounding_leaves_of_a_mode_is_printed_as_zero(command):
    # An upright magnet with one axis is turned about this axis by rounding alone.
    code, text, err = command("linearise hold --map sample --set field.scale=2")
    assert code == 0, err
    turning = [line.split() for line in text.splitlines() if "turn_z" in line]
    assert [words[-2] for words in turning] == ["0", "0"]


def test_a_machine_that_cannot_carry_its_payload_anywhere_says_so(command):
    # At the shipped map's highest place the six coils need 5.8 A, but the driver gives 3.55 A.
    code, _, err = command("simulate hold --map sample")
    told = " ".join(err.split())
    assert (code, "3.55 A" in told, "lighter payload" in told) == (1, True, True)


def pasted(text):
    """The words of a page's only line with --set, as a shell would split them."""
    (line,) = (line for line in text.splitlines() if line.startswith("--set "))
    return shlex.split(line)


def test_tune_prints_controllers_that_simulate_takes(written, command, answer):
    """The page's --set line works in a shell; unreachable margins end with exit code 1."""
    path = written()
    code, text, _ = command("tune --axis z --crossover 8 --phase-margin 40", path)
    assert code == 0
    found = answer("tune --axis z --crossover 8 --phase-margin 40", path)
    assert found["margins_alone"]["z"]["phase"] >= 40.0
    assert found["loop"]["margins"][0]["crossover"] == pytest.approx(8.0, rel=1e-3)
    assert set(found["keys"]) == {f"control.z.{name}" for name in ("Kc", "Ti_s", "Td_s", "Tf_s", "c")}
    words = pasted(text)
    assert words[::2] == ["--set"] * 5
    assert parse_settings(words[1::2]) == pytest.approx(found["keys"], rel=1e-5)
    run = answer("simulate", path, *words)["batches"][0]["runs"][0]
    assert run["event"] == ""
    told = answer("tune --axis z --crossover 1 --phase-margin 40", path, ends=1)
    assert told["problems"][0]["where"].endswith("control.z")
    assert command("tune --axis depth", path)[0] == 2


def test_tune_replaces_a_coupled_controller_by_one_table(six_coils, command, answer):
    settings = {"device": "drive_unit", "start.depth_mm": 87, "body.turning": "upright"}
    machine = ["hold", "--map", six_coils, *(f"--set={key}={value}" for key, value in settings.items())]
    divided = [f"--set=control.allocation{of}" for of in ("=lift_and_directions", "_n=1.25")]
    words = pasted(command("tune --crossover 8 --phase-margin 40", *machine, *divided)[1])
    (control,) = parse_settings(words[1::2]).values()
    assert control["allocation_n"] == 1.25
    assert {axis: control[axis]["kind"] for axis in "zxy"} == dict.fromkeys("zxy", "pid")
    assert answer("simulate", *machine, *words)["batches"][0]["runs"][0]["event"] == ""
