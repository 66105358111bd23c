"""Every controller as a linear block, sample by sample against the controllers of fieldmap.control."""

import inspect
from dataclasses import fields

import numpy as np
import pytest

from fieldmap.control import PID, Regulator, RunningPID, RunningRegulator, kalmd
from fieldmap.control.pid import ANTI_WINDUP
from fieldmap.core.controller import CoreController
from fieldmap.dynamics import AxisReading, constant_block, pid_block, regulator_block, stacked, state_block
from fieldmap.dynamics.scenario.controllers import AxisRegulator, Pid
from fieldmap.errors import InputError

DEPTH = AxisReading("z", -1e3, -77.0)


def outputs_of(block, signals, forward=None):
    outputs = np.empty((len(signals), block.outputs))
    CoreController(block.arrays).control(signals, forward, block.memory.copy(), outputs)
    return outputs


def positions(samples=60):
    """Signals (n, 7) about a depth of 10 mm, with excursions that reach the limits of the controllers."""
    places = 1e-3 * np.random.default_rng(3).normal(size=(samples, 6)).cumsum(axis=0)
    return np.column_stack([places - np.tile([0, 0, 0.087], 2), np.ones(samples)])


RULES = {"integration": "rectangular", "tracking_time": 0.02, "Tf": 0.003, "b": 0.6, "c": 0.3}


@pytest.mark.parametrize("anti_windup", ANTI_WINDUP)
@pytest.mark.parametrize("given", [{}, *({name: value} for name, value in RULES.items()), RULES])
@pytest.mark.parametrize("axis", ["x", "z"])
def test_a_pid_of_a_file_is_that_of_python(anti_windup, given, axis):
    """To 1e-12, with every key of a file; a controller of the depth acts on minus the error."""
    given = given | {"anti_windup": anti_windup}
    limits = {"lower": -1.0, "upper": 1.5}
    pid = PID(0.5, 0.05, 0.004, 2e-3, **limits, **given, acts_on_minus_error=axis == "z")
    of_file = Pid(Kc=0.5, Ti=0.05, Td=0.004, **limits, **given)
    assert {each.name for each in fields(of_file)} == {"Kc", "Ti", "Td", "anti_windup", *limits, *RULES}
    reading = DEPTH if axis == "z" else AxisReading("x", 1e3)
    signals = positions()
    k = "xyz".index(axis)
    running = RunningPID(pid)
    wanted = [
        running.step(*(reading.factor * place + reading.offset for place in (row[k], row[3 + k])))
        for row in signals
    ]
    begin = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    begin[[2, 5]] = -0.077
    for block in (pid_block(pid, reading), of_file.block(reading, 2e-3, 0.0, begin)):
        np.testing.assert_allclose(outputs_of(block, signals)[:, 0], wanted, rtol=0, atol=1e-12 * 87)
    assert np.sum(np.isin(wanted, [-1.0, 1.5])) > 10


def test_a_scenario_and_python_integrate_by_the_same_rule():
    """Errors of 1 and 0.5, by hand: 2 (1) + 0.2 (0.5) = 2.1, then 2 (0.5) + 0.2 (0.5 + 0.75) = 1.25."""
    signals = np.zeros((2, 7))
    signals[:, 0], signals[:, 6] = (1.0, 0.5), 1.0
    x, at = AxisReading("x"), np.zeros(7)
    of_scenario = Pid(Kc=2.0, Ti=0.1).block(x, 0.01, 0.0, at)
    of_python = pid_block(PID(Kc=2.0, Ti=0.1, Td=0.0, Ts=0.01), x, at=at)
    for block in (of_scenario, of_python):
        np.testing.assert_allclose(outputs_of(block, signals)[:, 0], [2.1, 1.25])
    rest = {
        "equilibrium_at",
        "estimate",
        "divisor",
        "anti_windup",
        "Tf",
        "b",
        "c",
        "tracking_time",
        "integration",
    }
    for file, python in ((Pid, PID), (AxisRegulator, Regulator)):
        of_file, ours = (inspect.signature(kind).parameters for kind in (file, python))
        shared = rest & set(of_file)
        assert len(shared) > 1
        assert [of_file[name].default for name in shared] == [ours[name].default for name in shared]


def test_a_pid_block_at_rest_stays_at_its_output():
    signals = np.tile([0, 0, -0.0871, 0, 0, -0.087, 1.0], (5, 1))
    pid = PID(0.5, np.inf, 0.004, 2e-3, c=0.0, acts_on_minus_error=True)
    np.testing.assert_allclose(outputs_of(pid_block(pid, DEPTH, 3.3, signals[0]), signals), 3.3, atol=1e-12)


@pytest.mark.parametrize("estimate", ["predicted", "filtered", "delayed"])
@pytest.mark.parametrize("equilibrium_at", ["reference", "measured"])
def test_a_regulator_block_is_the_regulator(estimate, equilibrium_at):
    A, B, C = np.array([[1.9, -0.91], [1.0, 0.0]]), np.array([[1.0], [0.0]]), np.array([[-0.03, 0.0298]])
    estimator = kalmd(A - np.eye(2), B, C, 1.0, 1e-4, 2e-3)
    regulator = Regulator(
        np.array([3.0, -2.0, 5.0]), estimator, 2e-3, (3.0, 0.1), equilibrium_at, estimate, 0.69, 2.0, 7.0
    )
    signals = positions()
    running = RunningRegulator(regulator)
    wanted = [running.step(-1e3 * row[2] - 77.0, -1e3 * row[5] - 77.0) for row in signals]
    found = outputs_of(regulator_block(regulator, DEPTH), signals)[:, 0]
    np.testing.assert_allclose(found, wanted, rtol=1e-9)
    assert 5 < np.sum(np.isin(found, [2.0, 7.0])) < 55


def test_blocks_side_by_side_do_not_hear_each_other():
    one = pid_block(PID(1.0, 0.1, 0.0, 2e-3, -0.5, 0.5, anti_windup="clamping"), AxisReading("x", 1e3))
    two = pid_block(PID(0.3, 0.2, 0.01, 2e-3, anti_windup="back_calculation", lower=-1.0, upper=1.0), DEPTH)
    three = state_block([[0.5]], np.eye(1, 7), [[2.0]], np.zeros((1, 7)))
    signals = positions()
    together = outputs_of(stacked(one, constant_block(0.7), two, three), signals)
    apart = [outputs_of(block, signals)[:, 0] for block in (one, two, three)]
    np.testing.assert_allclose(together[:, [0, 2, 3]].T, apart, atol=1e-12)
    np.testing.assert_array_equal(together[:, 1], 0.7)


def test_feedforward_is_added_before_the_limits_and_kept_from_observers():
    block = state_block([[0.0]], np.zeros((1, 7)), [[0.0]], np.eye(1, 7), E=[[1.0]], lower=-1.0, upper=2.0)
    signals = np.zeros((4, 7))
    signals[:, 0] = [0.5, 1.5, -3.0, 0.5]
    outputs = outputs_of(block, signals, np.ones((4, 1)))
    np.testing.assert_allclose(outputs[:, 0], [1.5, 2.0, -1.0, 1.5])


@pytest.mark.parametrize(
    "shapes",
    [((2, 2), (1, 7), (1, 2), (1, 7)), ((1, 1), (1, 7), (2, 1), (1, 7)), ((1, 1), (1, 7), (1, 1), (1, 6))],
)
def test_matrices_that_do_not_fit_are_named(shapes):
    with pytest.raises(InputError, match="state_block"):
        state_block(*[np.zeros(shape) for shape in shapes])
