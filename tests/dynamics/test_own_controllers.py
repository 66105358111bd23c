"""Controllers that are functions: Python, numba and C against the shipped PID, and loops written by hand."""

import ctypes
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pytest

from fieldmap.control import C_SIGNATURE, PID, ControlFunction, FunctionController
from fieldmap.core.controller import CoreController
from fieldmap.currents import divide_currents
from fieldmap.dynamics import (
    AxisReading,
    CoilDrive,
    Machine,
    RigidBody,
    RunningMachine,
    Schedule,
    Sensors,
    constant_block,
    lift_and_directions,
    linear_points,
    linearised,
    modelled,
    open_machine,
    pid_block,
    prepare,
    read_scenario,
    simulate,
    simulate_closed_loop,
    simulate_many,
    stacked,
    state_of,
    tabled,
)
from fieldmap.dynamics.loop_run import as_csv, recorded
from fieldmap.dynamics.scenario import simulate_batches
from fieldmap.errors import ControllerError, InputError, ScenarioError
from fieldmap.instruments import Amplifier, Converter
from tests.dynamics.machines import GAIN, MASS, PERIOD, one_coil
from tests.refusals import refused

TEXT = (Path(__file__).parents[1] / "scenarios" / "step.toml").read_text()
KC, TI, TD, OUTPUT, LOWER, UPPER = 2.0, 0.4, 0.06, 2.0 / GAIN, 4.0, 6.0
KP, KI, KD = KC, KC * PERIOD / TI, KC * TD / PERIOD
START = np.array([OUTPUT, 0.0, 0.0])
SEEN, POINTER = np.array([0.1, 0.2, 0.3]), ctypes.POINTER(ctypes.c_double)
NOISE = {"deviations": (5e-6, 8e-6, 2e-5), "voltage_noise": 0.0}


@pytest.fixture(scope="module")
def plain(axial):
    """One coil, with noise, converters and windings; 2 A in it carry a body at the origin."""
    amplifier = Amplifier(GAIN, -10.0, 10.0, deviation=1e-3)
    drive = CoilDrive(amplifier, 1, [2.0], [4e-3], (-20.0, 20.0), converter=Converter(10.0, 16))
    return one_coil(axial, drive, Sensors(**NOISE), ("lift_V",))


def shipped(**more):
    at = np.array([0, 0, 5e-3, 0, 0, 5e-3, 1.0])
    pid = PID(KC, TI, TD, PERIOD, lower=LOWER, upper=UPPER, integration="trapezoidal")
    return pid_block(pid, AxisReading("z", 1e3), OUTPUT, at)


def python_pid(time, measured, reference, state):
    error = 1e3 * (reference[2] - measured[2])
    state[0] += KI * 0.5 * (error + state[1])
    wanted = KP * error + state[0] + KD * (error - state[2])
    state[1] = state[2] = error
    return (wanted,)


jitted_pid = numba.njit(python_pid)


@numba.cfunc(C_SIGNATURE)
def compiled_pid(time, measured, reference, state, outputs):
    outputs[0] = jitted_pid(time, measured, reference, state)[0]
    return 0


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("no C compiler here")
    made, source = tmp_path_factory.mktemp("own") / "own.so", Path(__file__).with_name("own.c")
    gains = [f"-DKP={KP!r}", f"-DKI={KI!r}", f"-DKD={KD!r}"]
    # A fused multiply-add rounds once and would change bits.
    how = ["-O2", "-ffp-contract=off", "-shared", "-fPIC"]
    subprocess.run([compiler, *how, *gains, "-o", made, source], check=True)
    return ctypes.CDLL(str(made))


def schedule(samples=400, **more):
    references = np.tile([0.0, 0.0, 5e-3], (samples, 1))
    references[50:, 2] += 3e-4
    loads = np.zeros((samples, 6))
    loads[200:220, 2] = 2e-3
    return Schedule(references, PERIOD, loads=loads, **({"step": 1e-4, "delay": 5e-4} | more))


def own(function, **more):
    return FunctionController(function, **({"state": START, "lower": LOWER, "upper": UPPER} | more))


