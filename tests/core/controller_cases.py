"""Controllers of random numbers, and their law in numpy."""

import numpy as np

from fieldmap.core.controller import Block


def random_block(states, outputs, nodes=1, seed=4, limit=1.5):
    """Stable memory, first half on hold; nodes at 0.5, 0.8 ... of the measured z; limits that outputs reach."""
    random = np.random.default_rng(seed)

    def drawn(*shape):
        return random.normal(size=(nodes, *shape))

    hold = np.where(np.arange(states) < (states + 1) // 2, np.arange(states) % outputs, -1)
    inner = drawn(states, states)
    inner *= 0.7 / np.abs(np.linalg.eigvals(inner)).max(axis=-1, initial=1e-300)[:, None, None]
    return Block(
        inner, drawn(states, 7), drawn(outputs, states), drawn(outputs, 7),
        drawn(states, outputs), drawn(states, outputs),
        np.full(outputs, -limit), np.full(outputs, 1.1 * limit), hold, np.array([0.5, 0.3, 5.0]),
    )  # fmt: skip


def random_signals(samples, seed=5):
    """(samples, 7), on both sides of the nodes and between them."""
    signals = np.random.default_rng(seed).normal(scale=0.7, size=(samples, 7))
    signals[:, 6] = 1.0
    return signals


def step_of(block, v, feedforward, memory):
    """Outputs, the memory after this sample, and whether a limit held an output back."""
    first, step, signal = block.nodes
    count = len(block.A)
    at = np.clip((v[int(signal)] - first) / step, 0, count - 1) if count > 1 else 0.0
    shares = np.maximum(0.0, 1.0 - np.abs(np.arange(count) - at))
    A, B, C, D, E, F = (np.tensordot(shares, stack, 1) for stack in block[:6])
    wanted = C @ memory + D @ v + feedforward
    outputs = np.clip(wanted, block.lower, block.upper)
    after = A @ memory + B @ v + E @ (outputs - feedforward) + F @ feedforward
    for i, j in enumerate(block.hold):
        if j >= 0 and (wanted - outputs)[j] * C[j, i] * (after[i] - memory[i]) > 0:
            after[i] = memory[i]
    return outputs, after, (wanted != outputs).any()
