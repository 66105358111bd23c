"""A controller as the C core runs it: one linear block with limits (fieldmap/core/controller.h)."""

from typing import Any, NamedTuple

from numpy.typing import NDArray

from fieldmap.core.library import LIBRARY
from fieldmap.typing import Array

SIGNALS = 7
"""Reference (3) and measured position (3), m, frame of the map, and 1."""


class Block(NamedTuple):
    """A (k, n, n), B (k, n, 7), C (k, m, n), D (k, m, 7), E, F (k, n, m): one of each, or k at equal steps of one
    signal, between which they are linear; lower, upper (m,): limits of the outputs; hold (n,), int64: number of the
    output for an integral that stops at its limit, -1 elsewhere; nodes (3,): first value, step, number of that
    signal."""

    A: Array
    B: Array
    C: Array
    D: Array
    E: Array
    F: Array
    lower: Array
    upper: Array
    hold: NDArray[Any]
    nodes: Array


class CoreController:
    """A block, ready for the functions of the core. Its arrays must not change while it is used."""

    def __init__(self, block: Block) -> None:
        self.controller = LIBRARY.controller(block)

    def quiet_feedforward(self, references: Array, wanted: Array, memory: Array, feedforward: Array) -> None:
        """Fill feedforward (p, m), with which it gives the outputs wanted (p, m) where the sensed point is at its
        references (p, 3). memory (n,) is advanced."""
        LIBRARY.quiet_feedforward(self.controller, references, wanted, memory, feedforward)
