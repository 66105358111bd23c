"""Closed loops of sampled plants in the C core, written out in numpy sample by sample."""

import numpy as np
import pytest

from fieldmap.core.controller import CoreController
from fieldmap.core.instruments import Chain, Drive, drive_all, measure_all
from fieldmap.core.sampled_loop import LoopInstruments, Plant, Signals, simulate
from tests.core.controller_cases import random_block, step_of

RUNS, SAMPLES = 3, 120
RANDOM = np.random.default_rng(11)
PLANT = Plant(
    np.array([[0.8, 0.3, 0.0], [-0.2, 0.7, 0.1], [0.0, 0.4, 0.5]]),
    np.array([0.5, -0.2, 0.1]),
    np.array([1.0, 0.3, -0.4]),
)
INSTRUMENTS = LoopInstruments(
    np.array(Chain(0.2, 1.4, 0.01, -2.0, 2.0, 1e-2, 0.02, 0.005, -1.5, 1.5)),
    np.array(Drive(0.02, -2.0, 2.0, 0.6, 0.1, -1.0, 1.1)),
    position=0.3,
    output=0.2,
)
SIGNALS = Signals(
    RANDOM.normal(size=(1, SAMPLES)),
    *(scale * RANDOM.normal(size=(RUNS, SAMPLES)) for scale in (0.3, 0.05, 0.04, 0.2)),
)


def looped(block, memory, plant=PLANT, instruments=INSTRUMENTS, signals=SIGNALS):
    y, u = np.empty((2, RUNS, SAMPLES))
    simulate(plant, CoreController(block), instruments, signals, memory, y, u)
    return y, u


def through(function, value, noise, numbers):
    out = np.empty(1)
    function(np.array([value]), np.array([noise]), numbers, out)
    return out[0]


@pytest.mark.parametrize(("states", "nodes"), [(4, 1), (2, 3), (0, 1)])
def test_runs_written_out(states, nodes):
    block, memory = random_block(states, 1, nodes), np.linspace(0.1, -0.2, states)
    y, u = looped(block, memory)
    np.testing.assert_array_equal(memory, np.linspace(0.1, -0.2, states))
    at = INSTRUMENTS
    still = at.drive[3] * at.output + at.drive[4]
    for run in range(RUNS):
        x, inner = np.zeros(3), memory
        for n in range(SAMPLES):
            position, voltage, current, push = (noise[run, n] for noise in SIGNALS[1:])
            place = PLANT.C @ x
            assert y[run, n] == pytest.approx(place, rel=1e-9, abs=1e-12)
            seen = through(measure_all, at.position + place + position, voltage, at.chain) - at.position
            v = np.array([*[SIGNALS.reference[0, n]] * 3, *[seen] * 3, 1.0])
            (output,), inner, _ = step_of(block, v, np.zeros(1), inner)
            assert u[run, n] == pytest.approx(output, rel=1e-9, abs=1e-12)
            flows = through(drive_all, at.output + output, current, at.drive)
            x = PLANT.A @ x + PLANT.B * (flows - still + push)
    assert np.isin(u, [block.lower, block.upper]).sum() > 20


def test_signals_of_all_runs_or_samples_stand_for_each():
    block, memory = random_block(2, 1, limit=np.inf), np.zeros(2)
    row, column, one = SIGNALS.position_noise[:1], SIGNALS.disturbance[:, :1].copy(), np.array([[0.02]])
    some = SIGNALS._replace(reference=one, position_noise=row, disturbance=column, current_noise=one)
    whole = Signals(*(np.array(np.broadcast_to(signal, (RUNS, SAMPLES)), order="C") for signal in some))
    y = np.empty((2, 2, RUNS, SAMPLES))
    for signals, (there, u) in zip((some, whole), y, strict=True):
        simulate(PLANT, CoreController(block), INSTRUMENTS, signals, memory, there, u)
    np.testing.assert_array_equal(*y)
    assert (y[0, 0, 0, 1:] != y[0, 0, 1, 1:]).all()


def test_what_does_not_fit_is_refused():
    block, y = random_block(2, 1), np.empty((RUNS, SAMPLES))
    one, two, memory = CoreController(block), CoreController(random_block(2, 2)), np.zeros(2)
    good = {"plant": PLANT, "controller": one, "instruments": INSTRUMENTS, "signals": SIGNALS}
    good |= {"memory": memory, "y": y, "u": y.copy()}
    simulate(**good)
    for bad in (
        {"controller": two},
        {"memory": np.zeros(3)},
        {"y": y[:, ::2]},
        {"y": y[0]},
        {"u": y[:2]},
        {"plant": PLANT._replace(A=np.eye(2))},
        {"plant": PLANT._replace(C=np.ones(2))},
        {"instruments": INSTRUMENTS._replace(chain=np.zeros(9))},
        {"instruments": INSTRUMENTS._replace(drive=np.array(Chain()))},
        {"signals": SIGNALS._replace(reference=np.zeros((1, SAMPLES + 1)))},
        {"signals": SIGNALS._replace(reference=np.zeros(SAMPLES))},
        {"signals": SIGNALS._replace(disturbance=np.zeros((RUNS + 1, 1)))},
        {"signals": SIGNALS._replace(disturbance=np.zeros((0, 1)))},
    ):
        with pytest.raises(TypeError):
            simulate(**(good | bad))
