"""One controller made of several over the height of the reference, between which it is linear."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_positive
from fieldmap.dynamics.blocks import NO_INVERSE, ControllerBlock, arrays_of
from fieldmap.dynamics.trim import Trim
from fieldmap.errors import InputError, Problem
from fieldmap.typing import Array

_HEIGHT = 2  # of the reference, among the signals of a block


@dataclass(frozen=True, eq=False)
class ScheduledController:
    """Blocks at references whose heights (z of the map, m) rise from `first` by `step`; below and above them the first
    and the last. Their memories must mean the same; all have the limits of the first."""

    blocks: tuple[ControllerBlock, ...]
    first: float
    step: float

    def __post_init__(self) -> None:
        check_positive("ScheduledController", step=self.step, blocks=len(self.blocks))
        shapes = {(block.A.shape, block.D.shape) for block in self.blocks}
        if len(shapes) > 1:
            problem = Problem(
                "ScheduledController(blocks)",
                "must have as many states and outputs each",
                f"{shapes}",
                "design them alike",
            )
            raise InputError(problem)

    @property
    def outputs(self) -> int:
        """Number of outputs."""
        return self.blocks[0].outputs

    @property
    def memory(self) -> Array:
        """(n,): of the first block."""
        return self.blocks[0].memory

    @property
    def arrays(self) -> tuple[Any, ...]:
        """As fieldmap.kernels.motion.controller takes them."""
        return arrays_of(self.blocks, (self.first, self.step, float(_HEIGHT)))

    def inverse(self, state: Array) -> tuple[Any, ...]:
        """None: the outputs go to the coils as they are."""
        return NO_INVERSE

    def at(self, rest: Trim, stiffness: ArrayLike, per_output: ArrayLike) -> ControllerBlock:
        """The block between the two next to the height of a rest."""
        count = len(self.blocks)
        place = float(np.clip((rest.sensed[_HEIGHT] - self.first) / self.step, 0, count - 1))
        low = min(int(place), max(count - 2, 0))
        return _between(self.blocks[low], self.blocks[min(low + 1, count - 1)], place - low)


def _between(a: ControllerBlock, b: ControllerBlock, share: float) -> ControllerBlock:
    mixed = {name: (1.0 - share) * getattr(a, name) + share * getattr(b, name) for name in "ABCDE"}
    forward = None if a.F is None or b.F is None else (1.0 - share) * a.F + share * b.F
    return ControllerBlock(**mixed, lower=a.lower, upper=a.upper, hold=a.hold, memory=a.memory, F=forward)


@dataclass(frozen=True, eq=False)
class ForceController:
    """A controller whose outputs are the force wanted of the magnet (3), N, which the inverse map turns into the
    outputs of the machine's allocation at every sample, at the place that is seen.

    block: of the forces. lower, upper (3,): limits of what goes to the allocation; signals (3,): those at the start.
    rounds: of Newton's method at a sample. The body's turn is taken to be that of the start.
    """

    block: ControllerBlock
    lower: Array
    upper: Array
    signals: Array
    rounds: int = 2

    @property
    def outputs(self) -> int:
        """Three forces."""
        return self.block.outputs

    @property
    def memory(self) -> Array:
        """(n,): of its block."""
        return self.block.memory

    @property
    def arrays(self) -> tuple[Any, ...]:
        """As fieldmap.kernels.motion.controller takes them."""
        return self.block.arrays

    def inverse(self, state: Array) -> tuple[Any, ...]:
        """As fieldmap.kernels.motion.inverse takes it."""
        limits = np.array([self.lower, self.upper], float)
        return self.rounds, limits, np.array(self.signals, float), np.array(state, float)

    def at(self, rest: Trim, stiffness: ArrayLike, per_output: ArrayLike) -> ControllerBlock:
        """From what is seen to outputs, about a rest: u = u0 + (dF/du)^-1 (F - F0 + K (y - y0))."""
        block, inverse = self.block, np.linalg.inv(np.asarray(per_output, float))
        D = inverse @ block.D
        D[:, 3:6] += inverse @ np.asarray(stiffness, float)
        # The estimator is told the forces that the block asks for, whatever becomes of them.
        A, B = block.A + block.E @ block.C, block.B + block.E @ block.D
        limits = np.asarray(self.lower, float), np.asarray(self.upper, float)
        return ControllerBlock(
            A, B, inverse @ block.C, D, np.zeros_like(block.E), *limits, block.hold, block.memory
        )
