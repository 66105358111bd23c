"""The interface of controllers to closed loops, and controllers of any kind as one linear block:
docs/theory/closed_loop.md (5).

    u = C xi + D v + f      s = u within its limits      xi <- A xi + B v + E (s - f) + F f

v (7,) = reference (3), measured position (3), 1; positions in m in the frame of the map. The loop of a linear plant
(`simulate_loop`) and the loop of a magnet on a map (`fieldmap.dynamics.simulate_closed_loop`) take the same
controllers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from fieldmap.arguments import check, check_choice, check_matrix, check_numbers, check_ordered, check_signal
from fieldmap.core.controller import SIGNALS, Block, CoreController
from fieldmap.records import Record
from fieldmap.typing import Array

AXES = ("x", "y", "z")


@dataclass(frozen=True, repr=False)
class AxisReading(Record):
    """The position that a controller of one axis reads: factor * (coordinate in m) + offset.

    x in mm is AxisReading("x", 1e3); a depth in mm from 50 mm below the origin on is AxisReading("z", -1e3, -50.0).
    """

    axis: str
    factor: float = 1.0
    offset: float = 0.0

    def __post_init__(self) -> None:
        check_choice("AxisReading(axis)", self.axis, AXES)
        check_numbers("AxisReading", factor=self.factor, offset=self.offset)

    @property
    def reference(self) -> Array:
        """(7,): the reference's reading = this @ v."""
        row = np.zeros(SIGNALS)
        row[AXES.index(self.axis)], row[-1] = self.factor, self.offset
        return row

    @property
    def measured(self) -> Array:
        """(7,): the position's reading = this @ v."""
        reference = self.reference
        return np.concatenate([reference[3:6], reference[:3], reference[6:]])


class Controller(Protocol):
    """The interface of a controller to compiled loops. It is one block, several blocks over the height, or a controller
    of forces."""

    @property
    def outputs(self) -> int:
        """Number of outputs."""

    @property
    def memory(self) -> Array:
        """State (n,) at the start."""

    @property
    def arrays(self) -> Block:
        """The arrays for compiled loops."""

    def inverse(self, state: Array) -> Any:
        """The inverse map of a controller of forces.

        Parameters
        ----------
        state
            State (13,) at the start of the run.

        Returns
        -------
        Any
            A `fieldmap.core.machine.InverseMap` without the run's machine; None for a controller whose
            outputs go directly to the allocation.
        """

    def at(self, sensed: Array, stiffness: ArrayLike, per_output: ArrayLike) -> ControllerBlock:
        """The linear block of the controller about an operating point, from signals to outputs.

        Parameters
        ----------
        sensed
            The sensed point there (3,), m.
        stiffness
            Minus the derivative of the magnet's force by its position (3, 3), N/m.
        per_output
            Derivative of the magnet's force by the outputs (3, m).

        Returns
        -------
        ControllerBlock
            The block.
        """


@dataclass(frozen=True, eq=False, repr=False)
class ControllerBlock(Record):
    """A (n, n), B (n, 7), C (m, n), D (m, 7), E (n, m); lower, upper (m,): limits of the outputs; hold (n,): for an
    integral that stops at the limit of an output, the number of this output, -1 elsewhere; memory (n,): state at the
    start. F (n, m): gain of a feed-forward to the state, None for zeros; E for an observer of the whole output."""

    A: Array
    B: Array
    C: Array
    D: Array
    E: Array
    lower: Array
    upper: Array
    hold: NDArray[np.int64]
    memory: Array
    F: Array | None = None

    @property
    def outputs(self) -> int:
        """Number of outputs."""
        return len(self.D)

    @property
    def feedforward(self) -> Array:
        """F, zeros for None."""
        return np.zeros_like(self.E) if self.F is None else self.F

    @property
    def arrays(self) -> Block:
        """The arrays for compiled loops."""
        return arrays_of((self,), (0.0, 1.0, 0.0))

    def inverse(self, state: Array) -> None:
        """None, since the outputs go directly to the allocation.

        Parameters
        ----------
        state
            State (13,) at the start of the run.
        """

    def at(self, sensed: Array, stiffness: ArrayLike, per_output: ArrayLike) -> ControllerBlock:
        """The block itself, at every operating point.

        Parameters
        ----------
        sensed, stiffness, per_output
            As for `Controller.at`.

        Returns
        -------
        ControllerBlock
            The block.
        """
        return self


def arrays_of(blocks: Sequence[ControllerBlock], nodes: tuple[float, float, float]) -> Block:
    """The arrays for compiled loops of blocks at equal steps of a signal.

    Parameters
    ----------
    blocks
        The blocks; limits and `hold` are those of the first.
    nodes
        As in `Block`.

    Returns
    -------
    Block
        The arrays.
    """

    def joined(name: str) -> Array:
        return np.ascontiguousarray(np.stack([getattr(block, name) for block in blocks]), float)

    first = blocks[0]
    return Block(
        **{name: joined(name) for name in "ABCDE"},
        F=joined("feedforward"),
        lower=np.ascontiguousarray(first.lower, float),
        upper=np.ascontiguousarray(first.upper, float),
        hold=np.ascontiguousarray(first.hold, np.int64),
        nodes=np.array(nodes),
    )


