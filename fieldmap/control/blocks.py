"""What a closed loop asks of a controller, and controllers of any kind as one linear block: docs/theory/dynamics.md
(29).

    u = C xi + D v + f      s = u within its limits      xi <- A xi + B v + E (s - f) + F f

v (7,) = reference (3), measured position (3), 1; positions in m in the frame of the map. The loop of a linear plant
(`simulate_loop`) and that of a magnet on a map (`fieldmap.dynamics.simulate_closed_loop`) take the same controllers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from fieldmap.arguments import check_choice, check_matrix, check_numbers, check_ordered, check_signal
from fieldmap.control.pid import PID
from fieldmap.control.regulator import Regulator
from fieldmap.core.controller import SIGNALS, Block
from fieldmap.errors import InputError, Problem
from fieldmap.records import Record
from fieldmap.typing import Array

AXES = ("x", "y", "z")


@dataclass(frozen=True, repr=False)
class AxisReading(Record):
    """What a controller of one axis calls its position: factor * (coordinate in m) + offset.

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
        return self._row(0)

    @property
    def measured(self) -> Array:
        """(7,): the position's reading = this @ v."""
        return self._row(3)

    def _row(self, first: int) -> Array:
        row = np.zeros(SIGNALS)
        row[first + AXES.index(self.axis)], row[-1] = self.factor, self.offset
        return row


class Controller(Protocol):
    """What a compiled loop asks of a controller: one block, several over the height, or one whose outputs are
    forces."""

    @property
    def outputs(self) -> int:
        """Number of outputs."""

    @property
    def memory(self) -> Array:
        """(n,): what it starts with."""

    @property
    def arrays(self) -> Block:
        """As compiled loops take it."""

    def inverse(self, state: Array) -> Any:
        """None for a controller whose outputs go to the coils as they are; for one whose outputs are forces the
        `fieldmap.core.machine.InverseMap` of a run that begins at a state (13,), without its machine."""

    def at(self, sensed: Array, stiffness: ArrayLike, per_output: ArrayLike) -> ControllerBlock:
        """The one block, from what is seen to outputs, that it is about an operating point. sensed (3,), m: the sensed
        point there; stiffness (3, 3), N/m: minus the slope of the magnet's force by its place, per_output (3, m): by
        the outputs."""


@dataclass(frozen=True, eq=False, repr=False)
class ControllerBlock(Record):
    """A (n, n), B (n, 7), C (m, n), D (m, 7), E (n, m); lower, upper (m,): limits of the outputs; hold (n,): number of
    the output for an integral that stops at its limit, -1 elsewhere; memory (n,): what it starts with. F (n, m) or
    None for nothing: how a feed-forward enters the memory, E for an observer that is told what the machine is."""

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
    def arrays(self) -> Block:
        """As compiled loops take it."""
        return arrays_of((self,), (0.0, 1.0, 0.0))

    def inverse(self, state: Array) -> None:
        """None: the outputs go to the coils as they are."""

    def at(self, sensed: Array, stiffness: ArrayLike, per_output: ArrayLike) -> ControllerBlock:
        """Itself, everywhere."""
        return self


def arrays_of(blocks: Sequence[ControllerBlock], nodes: tuple[float, float, float]) -> Block:
    """Blocks at equal steps of a signal as compiled loops take them; limits and what holds are those of the first."""
    first = blocks[0]

    def stack(name: str) -> Array:
        return np.stack([np.ascontiguousarray(getattr(block, name), float) for block in blocks])

    forward = np.stack([np.zeros_like(block.E) if block.F is None else block.F for block in blocks])
    return Block(
        A=stack("A"),
        B=stack("B"),
        C=stack("C"),
        D=stack("D"),
        E=stack("E"),
        F=np.ascontiguousarray(forward, float),
        lower=np.ascontiguousarray(first.lower, float),
        upper=np.ascontiguousarray(first.upper, float),
        hold=np.ascontiguousarray(first.hold, np.int64),
        nodes=np.array(nodes),
    )


def pid_block(
    controller: PID, reading: AxisReading, output: float = 0.0, at: ArrayLike | None = None
) -> ControllerBlock:
    """A PID controller of one axis. It starts with this output where reference and position are `at` (7,), or
    with nothing before its first sample: docs/theory/control.md (1).

    >>> block = pid_block(PID(2.0, 0.1, 0.0, 0.01), AxisReading("x", 1e3))
    >>> block.D[0, [0, 3]].tolist()
    [2200.0, -2200.0]
    """
    kp, ki, kd = controller.gains
    error = controller.sign * (reading.reference - reading.measured)
    slope = error if controller.derivative == "error" else -controller.sign * reading.measured
    now, before = (0.5, 0.5) if controller.integration == "trapezoidal" else (1.0, 0.0)
    # Memory: integral, previous error, previous value of what is differentiated.
    C = np.array([[1.0, ki * before, -kd]])
    D = ((kp + ki * now) * error + kd * slope)[None]
    A, B, E = np.zeros((3, 3)), np.zeros((3, SIGNALS)), np.zeros((3, 1))
    A[0, :2], B[0], B[1], B[2] = (1.0, ki * before), ki * now * error, error, slope
    if controller.anti_windup == "track":
        share = controller.tracking
        A[0], B[0], E[0, 0] = A[0] - share * C[0], B[0] - share * D[0], share
    memory = np.zeros(3)
    if at is not None:
        there = check_signal("pid_block(at)", at, columns=SIGNALS)
        memory[:] = output - kp * (error @ there), error @ there, slope @ there
    else:
        memory[0] = output
    hold = np.array([0 if controller.anti_windup == "hold" else -1, -1, -1])
    limits = np.array([controller.lower]), np.array([controller.upper])
    return ControllerBlock(A, B, C, D, E, *limits, hold, memory)


