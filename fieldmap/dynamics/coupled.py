"""Controllers of all axes at once: linear-quadratic-Gaussian regulators on physical states, scheduled over the
height; feedback linearisation; feed-forward along a trajectory by the inverse map: docs/theory/closed_loop.md
(14)..(22)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from fieldmap.arguments import check, check_positive
from fieldmap.control import zero_order_hold
from fieldmap.control.blocks import Controller, ControllerBlock, arrays_of, state_block
from fieldmap.control.regulator import riccati
from fieldmap.core.controller import SIGNALS, Block, CoreController
from fieldmap.core.machine import VELOCITY, InverseMap, inverse_along
from fieldmap.dynamics.closed_loop import Schedule
from fieldmap.dynamics.linear_loop import sampled_machine, shares_of_the_past
from fieldmap.dynamics.linearisation import ABOUT_Z, VELOCITIES, LinearMachine
from fieldmap.dynamics.machine import Machine, Sensors
from fieldmap.dynamics.operating_point import OperatingPoint
from fieldmap.dynamics.rigid_body import Three
from fieldmap.errors import Infeasible
from fieldmap.inputs.declared import Key, check_fields
from fieldmap.inputs.tables import Positive
from fieldmap.records import Record
from fieldmap.typing import Array

Lengths = Annotated[list[Positive], Field(min_length=3, max_length=3)]
"""Rule for a key with three positive numbers, for x, y and depth."""
_HEIGHT = 2  # index of the reference's height among the signals of a block
_ROUNDS = 20


@dataclass(frozen=True, repr=False)
class LqgWeights(Record):
    """Weights and noise for which a regulator and its estimator are designed; x, y and z of the map.

    place (m), speed (m/s), output: deviations of position, velocity and outputs with equal cost (Bryson's rule); lean
    (rad), angular_velocity (rad/s): the same for a body that turns. sensor: standard deviation of the readings, m; by
    default 1 um. force: noise of the force on the body, N per root of Hz; drift: of the unknown force, N per root of
    a second.
    """

    place: Annotated[
        Three, Key(Lengths, "deviations of x, y, depth that count alike", "mm", name="allowed")
    ] = (0.3e-3, 0.3e-3, 0.3e-3)
    speed: Annotated[Three, Key(Lengths, "velocities that count as much", "mm_per_s", name="allowed")] = (
        10e-3,
        10e-3,
        30e-3,
    )
    output: Annotated[
        tuple[float, ...],
        Key(list[Positive], "deviations of the outputs that count as much", name="allowed_outputs"),
    ] = (1.0, 0.1, 0.1)
    sensor: Annotated[
        Three | None,
        Key(
            Lengths | None,
            "deviation of the readings of x, y and depth; by default from [sensors]",
            "mm",
            name="noise",
        ),
    ] = None
    force: Annotated[
        Three, Key(Lengths, "noise of the force on the body, per root of Hz", "mN", name="shaking")
    ] = (0.02e-3, 0.02e-3, 0.1e-3)
    drift: Annotated[Three, Key(Lengths, "drift of the unknown force, per root of s", "mN")] = (
        0.5e-3,
        0.5e-3,
        2e-3,
    )
    lean: float = 0.2
    angular_velocity: float = 50.0

    def __post_init__(self) -> None:
        check_fields(self)
        check_positive("LqgWeights", lean=self.lean, angular_velocity=self.angular_velocity)


def lqg_block(
    linear: LinearMachine,
    weights: LqgWeights,
    period: float,
    delay: float = 0.0,
    limits: tuple[Array, Array] | None = None,
    shown: Array | None = None,
) -> ControllerBlock:
    """A regulator on estimated states and forces, designed for one linear machine, the delay of its outputs and the lag
    of its sensors.

    Memory: states except angle and angular velocity about z, positions in the map's frame; unknown force (3), N; the
    last outputs; the sensed point at the last samples, m, if sensors show it late. The regulator holds the sensed point
    at its reference without offset under any constant force.

    Parameters
    ----------
    linear
        The machine; the memory begins at its operating point.
    weights
        Deviations with equal cost, and noise.
    period, delay
        s.
    limits
        Lowest and highest outputs (m,); the estimator predicts with the limited outputs.
    shown
        Shares of past positions in the readings (k, 3, 3), from `shares_of_the_past`; by default only the present.

    Returns
    -------
    ControllerBlock
        The block.

    Raises
    ------
    InputError
        For a machine that is not controllable or not observable, for example if nothing lifts the body.
    """
    felt = linear.only(tuple(name for name in linear.states if name not in ABOUT_Z))
    m, given = felt.B.shape[1], len(weights.output)
    must = f"must have one number for each of {m} outputs"
    check(given == m, "LqgWeights(output)", must, given, "give lift, x and y")
    model = _Model(felt, period, delay, np.eye(3)[None] if shown is None else shown)
    return _block(model, felt, _gain(model, felt, weights), _taken(model, felt, weights), limits)


def lag_in_model(sensors: Sensors, period: float) -> Array:
    """Argument `shown` of `lqg_block` for sensors with a latency.

    Averages of scans are neglected, because they would add states for each sample.

    Parameters
    ----------
    sensors
        The sensors.
    period
        Control period, s.

    Returns
    -------
    Array
        Shares (k, 3, 3), as from `shares_of_the_past`.
    """
    return shares_of_the_past(sensors, period) if max(sensors.means) == 1 else np.eye(3)[None]


class _Model:
    """X+ = F X + S u + f, y = H X + h with X = states, unknown force (3), last outputs (m), and the sensed point at
    the last samples, all as absolute values."""

    def __init__(self, linear: LinearMachine, period: float, delay: float, shown: Array) -> None:
        sampled = sampled_machine(linear, period, delay)
        n, m = linear.B.shape
        self.n, self.m, self.period = n, m, period
        # Indices of all but the unknown force and the past, and of all but the last outputs.
        first, late = n + 3 + m, 3 * (len(shown) - 1)
        size = first + late
        self.known = [*range(n), *range(n + 3, first)]
        self.estimated = [*range(n + 3), *range(first, size)]
        pushed = zero_order_hold(linear.A, linear.G[:, :3], period)[1]
        self.F = np.eye(size, k=-3)
        self.F[: first + min(late, 3)] = 0.0
        self.F[:n, :first] = np.hstack([sampled.A, pushed, sampled.before])
        self.F[n : n + 3, n : n + 3] = np.eye(3)
        self.F[first : first + 3, :n] = linear.C[:late]
        self.S = np.vstack([sampled.B, np.zeros((3, m)), np.eye(m), np.zeros((late, m))])
        self.place, self.outputs = linear.at_rest, linear.operating_point.outputs
        self.H = np.hstack([shown[0] @ linear.C, np.zeros((3, 3 + m)), *shown[1:]])
        sensed = linear.operating_point.sensed
        constant = sensed - linear.C @ self.place
        self.f = np.zeros(size)
        self.f[:n] = self.place - sampled.A @ self.place - (sampled.B + sampled.before) @ self.outputs
        self.f[first : first + 3] = constant[:late]
        self.h = shown[0] @ constant
        past = np.tile(sensed, len(shown) - 1)
        self.operating_point = np.concatenate([self.place, np.zeros(3), self.outputs, past])


def _gain(model: _Model, linear: LinearMachine, weights: LqgWeights) -> Array:
    """Gain (m, n + m) on deviations of states and last outputs; minimises the sum of (deviation / weight)^2."""
    n, m = model.n, model.m
    A, B = model.F[np.ix_(model.known, model.known)], model.S[model.known]
    alike = dict(zip(VELOCITIES, weights.speed, strict=True))
    alike |= {f"turn_{axis}": weights.lean for axis in "xy"}
    alike |= {f"angular_velocity_{axis}": weights.angular_velocity for axis in "xy"}
    Q = np.zeros((n + m, n + m))
    Q[:n, :n] = linear.C.T @ np.diag(1.0 / np.square(weights.place)) @ linear.C
    Q[:n, :n] += np.diag([1.0 / alike.get(name, np.inf) ** 2 for name in linear.states])
    R = np.diag(1.0 / np.square(np.array(weights.output)))
    return _riccati(A, B, model.period * Q, model.period * R, "controllable by its outputs")[1]


def _taken(model: _Model, linear: LinearMachine, weights: LqgWeights) -> Array:
    """Gain (size of X, 3) by which the measurement corrects the prediction."""
    n, at = model.n, model.estimated
    A, C = model.F[np.ix_(at, at)], model.H[:, at]
    shaken = linear.G[:, :3] * np.asarray(weights.force)
    noise = np.zeros_like(A)
    noise[:n, :n] = shaken @ shaken.T
    noise[n : n + 3, n : n + 3] = np.diag(np.square(weights.drift))
    R = np.diag(np.square(weights.sensor or (1e-6,) * 3))
    P = _riccati(A.T, C.T, model.period * noise, R, "observable by its sensors")[0]
    taken = np.zeros((len(model.F), 3))
    taken[at] = np.linalg.solve(C @ P @ C.T + R, C @ P).T
    return taken


def _riccati(A: Array, B: Array, Q: Array, R: Array, what: str) -> tuple[Array, Array]:
    must = f"every mode that is not damped must be {what}"
    remedy = "`fieldmap linearise` shows the modes; a little drag damps what swings without end"
    return riccati("lqg_block(linear)", A, B, Q, R, None, must, remedy)


def _block(
    model: _Model, linear: LinearMachine, gain: Array, taken: Array, limits: tuple[Array, Array] | None
) -> ControllerBlock:
    n, m = model.n, model.m
    # Steady deviations of states and outputs per metre of the reference, and per newton of an unknown force.
    both = np.block([[linear.A, linear.B], [linear.C, np.zeros((3, m))]])
    asked = np.block([[np.zeros((n, 3)), -linear.G[:, :3]], [np.eye(3), np.zeros((3, 3))]])
    by_reference, by_force = np.hsplit(np.linalg.lstsq(both, asked, rcond=None)[0], 2)
    # u = u0 + U_r (r - y0) + U_d d - K (deviation from the steady states for reference and force), (18).
    from_reference = by_reference[n:] + gain @ by_reference
    size = len(model.F)
    states = np.hstack(
        [-gain[:, :n], by_force[n:] + gain @ by_force, -gain[:, n:], np.zeros((m, size - n - 3 - m))]
    )
    constant = (
        model.outputs
        - from_reference @ linear.operating_point.sensed
        + gain @ model.operating_point[model.known]
    )
    left = np.eye(size) - taken @ model.H
    B, D = np.zeros((size, SIGNALS)), np.zeros((m, SIGNALS))
    D[:, :3], D[:, 3:6] = from_reference, states @ taken
    D[:, 6] = constant - states @ taken @ model.h
    B[:, 3:6], B[:, 6] = model.F @ taken, model.f - model.F @ taken @ model.h
    low, high = limits if limits is not None else (-np.inf, np.inf)
    memory = model.operating_point.copy()
    block = state_block(model.F @ left, B, states @ left, D, model.S, low, high, memory)
    return replace(block, F=model.S)


@dataclass(frozen=True, eq=False, repr=False)
class ScheduledController(Record):
    """Blocks for equally spaced heights of the reference (z of the map, m), from `first` by `step`, with linear
    interpolation. Beyond the heights the nearest block acts. The memories of all blocks must have the same meaning. A
    run uses the limits of the first block."""

    blocks: tuple[ControllerBlock, ...]
    first: float
    step: float

    def __post_init__(self) -> None:
        check_positive("ScheduledController", step=self.step, blocks=len(self.blocks))
        shapes = {(block.A.shape, block.D.shape) for block in self.blocks}
        where, must = "ScheduledController(blocks)", "must have as many states and outputs each"
        check(len(shapes) == 1, where, must, shapes, "design them alike")

    @property
    def outputs(self) -> int:
        """Number of outputs."""
        return self.blocks[0].outputs

    @property
    def memory(self) -> Array:
        """Memory of the first block (n,)."""
        return self.blocks[0].memory

    @property
    def arrays(self) -> Block:
        """As compiled loops take it."""
        return arrays_of(self.blocks, (self.first, self.step, float(_HEIGHT)))

    def inverse(self, state: Array) -> None:
        """None: the outputs go directly to the allocation.

        Parameters
        ----------
        state
            State (13,) where the run begins.
        """

    def at(self, sensed: Array, stiffness: ArrayLike, per_output: ArrayLike) -> ControllerBlock:
        """The block interpolated to the height of the sensed point.

        Parameters
        ----------
        sensed, stiffness, per_output
            As for `fieldmap.control.blocks.Controller.at`.

        Returns
        -------
        ControllerBlock
            The block.
        """
        count = len(self.blocks)
        place = float(np.clip((sensed[_HEIGHT] - self.first) / self.step, 0, count - 1))
        low = min(int(place), max(count - 2, 0))
        a, b, share = self.blocks[low], self.blocks[min(low + 1, count - 1)], place - low

        def between(name: str) -> Array:
            return (1.0 - share) * getattr(a, name) + share * getattr(b, name)

        A, B, C, D, E, F = (between(name) for name in (*"ABCDE", "feedforward"))
        return replace(a, A=A, B=B, C=C, D=D, E=E, F=F)


@dataclass(frozen=True, eq=False, repr=False)
class ForceController(Record):
    """A controller whose outputs are the wanted force on the magnet (3), N. At every sample the inverse map turns it,
    for the measured position, into signals for the machine's allocation.

    block: the controller of the force. lower, upper (3,): limits of the signals; signals (3,): their values at the
    start. rounds: steps of Newton's method per sample. The inverse map keeps the body's orientation at the start.
    """

    block: ControllerBlock
    lower: Array
    upper: Array
    signals: Array
    rounds: int = 2

    @property
    def outputs(self) -> int:
        """Number of outputs: three, of force."""
        return self.block.outputs

    @property
    def memory(self) -> Array:
        """Memory of the block (n,)."""
        return self.block.memory

    @property
    def arrays(self) -> Block:
        """As compiled loops take it."""
        return self.block.arrays

    def inverse(self, state: Array) -> InverseMap:
        """The inverse map for a run. The run adds the machine.

        Parameters
        ----------
        state
            State (13,) where the run begins.

        Returns
        -------
        InverseMap
            The inverse map.
        """
        limits = np.array([self.lower, self.upper], float)
        return InverseMap(None, self.rounds, limits, np.array(self.signals, float), np.array(state, float))

    def at(self, sensed: Array, stiffness: ArrayLike, per_output: ArrayLike) -> ControllerBlock:
        """The block from measurement to signals about an operating point, without constants: (dF/du)^-1 (F + K y).

        Parameters
        ----------
        sensed, stiffness, per_output
            As for `fieldmap.control.blocks.Controller.at`.

        Returns
        -------
        ControllerBlock
            The block.
        """
        block, inverse = self.block, np.linalg.inv(np.asarray(per_output, float))
        D = inverse @ block.D
        D[:, 3:6] += inverse @ np.asarray(stiffness, float)
        # The estimator uses the wanted forces, even if the limits of the signals reduce the actual ones.
        A, B = block.A + block.E @ block.C, block.B + block.E @ block.D
        return state_block(A, B, inverse @ block.C, D, None, self.lower, self.upper, block.memory)


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
    """A regulator of the force, which is the same at every position.

    The inverse map of the machine's own field turns the force into signals. The regulator is designed for a free mass.
    Eddy currents, drag, and the field's stiffness between samples act on it as unknown forces.

    Parameters
    ----------
    machine
        The machine with the field of the inverse map.
    operating_point
        Operating point at the start.
    weights
        Weights; `output` holds the forces, N, with the same cost as the deviations.
    period, delay
        s.
    lower, upper
        Limits of the signals (3,).
    rounds
        Steps of Newton's method per sample.

    Returns
    -------
    ForceController
        The controller.
    """
    mass = machine.body.mass
    A, push = np.zeros((6, 6)), np.vstack([np.zeros((3, 3)), np.eye(3) / mass])
    A[:3, 3:] = np.eye(3)
    weight = np.array([0.0, 0.0, mass * machine.body.gravity])
    axes = ("x", "y", "z")
    free = LinearMachine(
        A,
        B=push,
        C=np.eye(3, 6),
        D=np.zeros((3, 3)),
        G=np.hstack([push, np.zeros((6, 3))]),
        states=(*axes, *VELOCITIES),
        inputs=("Fx", "Fy", "Fz"),
        outputs=axes,
        at_rest=np.concatenate([operating_point.state[:3], np.zeros(3)]),
        operating_point=replace(operating_point, outputs=weight),
        assumptions=(),
    )
    block = lqg_block(free, weights, period, delay, shown=lag_in_model(machine.sensors, period))
    limits = np.asarray(lower, float), np.asarray(upper, float)
    return ForceController(block, *limits, operating_point.outputs.copy(), rounds)


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(Record):
    """Forces and outputs for a reference, one row per control period. forces (p, 3): on the magnet, N; outputs (p,
    3): for the allocation, which give these forces; left (p,): missing force because of the outputs' limits, N."""

    forces: Array
    outputs: Array
    left: Array


def trajectory(
    machine: Machine,
    operating_point: OperatingPoint,
    schedule: Schedule,
    lower: Array,
    upper: Array,
    fastest: float = 0.05,
    largest: float = 3.0,
) -> Trajectory:
    """Forces and outputs along the references of a schedule.

    The force is mass times acceleration, plus the force that carries the weight, plus the forces that overcome drag
    and eddy currents at the reference's velocity. The inverse map at the reference's position gives the outputs for
    this force. Each row is computed for the middle of the time in which its outputs act. The body keeps the
    orientation of the operating point.

    Parameters
    ----------
    machine
        The machine; its allocation takes three outputs.
    operating_point
        Operating point at the start.
    schedule
        The references.
    lower, upper
        Limits of the outputs (3,).
    fastest
        Speed, m/s, above which a change of the reference is a step without feed-forward.
    largest
        Largest acceleration that is fed forward, m/s^2.

    Returns
    -------
    Trajectory
        Forces and outputs of every sample.

    Raises
    ------
    Infeasible
        If the path leaves the map.
    InputError
        For a machine whose allocation does not take three outputs.
    """
    period = schedule.period
    time = period * np.arange(len(schedule.references))
    middle = time + schedule.delay + 0.5 * period
    path = np.column_stack([np.interp(middle, time, column) for column in schedule.references.T])
    velocity, acceleration = _motion(path, period, fastest, largest)
    arm = operating_point.sensed - operating_point.state[:3]
    body = machine.body
    core = machine.core(1.0)
    forces = body.mass * acceleration
    forces[:, 2] += body.mass * body.gravity
    state = operating_point.state.copy()
    for row in np.flatnonzero(np.abs(velocity).max(axis=1)):
        state[:3], state[VELOCITY : VELOCITY + 3] = path[row] - arm, velocity[row]
        forces[row] -= core.losses(state)[0]
    outputs, left = outputs_for(machine, operating_point, path - arm, forces, lower, upper)
    return Trajectory(forces, outputs, left)


def outputs_for(
    machine: Machine,
    operating_point: OperatingPoint,
    positions: Array,
    forces: Array,
    lower: Array,
    upper: Array,
) -> tuple[Array, Array]:
    """The inverse map: outputs that give forces on the magnet of a body.

    The search begins at the outputs of the operating point and goes from row to row.

    Parameters
    ----------
    machine
        The machine; its allocation takes three outputs.
    operating_point
        Operating point whose orientation the body keeps.
    positions
        Positions of the body (p, 3), m.
    forces
        Forces on the magnet (p, 3), N.
    lower, upper
        Limits of the outputs (3,).

    Returns
    -------
    tuple[Array, Array]
        Outputs (p, 3), and the missing force (p,), N.

    Raises
    ------
    Infeasible
        For positions outside the map.
    InputError
        For an allocation that does not take three outputs.
    """
    m, remedy = len(operating_point.outputs), "take an allocation of three"
    check(m == 3, "outputs_for(machine)", "must have three outputs", m, remedy)
    found, left = np.empty((len(positions), 3)), np.empty(len(positions))
    core = machine.core(1.0, search=True)
    begin, limits = operating_point, np.array([lower, upper], float)
    inverse = InverseMap(core.machine, _ROUNDS, limits, begin.outputs.copy(), begin.state.copy())
    numbers = machine.allocation.numbers()
    places, wanted = np.ascontiguousarray(positions, float), np.ascontiguousarray(forces, float)
    inverse_along(inverse, numbers, places, wanted, found, left)
    outside = positions[np.isnan(left)]
    if len(outside):
        where, received = "outputs_for(positions)", f"{outside[0].tolist()} m"
        raise Infeasible.of(where, "must lie in the map", received, "shorten the path")
    return found, left


def feedforward(controller: Controller, schedule: Schedule, path: Trajectory) -> Array:
    """Feed-forward with which a controller gives the outputs of the trajectory while the body is on the path.

    It is the outputs of the trajectory (for a `ForceController`, its forces) minus the outputs of the controller
    alone.

    Parameters
    ----------
    controller
        The controller.
    schedule
        The references.
    path
        Result of `trajectory`.

    Returns
    -------
    Array
        Feed-forward (p, m).
    """
    wanted = path.forces if isinstance(controller, ForceController) else path.outputs
    added = np.empty_like(wanted)
    references = schedule.references
    CoreController(controller.arrays).quiet_feedforward(
        references, np.ascontiguousarray(wanted), controller.memory.copy(), added
    )
    return added


def _motion(path: Array, period: float, fastest: float, largest: float) -> tuple[Array, Array]:
    """Velocity and acceleration (p, 3) of a path; 0 at steps, with accelerations limited to the largest."""
    if len(path) < 3:
        return np.zeros_like(path), np.zeros_like(path)
    velocity = np.gradient(path, period, axis=0)
    acceleration = np.zeros_like(path)
    acceleration[1:-1] = (path[2:] - 2.0 * path[1:-1] + path[:-2]) / period**2
    steps = np.abs(velocity).max(axis=1) > fastest
    steps[1:-1] |= steps[2:] | steps[:-2]
    velocity[steps], acceleration[steps] = 0.0, 0.0
    return velocity, np.clip(acceleration, -largest, largest)