def constant_block(output: float) -> ControllerBlock:
    """A constant output, for an axis in open loop.

    Parameters
    ----------
    output
        The output.

    Returns
    -------
    ControllerBlock
        The block.
    """
    check_numbers("constant_block", output=output)
    return state_block((), (), (), [[0.0] * (SIGNALS - 1) + [output]])


def state_block(
    A: ArrayLike,
    B: ArrayLike,
    C: ArrayLike,
    D: ArrayLike,
    E: ArrayLike | None = None,
    lower: ArrayLike = -np.inf,
    upper: ArrayLike = np.inf,
    memory: ArrayLike | None = None,
) -> ControllerBlock:
    """Any linear controller of several axes, by the matrices of this module's equation.

    Parameters
    ----------
    A, B, C, D, E
        Matrices; D is (m, 7).
    lower, upper
        Limits of the outputs, one for all or (m,).
    memory
        State (n,) at the start; zeros unless given.

    Returns
    -------
    ControllerBlock
        The block.

    Raises
    ------
    InputError
        For matrices that do not fit.
    """
    direct = check_matrix("state_block(D)", D, (None, SIGNALS))
    m, n = len(direct), len(np.atleast_2d(A)) if np.size(A) else 0
    shapes = {"A": (n, n), "B": (n, SIGNALS), "C": (m, n), "E": (n, m)}
    given = {"A": A, "B": B, "C": C, "E": np.zeros((n, m)) if E is None else E}
    fits = all(np.size(given[name]) == np.prod(shape) for name, shape in shapes.items())
    must = f"must fit {n} states, {SIGNALS} signals and {m} outputs"
    check(fits, "state_block(A, B, C, E)", must, "other shapes", "see fieldmap.control.blocks")
    parts = {name: np.asarray(given[name], float).reshape(shape) for name, shape in shapes.items()}
    low, high = (np.broadcast_to(np.asarray(limit, float), (m,)).copy() for limit in (lower, upper))
    for a, b in zip(low, high, strict=True):
        check_ordered("state_block", float(a), float(b))
    start = np.zeros(n) if memory is None else np.asarray(memory, float)
    return ControllerBlock(**parts, D=direct, lower=low, upper=high, hold=np.full(n, -1), memory=start)


def stacked(*blocks: ControllerBlock) -> ControllerBlock:
    """One block of several in parallel, with their outputs one after the other.

    Parameters
    ----------
    *blocks
        The blocks.

    Returns
    -------
    ControllerBlock
        The one block.
    """

    def of_each(name: str) -> list[Array]:
        return [getattr(block, name) for block in blocks]

    first = np.cumsum([0, *[block.outputs for block in blocks[:-1]]])
    hold = [np.where(block.hold >= 0, block.hold + at, -1) for block, at in zip(blocks, first, strict=True)]
    return ControllerBlock(
        **{name: scipy.linalg.block_diag(*of_each(name)) for name in "ACE"},
        **{name: np.vstack(of_each(name)) for name in "BD"},
        **{name: np.concatenate(of_each(name)) for name in ("lower", "upper", "memory")},
        hold=np.concatenate(hold),
        F=scipy.linalg.block_diag(*of_each("feedforward")),
    )


ALONE = AxisReading("x")
"""Reading of a controller of a single position: the position itself."""


class RunningBlock:
    """A block of one position and one output with its memory, called once per sample."""

    def _start(self, block: ControllerBlock) -> None:
        """Begin with the memory of a block."""
        self.memory, self._core = block.memory.copy(), CoreController(block.arrays)
        self._signals, self._output = _signals(0.0, 0.0, 1), np.empty((1, 1))

    def step(self, reference: float, measured: float) -> float:
        """The output at this sample.

        Parameters
        ----------
        reference
            The reference.
        measured
            The measurement.

        Returns
        -------
        float
            The output.

        Raises
        ------
        InputError
            For numbers that are not finite; the memory is then unchanged.
        """
        check_numbers(f"{type(self).__name__}.step", reference=reference, measured=measured)
        self._signals[0, 0], self._signals[0, 3] = reference, measured
        self._core.control(self._signals, None, self.memory, self._output)
        return float(self._output[0, 0])


def run_block(
    block: ControllerBlock, where: str, reference: ArrayLike, measured: ArrayLike
) -> tuple[Array, Array]:
    """Run a block in open loop.

    Parameters
    ----------
    block
        The block.
    where
        Name of the caller, for messages.
    reference
        (n,) or one number.
    measured
        Measurements (n,).

    Returns
    -------
    tuple[Array, Array]
        Outputs (n,), and the memory (n, states) after each sample.

    Raises
    ------
    InputError
        For signals that are not finite or do not fit.
    """
    seen = np.atleast_1d(check_signal(f"{where}(measured)", measured))
    target = np.broadcast_to(check_signal(f"{where}(reference)", reference), seen.shape)
    outputs, memories = np.empty((seen.size, 1)), np.empty((seen.size, len(block.memory)))
    signals = _signals(target, seen, seen.size)
    CoreController(block.arrays).control(signals, None, block.memory.copy(), outputs, memories)
    return outputs[:, 0], memories


def _signals(reference: ArrayLike, measured: ArrayLike, samples: int) -> Array:
    """Signals (samples, 7) of a block that reads `ALONE`."""
    signals = np.zeros((samples, SIGNALS))
    signals[:, 0], signals[:, 3], signals[:, -1] = reference, measured, 1.0
    return signals