def run(machine, controller, seed=3, plan=None):
    return simulate_closed_loop(machine, controller, plan or schedule(), state_of([0, 0, 0]), [2.0], seed)


def test_pid_in_python_numba_and_c_has_the_bits_of_one_another_and_the_path_of_the_shipped_one(
    plain, library
):
    """The shipped PID sums the same terms in another order (a block of matrices): rounding of 1e-16 a sample, which the
    closed loop does not amplify."""
    wanted = run(plain, shipped())
    assert wanted.event is None
    assert np.ptp(wanted.outputs) > 1.0
    assert (wanted.outputs == LOWER).any() or (wanted.outputs == UPPER).any()
    functions = [python_pid, jitted_pid, compiled_pid, library.control, ControlFunction(("control", library))]
    found = [run(plain, own(function)) for function in functions]
    for each in found:
        np.testing.assert_array_equal(each.rows, found[0].rows)
    np.testing.assert_allclose(found[0].outputs, wanted.outputs, rtol=1e-12)
    np.testing.assert_allclose(found[0].position, wanted.position, atol=1e-15)
    address = ctypes.cast(library.control, ctypes.c_void_p).value
    np.testing.assert_array_equal(run(plain, own(address)).rows, found[0].rows)
    assert [own(f).form for f in functions] == ["python", "numba", "c", "c", "c"]


def test_the_shipped_block_as_a_function_has_its_bits(plain):
    """The path from sensors through limits, delay, converter and winding is the same for functions and blocks."""
    block = shipped()
    core = CoreController(block.arrays)

    def same(time, measured, reference, state):
        outputs = np.empty((1, 1))
        core.control(np.concatenate([reference, measured, [1.0]])[None], None, state, outputs)
        return outputs[0]

    np.testing.assert_array_equal(run(plain, own(same, state=block.memory)).rows, run(plain, block).rows)


def test_equal_seeds_have_equal_bits_in_any_thread(plain):
    plan = schedule(100)
    for function in (python_pid, jitted_pid):
        # Made once, because each controller compiles its numba function anew.
        controller = own(function)
        one, again, other = (run(plain, controller, seed, plan) for seed in (5, 5, 6))
        np.testing.assert_array_equal(one.rows, again.rows)
        assert np.abs(one.seen - other.seen).max() > 1e-6

        def one_of_many(seed, controller=controller):
            return run(plain, controller, seed, plan)

        many = [simulate_many(3, one_of_many, seed=1, threads=threads) for threads in (1, 3)]
        for a, b in zip(*many, strict=True):
            np.testing.assert_array_equal(a.rows, b.rows)


GAIN_IN_USE = 3.0


def test_each_controller_takes_the_globals_of_its_function_as_they_are(monkeypatch):
    """numba compiles globals as constants, so each controller compiles anew to use a changed value."""

    @numba.njit
    def proportional(time, measured, reference, state):
        return GAIN_IN_USE * measured[2]

    out = np.zeros(1)
    for gain in (3.0, 4.0):
        monkeypatch.setitem(globals(), "GAIN_IN_USE", gain)
        bound = own(proportional).bound(["lift_V"])
        ControlFunction(bound.address)(
            0.0, *(v.ctypes.data_as(POINTER) for v in (SEEN, SEEN, START.copy(), out))
        )
        assert out[0] == gain * SEEN[2]


@pytest.mark.parametrize("late", [0.0, 5e-4, PERIOD])
def test_a_loop_by_hand_has_the_bits_of_the_run(plain, late):
    scanning = replace(
        plain, sensors=Sensors(zero_depth=0.0, scan_rate=1200.0, averages=2, latency=1, **NOISE)
    )
    for machine in (plain, scanning):
        plan = schedule(delay=late)
        wanted = run(machine, own(python_pid), plan=plan)
        by_hand = RunningMachine(machine, plan, state_of([0, 0, 0]), [2.0], 3, lower=LOWER, upper=UPPER)
        for _ in range(2):
            state = START.copy()
            while by_hand.event is None and by_hand.time < 0.8 - 1e-9:
                by_hand.step(python_pid(by_hand.time, by_hand.measured, by_hand.reference, state))
            found = by_hand.run
            np.testing.assert_array_equal(found.rows, wanted.rows)
            np.testing.assert_array_equal(found.references, wanted.references)
            np.testing.assert_allclose(found.time, wanted.time, atol=1e-12)
            by_hand.reset()
        by_hand.reset(4)
        assert np.abs(by_hand.measured - wanted.seen[0]).max() > 1e-8


