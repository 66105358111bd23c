"""Linear machines in python-control have the poles and responses of the linear models and of the simulator."""

import numpy as np
import pytest

from fieldmap.control import plant_from_map
from fieldmap.device.model import Payload
from fieldmap.dynamics import (
    Schedule,
    close_loop,
    linearise,
    modes,
    prepare,
    read_scenario,
    simulate_closed_loop,
)
from fieldmap.dynamics.linear_loop import sampled_machine
from tests.dynamics.machines import PERIOD, QUIET

reference = pytest.importorskip(
    "control", reason='python-control is not installed (pip install "fieldmap[control]")'
)


@pytest.fixture(scope="module")
def experiment(six):
    return prepare(read_scenario("vertical_step", QUIET), six)


@pytest.fixture(scope="module")
def linear(experiment):
    return linearise(experiment.machine, experiment.operating_point)


def test_poles_and_names(linear):
    system = linear.to_control()
    assert system.dt == 0
    assert tuple(system.state_labels) == linear.states
    assert tuple(system.input_labels) == linear.inputs
    assert tuple(system.output_labels) == linear.outputs
    ours = [mode.pole for mode in modes(linear)]
    whole = [*ours, *np.conj([pole for pole in ours if pole.imag > 0])]
    found = system.poles()
    assert len(found) == 12
    size = np.abs(found).max()
    for pole in whole:
        assert np.abs(found - pole).min() < 1e-9 * size


def test_step_responses_are_those_of_the_sampled_machine(linear):
    """From each input to each output; the input is held between samples, so both are exact."""
    count = 100
    time = PERIOD * np.arange(count)
    steps = reference.step_response(linear.to_control(), time).outputs
    for delay in (0.0, 0.7e-3, PERIOD):
        sampled = sampled_machine(linear, PERIOD, delay)
        late = reference.step_response(sampled.to_control(PERIOD), time).outputs
        for k in range(len(linear.inputs)):
            u = np.eye(len(linear.inputs))[k]
            x, before, y = np.zeros(len(linear.A)), np.zeros_like(u), []
            for _ in range(count):
                y.append(sampled.C @ x)
                x, before = sampled.A @ x + sampled.B @ u + sampled.before @ before, u
            ours = np.array(y).T
            scale = np.abs(ours).max()
            np.testing.assert_allclose(late[:, k], ours, rtol=0, atol=1e-9 * scale)
            if delay == 0.0:
                np.testing.assert_allclose(steps[:, k], ours, rtol=0, atol=1e-9 * scale)


def test_the_loop_follows_a_reference_as_the_simulator_does(experiment, linear):
    """A step of all three references by 20 um, and by half of that: the difference falls with the square."""
    loop = close_loop(linear, experiment.controller, experiment.schedule)
    system = loop.to_control()
    assert system.dt == loop.period
    np.testing.assert_allclose(np.abs(system.poles()).max(), np.abs(loop.poles).max(), rtol=1e-9)
    rest, periods, differences = experiment.operating_point, 100, []
    for size in (2e-5, 1e-5):
        step = size * np.array([1.0, -0.5, 0.7])
        schedule = Schedule(
            np.tile(rest.sensed + step, (periods, 1)), PERIOD, 2e-5, experiment.schedule.delay
        )
        run = simulate_closed_loop(
            experiment.machine, experiment.controller, schedule, rest.state, rest.currents, None
        )
        theirs = reference.forced_response(system, U=np.tile(step[:, None], periods)).outputs.T
        ours = run.sensed - rest.sensed
        assert np.abs(theirs).max() > 0.1 * size
        differences.append(np.abs(ours - theirs).max() / np.abs(theirs).max())
    assert differences[0] < 0.02
    assert differences[0] / differences[1] == pytest.approx(2.0, rel=0.3)


def test_the_plant_of_a_map_has_its_names(six):
    plant = plant_from_map(six, Payload(0.0112, 0.8), [0.0, 0.0, -0.1], 1.5)
    system = plant.to_control()
    assert system.state_labels[3:] == ["velocity_x", "velocity_y", "velocity_z"]
    assert system.output_labels == ["x", "y", "z"]
    squares = np.linalg.eigvals(-plant.stiffness / plant.mass)
    found = np.sort_complex(system.poles() ** 2)
    np.testing.assert_allclose(found, np.sort_complex(np.repeat(squares, 2)), atol=1e-9 * np.abs(found).max())
