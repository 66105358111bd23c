"""Blocks in the C core against their law in numpy; what does not fit is refused."""

import pickle

import numpy as np
import pytest

from fieldmap.core.controller import CoreController
from tests.core.controller_cases import random_block, random_signals, step_of

SIGNALS = random_signals(200)
SHAPES = [(4, 2, 1), (3, 1, 3), (5, 3, 2), (0, 2, 1), (1, 1, 4)]


def run(block, feedforward=None, signals=SIGNALS):
    memory = np.linspace(-0.3, 0.4, block.A.shape[1])
    outputs, memories = np.empty((len(signals), block.D.shape[1])), np.empty((len(signals), len(memory)))
    held = CoreController(block).control(signals, feedforward, memory, outputs, memories)
    np.testing.assert_array_equal(memory, memories[-1])
    return outputs, memories, held


@pytest.mark.parametrize(("states", "outputs", "nodes"), SHAPES)
@pytest.mark.parametrize("forward", [False, True])
def test_every_sample_obeys_the_law(states, outputs, nodes, forward):
    block = random_block(states, outputs, nodes)
    ahead = np.random.default_rng(6).normal(size=(200, outputs)) if forward else np.zeros((200, outputs))
    found, memories, held = run(block, ahead if forward else None)
    memory, held_back, stopped = np.linspace(-0.3, 0.4, states), 0, 0
    for n in range(200):
        wanted, after, limited = step_of(block, SIGNALS[n], ahead[n], memory)
        stopped += int(np.sum(after == memory))
        np.testing.assert_allclose(found[n], wanted, rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(memories[n], after, rtol=1e-12, atol=1e-13)
        memory, held_back = memories[n], held_back + limited
    assert held == held_back
    assert 20 < held < 200
    assert (stopped > 10) == (states > 0)


def test_one_sample_has_the_bits_of_many():
    block = random_block(4, 2, 3)
    outputs, memories, held = run(block)
    core, memory, one, count = CoreController(block), np.linspace(-0.3, 0.4, 4), np.empty((1, 2)), 0
    for n in range(200):
        count += core.control(SIGNALS[n : n + 1], None, memory, one)
        np.testing.assert_array_equal(one[0], outputs[n])
        np.testing.assert_array_equal(memory, memories[n])
    assert count == held


@pytest.mark.parametrize(("states", "outputs", "nodes"), SHAPES)
def test_with_the_quiet_feedforward_it_gives_what_is_wanted(states, outputs, nodes):
    """At references that are reached, without limits, and with a memory that depends on the applied outputs."""
    block = random_block(states, outputs, nodes, limit=np.inf)
    block = block._replace(hold=np.full(states, -1), E=0.05 * block.E, F=0.05 * block.F)
    random = np.random.default_rng(7)
    references, wanted = random.normal(size=(30, 3)), random.normal(size=(30, outputs))
    memory, forward = np.linspace(-0.3, 0.4, states), np.empty((30, outputs))
    CoreController(block).quiet_feedforward(references, wanted, memory, forward)
    found, memories, held = run(block, forward, np.column_stack([references, references, np.ones(30)]))
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(memory, memories[-1], rtol=1e-9, atol=1e-11)
    assert held == 0


def test_a_controller_can_be_pickled():
    core = CoreController(random_block(4, 2, 3))
    both = []
    for one in (core, pickle.loads(pickle.dumps(core))):
        outputs = np.empty((200, 2))
        one.control(SIGNALS, None, np.zeros(4), outputs)
        both.append(outputs)
    np.testing.assert_array_equal(*both)


def test_arrays_that_do_not_fit_are_refused_and_nothing_is_written():
    core = CoreController(random_block(4, 2))
    memory, outputs = np.zeros(4), np.full((5, 2), 7.0)
    fixed = outputs.copy()
    fixed.flags.writeable = False
    some = SIGNALS[:5].copy()
    for given in (
        (some[:, :6].copy(), None, memory, outputs),
        (some.reshape(7, 5), None, memory, outputs),
        (some[:4].copy(), None, memory, outputs),
        (some.astype(np.float32), None, memory, outputs),
        (np.asfortranarray(some), None, memory, outputs),
        (some, np.zeros((4, 2)), memory, outputs),
        (some, np.zeros(10), memory, outputs),
        (some, None, np.zeros(3), outputs),
        (some, None, memory, outputs[:, :1]),
        (some, None, memory, fixed),
        (some, None, memory, outputs, np.zeros((5, 3))),
    ):
        with pytest.raises(TypeError):
            core.control(*given)
    assert (outputs == 7.0).all()
    assert (memory == 0.0).all()


@pytest.mark.parametrize(
    "changed",
    [
        {"A": np.zeros((1, 4, 3))},
        {"A": np.zeros((2, 4, 4))},
        {"B": np.zeros((1, 4, 6))},
        {"D": np.zeros((1, 2, 6))},
        {"E": np.zeros((1, 2, 3))},
        {"lower": np.zeros(3)},
        {"hold": np.array([0, 1, 2, -1])},
        {"hold": np.array([0, -2, 1, -1])},
        {"hold": np.zeros(4)},
        {"nodes": np.zeros(2)},
        {"nodes": np.array([0.0, 1.0, 7.0])},
    ],
)
def test_blocks_that_do_not_fit_are_refused(changed):
    with pytest.raises((TypeError, ValueError)):
        CoreController(random_block(4, 2)._replace(**changed))