def test_a_loop_by_hand_goes_on_beyond_its_schedule_and_at_steps_of_its_own(plain):
    machine = RunningMachine(plain, schedule(20), state_of([0, 0, 0]), [2.0], 3)
    state, seen = START.copy(), []
    for k in range(100):
        dt = 1e-3 if k % 2 else 3e-3
        seen.append(machine.measured)
        machine.step(python_pid(0.0, machine.measured, machine.reference, state), dt)
    assert machine.event is None
    assert machine.time == pytest.approx(0.2)
    np.testing.assert_allclose(machine.run.time[:3], [0.0, 3e-3, 4e-3])
    np.testing.assert_array_equal(machine.run.seen, seen)
    noise = machine.run.seen - machine.run.sensed
    np.testing.assert_allclose(noise.std(axis=0), NOISE["deviations"], rtol=0.35)
    assert len(np.unique(noise[:, 2])) == 100
    fine, coarse = (
        RunningMachine(plain, schedule(20, delay=0.0), state_of([0, 0, 0]), [2.0], None) for _ in range(2)
    )
    for _ in range(10):
        fine.step(OUTPUT, 1e-3), fine.step(OUTPUT, 1e-3), coarse.step(OUTPUT)
    np.testing.assert_array_equal(fine.state, coarse.state)


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("rows", [1, 6])
def test_what_acts_beyond_the_schedule_is_its_last_row(plain, even, rows):
    """References, feed-forward and forces of 6 periods of 2 ms, or one force throughout: 12 periods by hand, once with
    two steps of half a period each."""
    quiet = replace(plain, sensors=Sensors(zero_depth=0.0))
    references = np.column_stack([np.zeros((6, 2)), 5e-3 + 1e-5 * np.arange(6)])
    forward, loads = 0.01 * np.arange(6.0)[:, None], np.zeros((rows, 6))
    loads[:, 0] = 1e-3 * np.arange(1, 1 + rows)
    about = {"period": 2e-3, "step": 1e-4, "feedforward": forward, "loads": loads}
    machine = RunningMachine(quiet, Schedule(references, **about), state_of([0, 0, 0]), [2.0], None)
    kept = np.minimum(np.arange(12), 5)
    long = Schedule(references[kept], **about | {"feedforward": forward[kept], "loads": loads[kept % rows]})
    wanted = RunningMachine(quiet, long, state_of([0, 0, 0]), [2.0], None)
    for k in range(11):
        np.testing.assert_allclose(machine.reference, references[kept[k]], rtol=1e-12)
        for dt in (None,) if even else (1e-3, 1e-3):
            machine.step(OUTPUT, dt)
        wanted.step(OUTPUT)
        np.testing.assert_allclose(machine.state, wanted.state, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(machine.outputs, np.add(OUTPUT, forward[kept[k]]), rtol=1e-12)


def test_steps_that_do_not_fit_are_refused(plain):
    machine = RunningMachine(plain, schedule(), state_of([0, 0, 0]), [2.0], 3)
    given = {"an array (2,)": [1.0, 2.0], "nan": np.nan, "[inf]": [np.inf]}
    for received, outputs in given.items():
        with refused(InputError, where="RunningMachine.step(outputs)", received=received):
            machine.step(outputs)
    for dt in (1.5e-4, 3e-4, 0.0, np.nan):
        with refused(InputError, where="RunningMachine.step(dt)", received=f"{dt:g} s"):
            machine.step(1.0, dt)
    for delay, dt, late, near in (
        (5e-4, 2e-4, "of 0.0001 s, and at least the delay of 0.0005 s", "dt=0.0005,"),
        (0.0, 4e-5, "of 0.0001 s", "dt=0.0001,"),
        (0.0, np.inf, "of 0.0001 s", "dt=0.0001,"),
        (0.0, 3.4e-4, "of 0.0001 s", "dt=0.0003,"),
        (5e-4, 4.1e-3, None, None),
        (5e-4, 5e-4, None, None),
    ):
        one = RunningMachine(plain, schedule(delay=delay), state_of([0, 0, 0]), [2.0], 3)
        if late is None:
            one.step(OUTPUT, dt)
            assert one.time == pytest.approx(dt)
        else:
            with refused(InputError, remedy=near) as told:
                one.step(OUTPUT, dt)
            assert told.value.problems[0].must_hold.endswith(late)
            assert f"period of {PERIOD:g} s" in told.value.problems[0].remedy
    while machine.event is None:
        machine.step(0.0)
    assert machine.event.name == "fell out"
    with refused(InputError, where="RunningMachine.step", received=f"fell out at {machine.event.time:g} s"):
        machine.step(0.0)
    machine.reset()
    machine.step(0.0)


def test_currents_and_voltages_go_through_amplifier_and_converter(plain):
    """A current of 2 A acts like an output of 2 / gain V, with the converter's rounding and limits."""
    steady = {"state": (), "lower": -np.inf, "upper": np.inf}
    quiet = replace(plain, sensors=Sensors(zero_depth=0.0))

    def given(value, gives, **limits):
        return run(quiet, own(lambda *_: value, gives=gives, **steady | limits), None, schedule(30))

    runs = [given(5.0, "signals"), given(5.0, "voltages"), given(5.0 * GAIN, "currents")]
    for each in runs:
        np.testing.assert_array_equal(each.currents, runs[0].currents)
    assert runs[2].output_names == ("coil_1_A",)
    np.testing.assert_allclose(given(1e3, "currents").commanded[-1], 10.0 * GAIN, rtol=1e-3)
    np.testing.assert_array_equal(given(1e3, "currents", upper=1.5).outputs, 1.5)


def test_its_own_period_and_reset(plain):
    class Counting:
        def __init__(self):
            self.calls, self.resets = [], 0

        def reset(self):
            self.resets += 1

        def __call__(self, time, measured, reference, state):
            self.calls.append((time, measured))
            return OUTPUT

    counting = Counting()
    run(plain, own(counting), plan=schedule(10))
    run(plain, own(counting), plan=schedule(10))
    assert counting.resets == 2
    np.testing.assert_allclose([time for time, _ in counting.calls[:10]], PERIOD * np.arange(10), atol=1e-15)
    # Arrays of measurements are not reused: a function may keep them.
    assert len({tuple(measured) for _, measured in counting.calls[:10]}) == 10


def raising(time, measured, reference, state):
    state[0] += 1.0
    if time > 0.0391:
        raise ValueError("too late")
    return 5.0


def growing(time, measured, reference, state):
    return 5.0 if time < 0.0391 else np.nan


def wrong(time, measured, reference, state):
    return np.full(1 if time < 0.0391 else 2, 5.0)


@pytest.mark.parametrize("jit", [lambda f: f, numba.njit], ids=["python", "numba"])
@pytest.mark.parametrize(
    ("function", "received"), [(raising, "ValueError"), (growing, "nan"), (wrong, "(2,)")]
)
def test_what_fails_on_the_way_is_told_with_its_time(plain, jit, function, received):
    with pytest.raises(ControllerError) as error:
        run(plain, own(jit(function)))
    problem = error.value.problems[0]
    assert problem.where == "controller at 0.04 s"
    assert received in problem.received
    assert error.value.time == pytest.approx(0.04)
    assert len(error.value.run.time) == 20
    if function is raising:
        assert isinstance(error.value.__cause__, ValueError)


@pytest.mark.parametrize(("values", "received"), [((), "0 of them"), ((5.0, 5.0), "2 of them")])
def test_a_tuple_of_another_length_is_told(plain, values, received):
    with refused(ControllerError, received=received):
        run(plain, own(lambda *_: values))


@pytest.mark.parametrize("jit", [lambda f: f, numba.njit], ids=["python", "numba"])
def test_an_index_beyond_state_is_told_at_the_sample_at_which_it_happens(plain, jit):
    """Even if the function only reads, far beyond the array, or only later in the run."""

    def reads(time, measured, reference, state):
        return 5.0 if time < 0.0391 else 5.0 + 0.0 * state[5_000_000]

    for function, at in ((python_pid, "0 s"), (reads, "0.04 s")):
        with pytest.raises(ControllerError) as error:
            run(plain, own(jit(function), state=()))
        problem = error.value.problems[0]
        assert problem.where == f"controller at {at}"
        assert problem.received.startswith("IndexError")
        assert Path(__file__).name in problem.received
        assert "state=" in problem.remedy
        assert isinstance(error.value.__cause__, IndexError)


def test_checked_indices_have_the_bits_of_unchecked_ones(plain):
    signature = "Tuple((float64,))(float64, float64[::1], float64[::1], float64[::1])"
    forms = [numba.njit(boundscheck=False), numba.njit(fastmath=False), numba.njit(signature)]
    wanted = run(plain, own(jitted_pid))
    for jit in forms:
        np.testing.assert_array_equal(run(plain, own(jit(python_pid))).rows, wanted.rows)


BEYOND = """
from types import SimpleNamespace
import numba, numpy as np
from fieldmap.control import FunctionController
from fieldmap.dynamics import Schedule, simulate_closed_loop, state_of
from fieldmap.errors import ControllerError
from tests.dynamics.conftest import axial_map, dipole
from tests.dynamics.machines import one_coil

machine = one_coil(SimpleNamespace(map=axial_map, dipole=dipole))
plan = Schedule(np.zeros((200, 3)), period=2e-3)

@numba.njit
def writes(numbers, first, last):
    for k in range(first, last):
        numbers[k] = 1e300

def whole(time, measured, reference, state):
    for k in range(2000):
        state[k] = 1e300
    return 5.1

def behind(time, measured, reference, state):
    writes(state, 2, 9)
    return 5.1

def before(time, measured, reference, state):
    writes(state, -3, 0)
    return 5.1

def sensed(time, measured, reference, state):
    writes(measured, 5, 9)
    return 5.1

received = []
for times in range(3):
    for function in (whole, behind, before, sensed):
        controller = FunctionController(numba.njit(function), state=2)
        try:
            simulate_closed_loop(machine, controller, plan, state_of([0, 0, 0]), [2.0])
        except ControllerError as error:
            received.append(error.problems[0].received)
print("|".join(received))
"""


def test_a_compiled_function_that_writes_beside_its_state_does_not_end_the_program():
    """In a subprocess, because unchecked writes would abort it or corrupt its results."""
    done = subprocess.run(
        [sys.executable, "-c", BEYOND],
        capture_output=True,
        text=True,
        timeout=300,
        cwd=Path(__file__).parents[2],
    )
    assert (done.returncode, done.stderr) == (0, "")
    told = done.stdout.strip().split("|")
    assert len(told) == 12
    assert told[:4] == told[4:8] == told[8:]
    assert told[0].startswith("IndexError")
    assert [each.rsplit(" ", 1)[-1] for each in told[1:4]] == ["state[2]", "state[-1]", "measured[5]"]


def test_c_functions_that_leave_their_arrays_are_found(plain, library):
    """Writes out of bounds are noticed at the end of the run; reads out of bounds give nan."""
    with refused(ControllerError, received="outputs[1]") as error:
        run(plain, own(library.outputs_too))
    assert len(error.value.run.time) == 400
    with refused(ControllerError, where="controller at 0 s") as error:
        run(plain, own(library.reads))
    assert "nan" in error.value.problems[0].received


def test_c_functions_say_that_they_fail_by_a_number(plain, library):
    with refused(ControllerError, received="7") as error:
        run(plain, own(library.refuse))
    assert error.value.time == pytest.approx(0.04)


def test_an_interrupt_ends_the_run_as_itself(plain):
    def interrupted(time, measured, reference, state):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(plain, own(interrupted))


@numba.cfunc("float64(float64)")
def other_signature(x):
    return x


@numba.njit
def returns_text(time, measured, reference, state):
    return "up"


@numba.njit
def returns_three(time, measured, reference, state):
    return 1.0, 2, 3.0


@numba.njit
def does_not_compile(time, measured, reference, state):
    return measured.no_such_thing


@pytest.mark.parametrize(
    "function",
    [
        lambda measured: 1.0,
        numba.njit(lambda time, measured: 1.0),
        other_signature,
        3.5,
        0,
        ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(lambda x: x),
        returns_text,
        returns_three,
        does_not_compile,
    ],
)
def test_what_is_no_controller_is_refused_with_the_signature_that_must_hold(plain, function):
    with pytest.raises(InputError) as error:
        run(plain, own(function))
    assert not isinstance(error.value, ControllerError)
    problem = error.value.problems[0]
    assert problem.where == "FunctionController(function)"
    assert "time" in problem.must_hold or "lift_V" in problem.must_hold
    assert problem.received


def test_limits_state_and_period_are_checked(plain):
    for words in ({"gives": "forces"}, {"period": -1.0}, {"lower": 2.0, "upper": 1.0}, {"state": [np.nan]}):
        with pytest.raises(InputError):
            own(python_pid, **words)
    with pytest.raises(InputError):
        run(plain, own(python_pid, lower=[1.0, 2.0]))


def test_a_run_says_what_it_rests_on():
    for words, told in (
        ({"state": [0.0, 1.0]}, "no limits; a state of 2 numbers"),
        ({"lower": [0.0, -1.0, -1.0], "upper": 10.0}, "limits 0, -1, -1 to 10; a state of 1 number"),
        ({"upper": 10.0}, "limits -inf to 10; a state of"),
        ({"lower": -2.5}, "limits -2.5 to inf; a state of"),
    ):
        found = FunctionController(python_pid, **{"state": [0.0]} | words).assumption
        assert found.startswith("controller: python_pid of test_own_controllers.py")
        assert told in found


OWN = """
[control.coupled]
kind = "own"
"""


def own_scenario(text):
    """The scenario with its controllers left to the caller."""
    first, last = text.index("[control.z]"), text.index("[start]")
    return text[:first] + OWN.lstrip() + "\n" + text[last:]


def depth_pid(output):
    def pid(time, measured, reference, state):
        error = 1e3 * (measured[2] - reference[2])
        state[0] += 0.5 * 2e-3 / 0.4 * 0.5 * (error + state[1])
        wanted = -0.5 * error + -1.0 * state[0] + -0.5 * 0.06 / 2e-3 * (error - state[1])
        state[1] = error
        return output + wanted, 0.0, 0.0

    return pid


def test_a_scenario_takes_a_function_in_the_place_of_its_controllers(written):
    """Against the PID of the scenario; stepped by hand and with numba the bits are the same."""
    path = written()
    point = prepare(read_scenario(path)).operating_point
    wanted = simulate(path)
    limits = {"lower": [0.0, -1.0, -1.0], "upper": [10.0, 1.0, 1.0]}
    pid = depth_pid(point.outputs[0])
    controllers = [FunctionController(f, 2, **limits) for f in (pid, numba.njit(pid))]
    found = [simulate(path, controller=controller) for controller in controllers]
    np.testing.assert_array_equal(found[0].rows, found[1].rows)
    np.testing.assert_allclose(found[0].sensed, wanted.sensed, atol=1e-12)
    assert found[0].metrics.axes[2].step.overshoot == pytest.approx(wanted.metrics.axes[2].step.overshoot)
    machine = open_machine(written(own_scenario(TEXT)), **limits)
    assert machine.output_names == ("lift_V", "x_signal", "y_signal")
    np.testing.assert_array_equal(machine.operating_point.outputs, point.outputs)
    state = np.zeros(2)
    while machine.event is None and machine.time < 1.0 - 1e-9:
        machine.step(pid(machine.time, machine.measured, machine.reference, state))
    np.testing.assert_array_equal(machine.run.rows, found[0].rows)


def test_a_scenario_that_leaves_its_controller_to_the_caller_says_so(written):
    path = written(own_scenario(TEXT))
    experiment = prepare(read_scenario(path))
    for act in (experiment.run, lambda: linear_points(experiment)):
        with refused(ScenarioError, where="control.coupled"):
            act()


@pytest.mark.parametrize(("gives", "fits"), [("signals", True), ("voltages", False), ("currents", False)])
def test_signals_of_a_scenario_stand_beside_signals_alone(written, gives, fits):
    def steady(time, measured, reference, state):
        return (5.0, 0.0, 0.0) if gives == "signals" else (1.0,) * 6

    text = TEXT + '\n[[signal]]\noutput = "x"\nat_s = 0.1\nby = 0.01\n'
    scenario = read_scenario(written(text))
    controller = FunctionController(steady, gives=gives)
    if fits:
        assert prepare(scenario, controller=controller)
    else:
        with refused(ScenarioError, where="signal", received=gives):
            prepare(scenario, controller=controller)


def test_currents_of_six_coils_at_a_period_of_its_own(written):
    """Without disturbances, the currents at rest hold the body still."""
    path, quiet = written(), {"noise.off": True, "reference.0.by_mm": 0.0, "duration_s": 0.1}
    currents = tuple(float(value) for value in prepare(read_scenario(path)).operating_point.currents)
    assert len(set(currents)) <= 6

    def steady(time, measured, reference, state):
        return currents

    run = simulate(path, quiet, controller=FunctionController(steady, gives="currents", period=1e-3))
    assert len(run.time) == 100
    np.testing.assert_allclose(run.currents, np.tile(currents, (100, 1)), rtol=1e-9)
    assert np.abs(run.sensed - run.sensed[0]).max() < 1e-6
    record = recorded(run, tuple("123456"))
    assert record.arrays["outputs"][1] == "A"
    columns = as_csv(record).splitlines()[0].split(",")
    parts = dict.fromkeys(("position", "velocity", "sensed", "seen", "reference"), "xyz") | {
        "quaternion": "wxyz"
    }
    for name, letters in parts.items():
        found = [text.split(" (")[0] for text in columns if text.startswith(f"{name} ")]
        assert found == [f"{name} {letter}" for letter in letters]
    assert [text for text in columns if text.startswith("currents")] == [
        f"currents {k} (A)" for k in range(1, 7)
    ]
    with pytest.raises(ScenarioError):
        simulate(path, {"control.feedforward": {}}, controller=steady)
    two = simulate_batches(path, None, quiet, controller=FunctionController(steady, gives="currents"), runs=2)
    assert len(two.batches[0].runs) == 2


@pytest.mark.parametrize("iron", ["table", "linearised", "model"])
def test_saturating_iron_takes_functions_as_it_takes_blocks(saturating, axial, iron):
    """With a table of a division, linearised at currents, and with the model; compiled, as a callback and by hand."""
    m, at = saturating("harmonic"), (1.6, 0.05, -0.1)
    body = RigidBody(MASS, [6e-7, 6e-7, 2e-7], axial.dipole(0.02))
    field = modelled(m)
    if iron != "model":
        field = tabled(m, (4, 5, 5)) if iron == "table" else linearised(m, divide_currents(*at, 1.25))
    drive = CoilDrive(Amplifier(1.0), 6, [2.0] * 6, [4e-3] * 6, (-20.0, 20.0))
    machine = Machine(field, body, drive, Sensors(zero_depth=0.0), lift_and_directions(1.25))
    plan, start = Schedule(np.zeros((8, 3)), PERIOD), (state_of([0, 0, 0]), divide_currents(*at, 1.25))
    still = stacked(*(constant_block(value) for value in at))

    def constant(time, measured, reference, state):
        return 1.6, 0.05, -0.1

    wanted = simulate_closed_loop(machine, still, plan, *start, 1)
    assert len(wanted.time) == 8
    for function in (constant, numba.njit(constant)):
        found = simulate_closed_loop(machine, FunctionController(function), plan, *start, 1)
        np.testing.assert_array_equal(found.rows, wanted.rows)
    by_hand = RunningMachine(machine, plan, *start, 1)
    for again in range(2):
        for _ in range(8):
            by_hand.step(at)
        np.testing.assert_array_equal(by_hand.run.rows, wanted.rows)
        assert by_hand.run.iron == wanted.iron
        if not again:
            by_hand.reset(1)
