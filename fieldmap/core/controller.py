"""A controller as the C core runs it: one linear block with limits (fieldmap/core/controller.h)."""

from typing import Any, NamedTuple

from numpy.typing import NDArray

from fieldmap.core.library import LIBRARY
from fieldmap.typing import Array

SIGNALS: int = LIBRARY.SIGNALS
"""Reference (3) and measured position (3), m, frame of the map, and 1."""
DONE, FAILED, WRONG_LENGTH = 0, 1, 2
"""Results of a controller function in C: success, exception, wrong number of outputs. All but DONE end the run."""


class Block(NamedTuple):
    """A (k, n, n), B (k, n, 7), C (k, m, n), D (k, m, 7), E, F (k, n, m): matrices, constant (k = 1) or at k
    equidistant values of a signal with linear interpolation; lower, upper (m,): limits of the outputs; hold (n,),
    int64: index of the output at whose limit an integral stops, -1 for other numbers of the memory; nodes (3,): first
    value, step and index of the signal."""

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
        self._block = block
        self.controller = LIBRARY.controller(block)

    def control(
        self,
        signals: Array,
        feedforward: Array | None,
        memory: Array,
        outputs: Array,
        memories: Array | None = None,
    ) -> int:
        """Fill outputs (p, m) for p successive samples, signals (p, 7), and advance memory (n,). Returns the number
        of samples at which a limit was active. feedforward (p, m) or None. memories (p, n): memory after each."""
        return int(LIBRARY.control(self.controller, signals, feedforward, memory, outputs, memories))

    def quiet_feedforward(self, references: Array, wanted: Array, memory: Array, feedforward: Array) -> None:
        """Fill feedforward (p, m), with which the controller gives the outputs wanted (p, m) while the sensed point
        is at its references (p, 3). memory (n,) is advanced."""
        LIBRARY.quiet_feedforward(self.controller, references, wanted, memory, feedforward)

    def __reduce__(self) -> tuple[Any, ...]:
        return CoreController, (self._block,)
