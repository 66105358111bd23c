"""`fieldmap identify`: known models recovered from logs, and all mistakes of a log reported at once."""

import shlex

import numpy as np
import pytest

from fieldmap.cli.arguments import parse_settings
from fieldmap.control import PID, from_roots, simulate_loop
from fieldmap.control.identification import make_log, pseudo_random_binary, write_log
from fieldmap.dynamics import linear_points, prepare, read_scenario

TS = 2e-3
POLES, ZERO, GAIN = (1.01, 0.905), 0.9935, -0.03


@pytest.fixture(scope="module")
def signals():
    """A rig with the thesis's plant (5-17) and sensor noise, in closed loop, mm and V."""
    rig = from_roots(GAIN, [ZERO], POLES)
    pid = PID(0.5, 0.007, 0.001, TS, integration="trapezoidal", acts_on_minus_error=True)
    reference = np.concatenate([np.zeros(50), pseudo_random_binary(8, hold=4, samples=2040)])
    noise = np.random.default_rng(1).normal(scale=0.0104, size=(1, reference.size))
    run = simulate_loop(rig, pid, reference, runs=1, position_noise=noise)
    return {"reference": 8.0 + reference, "position": 8.0 + (run.y + noise)[0], "control": 4.2 + run.u[0]}


@pytest.fixture
def rig(signals, tmp_path):
    units = {"reference": "mm", "position": "mm", "control": "V"}
    write_log(tmp_path / "rig.csv", make_log(TS, signals, units), units)
    return tmp_path / "rig.csv"


def check_model(answer):
    for key, wanted in (("poles", POLES), ("zeros", (ZERO,))):
        found = np.array(answer[key])
        assert np.abs(found[:, 1]).max() == 0.0
        errors = np.array(answer[f"{key[:-1]}_errors"])
        assert (np.abs(found[:, 0] - wanted) < 4 * errors).all()
        assert (errors < 2e-3).all()
    assert answer["gain"] == pytest.approx(GAIN, rel=0.01)
    np.testing.assert_allclose(np.array(answer["poles_per_s"])[:, 0], np.log(POLES) / TS, rtol=0.02)
    assert answer["Ts"] == pytest.approx(TS)


@pytest.mark.parametrize("method", ["direct", "armax", "two-stage"])
def test_the_model_behind_a_log_is_found_with_its_errors(answer, rig, method):
    found = answer("identify --method", method, rig)
    if method != "two-stage":
        check_model(found)
    np.testing.assert_allclose(np.array(found["poles"])[:, 0], POLES, rtol=0.03)
    assert found["rest"] == 50
    assert found["operating_point"]["output"] == pytest.approx(8.0, abs=0.01)
    assert {c["name"] for c in found["coefficients"]} == {"a_1", "a_2", "b_0", "b_1"}
    assert len(found["covariance"]) == 4


def test_the_page_names_every_pole(command, rig):
    code, out, _ = command("identify", rig)
    assert (code, "1.01" in out, "±" in out) == (0, True, True)


def written_as(signals, path, delimiter, decimal=".", heading="{} ({})", names=None):
    """The log in the format of another program."""
    columns = {"time": TS * np.arange(len(signals["control"])), **signals}
    units = {"time": "s", "reference": "mm", "position": "mm", "control": "V"}
    names = {name: name for name in columns} | (names or {})
    head = delimiter.join(heading.format(names[name], units[name]) for name in columns)
    rows = [
        delimiter.join(f"{v:.6f}".replace(".", decimal) for v in row)
        for row in zip(*columns.values(), strict=True)
    ]
    path.write_text("\n".join(["% a rig", head, *rows]) + "\n")
    return path


@pytest.mark.parametrize(
    ("delimiter", "decimal", "heading"),
    [
        (";", ",", "{} [{}]"),
        ("\t", ".", "{}_{}"),
        ("\t", ",", "{} ({})"),
        (" ", ".", "{} ({})"),
        ("   ", ".", "{}_{}"),
        (",", ".", "{}/{}"),
        (";", ".", '"{} ({})"'),
    ],
)
def test_delimiters_decimal_commas_and_units_are_recognised(
    answer, signals, tmp_path, delimiter, decimal, heading
):
    check_model(answer("identify", written_as(signals, tmp_path / "log.txt", delimiter, decimal, heading)))


def test_what_is_not_recognised_is_asked_for(command, answer, signals, tmp_path):
    names = {"control": "ch 1", "position": "ch 2", "reference": "ch 3"}
    path = written_as(signals, tmp_path / "log.csv", ",", heading="{}", names=names)
    code, _, err = command("identify", path)
    assert code == 2
    # The time has no unit, and neither input nor output has a known name.
    assert all(word in err for word in ("--from", "--to", "column time"))
    line = "identify --from 'ch 1' --to 'ch 2' --unit 'ch 1=V' --unit 'ch 2=mm' --rest 50"
    for of_time in ("--unit time=s", "--sampling-ms 2"):
        check_model(answer(f"{line} {of_time}", path))


BROKEN = "time (s),control (V),position (furlong)\n0,1,2\n0.1,x,3\n0.2,1\n0.3,nan,3\n0.9,1,2\n"


def test_all_problems_of_a_file_and_of_the_options_are_told_at_once(command, tmp_path):
    (tmp_path / "log.csv").write_text(BROKEN)
    code, _, err = command("identify --poles 1 --zeros 2 --method guess --unit mm", tmp_path / "log.csv")
    assert code == 2
    for where in ("log.csv:3", "log.csv:4", "log.csv:5", "furlong", "Orders", "--method", "--unit"):
        assert where in err


def test_a_log_of_a_simulated_rig_has_the_poles_of_the_machine(command, answer, written, tmp_path):
    """A PID on six dipoles with a pseudo-random reference, against the poles of the machine's linear model."""
    line = """--set 'reference.0={kind = "prbs", axis = "depth", at_s = 1.0, amplitude_mm = 0.1, bit_ms = 8, order = 8}'
    --set 'sensors.deviation_mm=[0.0, 0.0, 0.00005]' --set coils.dynamics=false --set control.delay_ms=0.0
    --set duration_s=5.0"""
    changes = parse_settings([word for word in shlex.split(line) if word != "--set"])
    path = written()
    linear = linear_points(prepare(read_scenario(path, changes)))[0].linear
    z = [linear.states.index(name) for name in ("z", "velocity_z")]
    wanted = np.sort(np.linalg.eigvals(linear.A[np.ix_(z, z)]).real)
    code, _, err = command(f"simulate {line} -o", tmp_path / "run.csv", path)
    assert code == 0, err
    found = answer(
        "identify --from 'outputs lift' --to 'seen z' --reference 'reference z'", tmp_path / "run.csv"
    )
    # The stated errors cover noise only, not the slight nonlinearity of the force over 0.1 mm.
    assert max(found["pole_errors_per_s"]) < 0.02
    np.testing.assert_allclose(np.sort(np.array(found["poles_per_s"])[:, 0]), wanted, rtol=0.015)
