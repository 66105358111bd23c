"""PID controllers and regulators as they run: one call a sample, and over whole signals in open loop."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_numbers, check_signal
from fieldmap.control.blocks import AxisReading, ControllerBlock, pid_block, regulator_block
from fieldmap.control.pid import PID
from fieldmap.control.regulator import Regulator
from fieldmap.core.controller import SIGNALS, CoreController
from fieldmap.typing import Array

ALONE = AxisReading("x")
"""Of a controller that knows one position only: the position itself."""


def _signals(references: ArrayLike, measured: ArrayLike, samples: int) -> Array:
    """(samples, 7): what a block of `ALONE` listens to."""
    signals = np.zeros((samples, SIGNALS))
    signals[:, 0], signals[:, 3], signals[:, -1] = references, measured, 1.0
    return signals


def _run(
    block: ControllerBlock, where: str, reference: ArrayLike, measured: ArrayLike
) -> tuple[Array, Array]:
    """Outputs (n,), and the memory (n, states) after each sample."""
    seen = np.atleast_1d(check_signal(f"{where}(measured)", measured))
    target = np.broadcast_to(check_signal(f"{where}(reference)", reference), seen.shape)
    outputs, memories = np.empty((seen.size, 1)), np.empty((seen.size, len(block.memory)))
    signals = _signals(target, seen, seen.size)
    CoreController(block.arrays).control(signals, None, block.memory.copy(), outputs, memories)
    return outputs[:, 0], memories


class _RunningBlock:
    """A block of one position and one output with its memory (n,)."""

    def __init__(self, block: ControllerBlock) -> None:
        self.memory = block.memory.copy()
        self._core = CoreController(block.arrays)
        self._signals, self._outputs = _signals(0.0, 0.0, 1), np.empty((1, 1))

    def output(self, reference: float, measured: float) -> float:
        """At this sample; advances the memory."""
        self._signals[0, 0], self._signals[0, 3] = reference, measured
        self._core.control(self._signals, None, self.memory, self._outputs)
        return float(self._outputs[0, 0])


class RunningPID:
    """A PID controller with its memory, for a loop of your own: one call a sample.

    >>> running = RunningPID(PID(Kc=2.0, Ti=0.1, Td=0.0, Ts=0.01))
    >>> [round(running.step(reference=1.0, measured=y), 3) for y in (0.0, 0.5)]
    [2.2, 1.3]
    """

    def __init__(self, controller: PID) -> None:
        self.controller = controller
        self.reset()

    def reset(self, integral: float = 0.0) -> None:
        """Forget the past; the integral part of the output begins at `integral`."""
        check_numbers("RunningPID.reset", integral=integral)
        self._running = _RunningBlock(pid_block(self.controller, ALONE, integral))

    def step(self, reference: float, measured: float) -> float:
        """The output at this sample. Raises InputError for numbers that are not finite, before they do harm."""
        check_numbers("RunningPID.step", reference=reference, measured=measured)
        return self._running.output(reference, measured)


class RunningRegulator:
    """A regulator with its memory, for a loop of your own: one call a sample."""

    def __init__(self, regulator: Regulator) -> None:
        self.regulator = regulator
        self.reset()

    def reset(self) -> None:
        """Forget the past: all states at the equilibrium."""
        self._running = _RunningBlock(regulator_block(self.regulator, ALONE))

    @property
    def states(self) -> Array:
        """The filtered states x[n|n] of the last sample."""
        return _filtered_states(self._running.memory)

    def step(self, reference: float, measured: float) -> float:
        """The output at this sample. Raises InputError for numbers that are not finite, before they do harm."""
        check_numbers("RunningRegulator.step", reference=reference, measured=measured)
        return self._running.output(reference, measured)


def run_pid(controller: PID, reference: ArrayLike, measured: ArrayLike) -> Array:
    """Outputs (n,) of a controller that starts from rest, for given measurements (n,); open loop.

    reference: (n,) or one number. Raises InputError for signals that are not finite or of different length.

    >>> run_pid(PID(0.5, 0.007, 0.001, 2e-3), 1.0, [0.0, 0.0]).round(5).tolist()
    [0.89286, 0.78571]
    """
    return _run(pid_block(controller, ALONE), "run_pid", reference, measured)[0]


def run_regulator(regulator: Regulator, reference: ArrayLike, measured: ArrayLike) -> tuple[Array, Array]:
    """Outputs (n,) and filtered states (n, order) of a regulator that starts at the equilibrium; open loop.

    measured: (n,); reference: (n,) or one number. Raises InputError for signals that are not finite or do not fit.
    """
    outputs, memories = _run(regulator_block(regulator, ALONE), "run_regulator", reference, measured)
    return outputs, _filtered_states(memories)


def _filtered_states(memory: Array) -> Array:
    """Those of the last sample, of a memory (..., 2 n + 1) as `regulator_block` lays it out."""
    n = memory.shape[-1] // 2
    return memory[..., n : 2 * n].copy()
