"""A sampled controller of any kind as one linear block with limits, one sample at a time.

    u = C xi + D v + f     s = u within its limits     xi <- A xi + B v + E (s - f) + F f

docs/theory/dynamics.md (29).

v (7,): reference (3) and measured position (3) of the sensed point, both m in the frame of the map, and 1. xi (n,):
memory; f (m,): feed-forward. An observer is fed with what was applied by E and F; an integral that tracks its limit by
E. hold (n,): for an integral that stops while it would drive an output further past its limit, the number of that
output; -1 elsewhere.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.copy_vector import copy_vector

SIGNALS = 7
PLAIN = {"fastmath": {"contract"}, "nogil": True, "_nrt": False}
PLAIN_INLINED = {"fastmath": {"contract"}, "_nrt": False}
WHOLE = {"fastmath": {"contract"}, "nogil": True, "_nrt": True}


class Block(NamedTuple):
    """A (k, n, n), B (k, n, 7), C (k, m, n), D (k, m, 7), E, F (k, n, m): one of each, or k at equal steps of one
    signal, between which they are linear; lower, upper (m,): limits of the outputs; hold (n,); nodes (3,): first
    value, step, number of that signal in v."""

    A: Any
    B: Any
    C: Any
    D: Any
    E: Any
    F: Any
    lower: Any
    upper: Any
    hold: Any
    nodes: Any


@njit(**PLAIN)
def place_in(nodes, count, v):
    """Number of the lower node and share of the upper one."""
    if count == 1:
        return 0, 0.0
    at = min(max((v[int(nodes[2])] - nodes[0]) / nodes[1], 0.0), count - 1.0)
    lower = min(math.floor(at), count - 2)
    return lower, at - lower


@inlined(**PLAIN_INLINED)
def _entry(stack, node, share, i, j):
    if share == 0.0:
        return stack[node, i, j]
    return (1.0 - share) * stack[node, i, j] + share * stack[node + 1, i, j]


@njit(**PLAIN)
def wanted_output(C, D, node, share, j, memory, v):
    """Output number j before feed-forward and limits."""
    wanted = 0.0
    for k in range(memory.shape[0]):
        wanted += _entry(C, node, share, j, k) * memory[k]
    for k in range(SIGNALS):
        wanted += _entry(D, node, share, j, k) * v[k]
    return wanted


@njit(**PLAIN)
def next_memory(A, B, E, F, node, share, i, memory, v, applied, feedforward):
    """Number i of the memory after this sample; applied (m,): the outputs as they left."""
    value = 0.0
    for k in range(memory.shape[0]):
        value += _entry(A, node, share, i, k) * memory[k]
    for k in range(SIGNALS):
        value += _entry(B, node, share, i, k) * v[k]
    for j in range(applied.shape[0]):
        value += _entry(E, node, share, i, j) * (applied[j] - feedforward[j])
        value += _entry(F, node, share, i, j) * feedforward[j]
    return value


@njit(**PLAIN)
def control(controller, v, feedforward, memory, scratch, outputs):
    """Fill outputs (m,) = s, feed-forward (m,) included, and advance memory (n,); whether a limit held one back."""
    A, B, C, D, E, F, lower, upper, hold, nodes = controller
    n, m = memory.shape[0], outputs.shape[0]
    node, share = place_in(nodes, A.shape[0], v)
    held = False
    for j in range(m):
        wanted = wanted_output(C, D, node, share, j, memory, v) + feedforward[j]
        outputs[j] = min(max(wanted, lower[j]), upper[j])
        scratch[n + j] = wanted - outputs[j]
        held |= wanted != outputs[j]
    for i in range(n):
        scratch[i] = next_memory(A, B, E, F, node, share, i, memory, v, outputs, feedforward)
    for i in range(n):
        j = hold[i]
        if j >= 0 and scratch[n + j] * _entry(C, node, share, j, i) * (scratch[i] - memory[i]) > 0.0:
            continue
        memory[i] = scratch[i]
    return held


@njit(**WHOLE)
def quiet_feedforward(controller, references, wanted, memory, feedforward):
    """Fill feedforward (p, m), with which a controller gives the outputs wanted (p, m) where the sensed point is at its
    references (p, 3): what is wanted less what it would say by itself. memory (n,) is advanced."""
    A, B, C, D, E, F, _, _, _, nodes = controller
    n, m = memory.shape[0], wanted.shape[1]
    v, after = np.ones(SIGNALS), np.empty(n)
    for p in range(references.shape[0]):
        copy_vector(references[p], v[:3])
        copy_vector(references[p], v[3:6])
        node, share = place_in(nodes, A.shape[0], v)
        for j in range(m):
            feedforward[p, j] = wanted[p, j] - wanted_output(C, D, node, share, j, memory, v)
        for i in range(n):
            after[i] = next_memory(A, B, E, F, node, share, i, memory, v, wanted[p], feedforward[p])
        copy_vector(after, memory)
