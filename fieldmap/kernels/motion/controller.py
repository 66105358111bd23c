"""A sampled controller of any kind as one linear block with limits, one sample at a time.

    u = C xi + D v      s = u within its limits      xi <- A xi + B v + E s          docs/theory/dynamics.md (29)

v (7,): reference (3) and measured position (3) of the sensed point, both m in the frame of the map, and 1. xi (n,):
memory. An observer is fed with what was applied by E; an integral that tracks its limit too. hold (n,): for an integral
that stops while it would drive an output further past its limit, the number of that output; -1 elsewhere.
"""

from numba import njit

from fieldmap.kernels.map_block import OUTER

SIGNALS = 7


@njit(**OUTER)
def control(controller, v, feedforward, memory, scratch, outputs):
    """Fill outputs (m,) = s, feed-forward (m,) included, and advance memory (n,); whether a limit held one back."""
    A, B, C, D, E, lower, upper, hold = controller
    n, m = memory.shape[0], outputs.shape[0]
    held = False
    for j in range(m):
        wanted = feedforward[j]
        for k in range(n):
            wanted += C[j, k] * memory[k]
        for k in range(SIGNALS):
            wanted += D[j, k] * v[k]
        outputs[j] = min(max(wanted, lower[j]), upper[j])
        scratch[n + j] = wanted - outputs[j]
        held |= wanted != outputs[j]
    for i in range(n):
        value = 0.0
        for k in range(n):
            value += A[i, k] * memory[k]
        for k in range(SIGNALS):
            value += B[i, k] * v[k]
        for j in range(m):
            value += E[i, j] * (outputs[j] - feedforward[j])
        scratch[i] = value
    for i in range(n):
        j = hold[i]
        if j >= 0 and scratch[n + j] * C[j, i] * (scratch[i] - memory[i]) > 0.0:
            continue
        memory[i] = scratch[i]
    return held
