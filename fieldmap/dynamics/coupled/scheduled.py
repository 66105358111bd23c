"""One controller made of several over the height of the reference, between which it is linear."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_positive
from fieldmap.control.blocks import ControllerBlock, arrays_of
from fieldmap.core.controller import Block
from fieldmap.errors import InputError, Problem
from fieldmap.records import Record
from fieldmap.typing import Array

_HEIGHT = 2  # of the reference, among the signals of a block


@dataclass(frozen=True, eq=False, repr=False)
class ScheduledController(Record):
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
    def arrays(self) -> Block:
        """As compiled loops take it."""
        return arrays_of(self.blocks, (self.first, self.step, float(_HEIGHT)))

    def inverse(self, state: Array) -> None:
        """None: the outputs go to the coils as they are."""

    def at(self, sensed: Array, stiffness: ArrayLike, per_output: ArrayLike) -> ControllerBlock:
        """The block between the two next to the height of the sensed point."""
        count = len(self.blocks)
        place = float(np.clip((sensed[_HEIGHT] - self.first) / self.step, 0, count - 1))
        low = min(int(place), max(count - 2, 0))
        return _between(self.blocks[low], self.blocks[min(low + 1, count - 1)], place - low)


def _between(a: ControllerBlock, b: ControllerBlock, share: float) -> ControllerBlock:
    parts = {name: (1.0 - share) * getattr(a, name) + share * getattr(b, name) for name in "ABCDE"}
    forward = None if a.F is None or b.F is None else (1.0 - share) * a.F + share * b.F
    return ControllerBlock(**parts, lower=a.lower, upper=a.upper, hold=a.hold, memory=a.memory, F=forward)