def regulator_block(regulator: Regulator, reading: AxisReading) -> ControllerBlock:
    """A regulator with its estimator on one axis, from its equilibrium: docs/theory/control.md (8), (9)."""
    a, b, cx, dx = regulator.matrices
    n = len(a)
    reference, measured = reading.reference, reading.measured
    deviation = measured - reference
    intercept, slope = regulator.equilibrium
    equilibrium = slope * (measured if regulator.equilibrium_at == "measured" else reference)
    equilibrium[-1] += intercept
    # Memory: predicted states, delayed filtered states, integral.
    filtered = np.hstack([cx, np.zeros((n, n + 1))])
    states, direct = {
        "predicted": (np.eye(n, 2 * n + 1), np.zeros(n)),
        "filtered": (filtered, dx),
        "delayed": (np.eye(n, 2 * n + 1, n), np.zeros(n)),
    }[regulator.estimate]
    gain, divisor = regulator.k, regulator.divisor
    C = -(gain[:n] @ states)[None] / divisor
    C[0, -1] -= gain[n] / divisor
    D = (equilibrium - (gain[:n] @ direct) * deviation / divisor)[None]
    A, B, E = np.zeros((2 * n + 1, 2 * n + 1)), np.zeros((2 * n + 1, SIGNALS)), np.zeros((2 * n + 1, 1))
    A[:n, :n], E[:n, 0] = a, b[:, 0]
    B[:n] = np.outer(b[:, 1], deviation) - np.outer(b[:, 0], equilibrium)
    A[n : 2 * n], B[n : 2 * n] = filtered, np.outer(dx, deviation)
    A[-1, -1], B[-1] = 1.0, regulator.Ts * deviation
    limits = np.array([regulator.lower]), np.array([regulator.upper])
    return ControllerBlock(A, B, C, D, E, *limits, np.full(2 * n + 1, -1), np.zeros(2 * n + 1))


def constant_block(output: float) -> ControllerBlock:
    """An output that does not listen: an axis in open loop."""
    check_numbers("constant_block", output=output)
    D = np.zeros((1, SIGNALS))
    D[0, -1] = output
    none = np.zeros((0, 0))
    limits = np.array([-np.inf]), np.array([np.inf])
    return ControllerBlock(
        none,
        np.zeros((0, SIGNALS)),
        np.zeros((1, 0)),
        D,
        np.zeros((0, 1)),
        *limits,
        np.zeros(0, int),
        np.zeros(0),
    )


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
    """Any linear controller of several axes: matrices as in the head of this file, D (m, 7) first of all.

    lower, upper: limits, one for all outputs or (m,). Raises InputError for matrices that do not fit.
    """
    direct = check_matrix("state_block(D)", D, (None, SIGNALS))
    m = len(direct)
    inner = np.asarray(A, float).reshape(-1, np.shape(A)[-1]) if np.size(A) else np.zeros((0, 0))
    n = len(inner)
    parts = [
        np.asarray(given, float).reshape(shape) if np.size(given) == np.prod(shape) else None
        for given, shape in ((B, (n, SIGNALS)), (C, (m, n)), (np.zeros((n, m)) if E is None else E, (n, m)))
    ]
    if inner.shape != (n, n) or any(part is None for part in parts):
        must = f"must fit {n} states, {SIGNALS} signals and {m} outputs"
        raise InputError(
            Problem("state_block(A, B, C, E)", must, "other shapes", "see fieldmap.control.blocks")
        )
    low, high = (np.broadcast_to(np.asarray(limit, float), (m,)).copy() for limit in (lower, upper))
    for a, b in zip(low, high, strict=True):
        check_ordered("state_block", float(a), float(b))
    start = np.zeros(n) if memory is None else np.asarray(memory, float)
    inputs, out, applied = (np.asarray(part) for part in parts)
    return ControllerBlock(inner, inputs, out, direct, applied, low, high, np.full(n, -1), start)


def stacked(*blocks: ControllerBlock) -> ControllerBlock:
    """Blocks side by side: their outputs one after the other."""
    first = np.cumsum([0, *[block.outputs for block in blocks[:-1]]])
    hold = [np.where(block.hold >= 0, block.hold + at, -1) for block, at in zip(blocks, first, strict=True)]
    return ControllerBlock(
        scipy.linalg.block_diag(*[block.A for block in blocks]),
        np.vstack([block.B for block in blocks]),
        scipy.linalg.block_diag(*[block.C for block in blocks]),
        np.vstack([block.D for block in blocks]),
        scipy.linalg.block_diag(*[block.E for block in blocks]),
        np.concatenate([block.lower for block in blocks]),
        np.concatenate([block.upper for block in blocks]),
        np.concatenate(hold),
        np.concatenate([block.memory for block in blocks]),
        scipy.linalg.block_diag(
            *[np.zeros_like(block.E) if block.F is None else block.F for block in blocks]
        ),
    )
