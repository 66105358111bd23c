"""Feedback linearisation: a regulator of a free mass whose forces the inverse map makes: theory/dynamics.md (44)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.control.blocks import ControllerBlock
from fieldmap.core.controller import Block
from fieldmap.core.machine import InverseMap
from fieldmap.dynamics.coupled.lqg import LqgWeights, lqg_block
from fieldmap.dynamics.linearisation import VELOCITIES, LinearMachine
from fieldmap.dynamics.machine import Machine
from fieldmap.dynamics.operating_point import OperatingPoint
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class ForceController(Record):
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
    def arrays(self) -> Block:
        """As compiled loops take it."""
        return self.block.arrays

    def inverse(self, state: Array) -> InverseMap:
        """For a run that begins at a state (13,), without its machine."""
        limits = np.array([self.lower, self.upper], float)
        return InverseMap(None, self.rounds, limits, np.array(self.signals, float), np.array(state, float))

    def at(self, sensed: Array, stiffness: ArrayLike, per_output: ArrayLike) -> ControllerBlock:
        """From what is seen to outputs, about an operating point: u = u0 + (dF/du)^-1 (F - F0 + K (y - y0))."""
        block, inverse = self.block, np.linalg.inv(np.asarray(per_output, float))
        D = inverse @ block.D
        D[:, 3:6] += inverse @ np.asarray(stiffness, float)
        # The estimator is told the forces that the block asks for, whatever becomes of them.
        A, B = block.A + block.E @ block.C, block.B + block.E @ block.D
        limits = np.asarray(self.lower, float), np.asarray(self.upper, float)
        return ControllerBlock(
            A, B, inverse @ block.C, D, np.zeros_like(block.E), *limits, block.hold, block.memory
        )


def force_controller(
    machine: Machine,
    operating_point: OperatingPoint,
    weights: LqgWeights,
    period: float,
    lower: ArrayLike,
    upper: ArrayLike,
    delay: float = 0.0,
    rounds: int = 2,
) -> ForceController:
    """A regulator that is the same at every place: what it asks for is a force, and the inverse map of the machine's
    own field turns it into outputs within limits (3,) each.

    weights.output: forces, N, that count as much as the deviations. The body is taken for a free mass: neither the
    field's stiffness nor eddy currents and drag are known to it but as forces that it does not know.
    """
    mass = machine.body.mass
    A, push = np.zeros((6, 6)), np.vstack([np.zeros((3, 3)), np.eye(3) / mass])
    A[:3, 3:] = np.eye(3)
    weight = np.array([0.0, 0.0, mass * machine.body.gravity])
    free = LinearMachine(
        A,
        push,
        np.eye(3, 6),
        np.zeros((3, 3)),
        np.hstack([push, np.zeros((6, 3))]),
        ("x", "y", "z", *VELOCITIES),
        ("Fx", "Fy", "Fz"),
        ("x", "y", "z"),
        OperatingPoint(
            operating_point.state,
            operating_point.currents,
            weight,
            operating_point.sensed,
            operating_point.residual,
        ),
        (),
    )
    block = lqg_block(free, weights, period, delay)
    return ForceController(
        block, np.asarray(lower, float), np.asarray(upper, float), operating_point.outputs.copy(), rounds
    )
