"""Models as systems of python-control have our poles and responses."""

import sys

import numpy as np
import pytest

from fieldmap import control
from fieldmap.control import LumpedMagnet, constant_block, simulate_loop
from fieldmap.errors import FieldmapError, InputError

TS = 2e-3
VERTICAL = control.from_roots(-0.03, [0.9935], [1.01, 0.905])
MODEL = control.controller_form([-15.63, -50.97], [1, 44.94, -248.3])


@pytest.fixture(scope="module")
def reference():
    return pytest.importorskip(
        "control", reason='python-control is not installed (pip install "fieldmap[control]")'
    )


def in_order(poles):
    return np.sort_complex(np.asarray(poles, complex))


def test_poles_and_zeros_of_a_transfer_function(reference):
    system = VERTICAL.to_control(TS)
    assert isinstance(system, reference.TransferFunction)
    assert system.dt == TS
    np.testing.assert_allclose(in_order(system.poles()), in_order(VERTICAL.poles), rtol=1e-9)
    np.testing.assert_allclose(in_order(system.zeros()), in_order(VERTICAL.zeros), rtol=1e-9)
    assert control.continuous(VERTICAL, TS).to_control().dt == 0


def test_poles_of_a_lumped_magnet(reference):
    """s^2 + c s/m = g/(x0 + a), with gravity and the decrease of the force with distance: a closed form."""
    magnet = LumpedMagnet(inductance=0.01, length=0.05, mass=0.01, damping=0.02)
    system = magnet.plant(0.02).to_control(states=("z", "velocity"), inputs=["current"], outputs=["height"])
    assert isinstance(system, reference.StateSpace)
    assert system.dt == 0
    assert (system.state_labels, system.input_labels, system.output_labels) == (
        ["z", "velocity"],
        ["current"],
        ["height"],
    )
    rate, fall = 0.02 / 0.01, 2 * magnet.gravity / (0.05 + 0.02)
    expected = np.roots([1.0, rate, -fall])
    np.testing.assert_allclose(in_order(system.poles()), in_order(expected), rtol=1e-9)


def test_its_step_response_is_our_simulation(reference):
    """The open-loop plant with its input held at 1: continuous in python-control, sampled here."""
    A, B = control.zero_order_hold(MODEL.A, MODEL.B, TS)
    ours = simulate_loop((A, B, MODEL.C, MODEL.D), constant_block(1.0), np.zeros(200), Ts=TS)
    for system in (MODEL.to_control(), control.StateSpace(A, B, MODEL.C, MODEL.D).to_control(TS)):
        _, y = reference.step_response(system, ours.time)
        np.testing.assert_allclose(ours.y[0], y, rtol=1e-9, atol=1e-12 * np.abs(y).max())


def test_a_sampling_time_is_positive(reference):
    with pytest.raises(InputError) as caught:
        MODEL.to_control(-TS)
    assert "Ts" in caught.value.problems[0].where


@pytest.mark.parametrize("model", [MODEL, VERTICAL])
def test_without_python_control_the_extra_is_named(model, monkeypatch):
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(FieldmapError) as caught:
        model.to_control()
    (problem,) = caught.value.problems
    assert problem.where == f"{type(model).__name__}.to_control"
    assert 'pip install "fieldmap[control]"' in problem.remedy
