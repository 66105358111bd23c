"""Linear-quadratic-Gaussian control of all axes at once, on physical states: docs/theory/dynamics.md (39)..(43)."""

from dataclasses import dataclass

import numpy as np
import scipy

from fieldmap.arguments import check_positive, check_signal
from fieldmap.control import zero_order_hold
from fieldmap.control.blocks import ControllerBlock
from fieldmap.core.controller import SIGNALS
from fieldmap.dynamics.linearisation import ABOUT_Z, LinearMachine, sampled_machine
from fieldmap.errors import InputError, Problem
from fieldmap.records import Record
from fieldmap.typing import Array

Three = tuple[float, float, float]


@dataclass(frozen=True, repr=False)
class LqgWeights(Record):
    """What a regulator and its estimator are designed for; x, y and z of the map.

    place, m, speed, m/s: deviations that count alike (Bryson's rule), and output: those of the outputs that count as
    much. sensor: standard deviation of what is seen, m. force: of what shakes the body, N per root of Hz; drift: of the
    forces that are not known, N per root of a second. lean, rad, angular_velocity, rad/s: of a body that turns.
    """

    place: Three
    speed: Three
    output: tuple[float, ...]
    sensor: Three
    force: Three
    drift: Three
    lean: float = 0.2
    angular_velocity: float = 50.0

    def __post_init__(self) -> None:
        for name, values in vars(self).items():
            given = np.atleast_1d(check_signal(f"LqgWeights({name})", np.atleast_1d(values)))
            check_positive("LqgWeights", **{f"{name}[{k}]": float(value) for k, value in enumerate(given)})


def lqg_block(
    linear: LinearMachine,
    weights: LqgWeights,
    period: float,
    delay: float = 0.0,
    limits: tuple[Array, Array] | None = None,
) -> ControllerBlock:
    """A regulator on estimated states and forces, designed for one linear machine and told the delay of its outputs.

    Memory: states of the machine, positions as they are in the map; unknown force (3), N; the outputs of the last
    sample. It holds the sensed point at its reference without offset, whatever constant force pulls. The operating
    point of the linear machine is where its memory begins. limits: lowest and highest outputs, which the estimator is
    told of. Raises InputError for a machine that is not controllable or not observable, as upward where nothing lifts.
    """
    felt = linear.only(tuple(name for name in linear.states if name not in ABOUT_Z))
    m = felt.B.shape[1]
    if len(weights.output) != m:
        must = f"must have one number for each of {m} outputs"
        problem = Problem("LqgWeights(output)", must, f"{len(weights.output)}", "give lift, x and y")
        raise InputError(problem)
    model = _Model(felt, period, delay)
    gain = _regulator(model, felt, weights, period)
    taken = _estimator(model, felt, weights, period)
    return _block(model, felt, gain, taken, limits)


class _Model:
    """X+ = F X + S u + f, y = H X + h with X = states, unknown force (3), last outputs (m), all as they are."""

    def __init__(self, linear: LinearMachine, period: float, delay: float) -> None:
        sampled = sampled_machine(linear, period, delay)
        n, m = linear.B.shape
        self.n, self.m = n, m
        pushed = zero_order_hold(linear.A, linear.G[:, :3], period)[1]
        self.F = np.zeros((n + 3 + m, n + 3 + m))
        self.F[:n] = np.hstack([sampled.A, pushed, sampled.before])
        self.F[n : n + 3, n : n + 3] = np.eye(3)
        self.S = np.vstack([sampled.B, np.zeros((3, m)), np.eye(m)])
        self.place, self.outputs = np.zeros(n), linear.operating_point.outputs
        self.place[:3] = linear.operating_point.state[:3]
        self.H = np.hstack([linear.C, np.zeros((3, 3 + m))])
        self.f = np.zeros(n + 3 + m)
        self.f[:n] = self.place - sampled.A @ self.place - (sampled.B + sampled.before) @ self.outputs
        self.h = linear.operating_point.sensed - linear.C @ self.place
        self.operating_point = np.concatenate([self.place, np.zeros(3), self.outputs])


def _regulator(model: _Model, linear: LinearMachine, weights: LqgWeights, period: float) -> Array:
    """Gain (m, n + m) on deviations of states and last outputs, which minimises the sum of squares over weights."""
    n, m = model.n, model.m
    known = [*range(n), *range(n + 3, n + 3 + m)]
    A, B = model.F[np.ix_(known, known)], model.S[known]
    Q = np.zeros((n + m, n + m))
    seen = linear.C.T @ np.diag(1.0 / np.square(weights.place)) @ linear.C
    Q[:n, :n] = seen + np.diag([_cost(name, weights) for name in linear.states])
    R = period * np.diag(1.0 / np.square(np.array(weights.output)))
    P = _riccati(A, B, period * Q, R, "controllable by its outputs")
    return np.asarray(np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A), float)


def _cost(name: str, weights: LqgWeights) -> float:
    quantity, _, axis = name.rpartition("_")
    if quantity == "velocity":
        return 1.0 / weights.speed["xyz".index(axis)] ** 2
    return {"turn": 1.0 / weights.lean**2, "angular_velocity": 1.0 / weights.angular_velocity**2}.get(
        quantity, 0.0
    )


def _estimator(model: _Model, linear: LinearMachine, weights: LqgWeights, period: float) -> Array:
    """Gain (n + 3 + m, 3) by which what is seen corrects the prediction."""
    n = model.n
    A, C = model.F[: n + 3, : n + 3], model.H[:, : n + 3]
    shaken = np.vstack([linear.G[:, :3], np.zeros((3, 3))]) * np.asarray(weights.force)
    noise = period * shaken @ shaken.T
    noise[n:, n:] = period * np.diag(np.square(weights.drift))
    R = np.diag(np.square(weights.sensor))
    P = _riccati(A.T, C.T, noise, R, "observable by its sensors")
    taken = np.linalg.solve(C @ P @ C.T + R, C @ P).T
    return np.vstack([taken, np.zeros((model.m, 3))])


def _riccati(A: Array, B: Array, Q: Array, R: Array, what: str) -> Array:
    try:
        return np.asarray(scipy.linalg.solve_discrete_are(A, B, Q, R))
    except (np.linalg.LinAlgError, ValueError) as error:
        must = f"every mode that is not damped must be {what}"
        remedy = "`fieldmap linearise` shows the modes; a little drag damps what swings without end"
        problem = Problem("lqg_block(linear)", must, f"{error}", remedy)
        raise InputError(problem) from None


def _targets(model: _Model, linear: LinearMachine) -> tuple[Array, Array]:
    """(n + m, 3) each: steady deviations of states and outputs per metre of the reference, and per newton of an
    unknown force with the sensed point held."""
    n, m = model.n, model.m
    both = np.block([[linear.A, linear.B], [linear.C, np.zeros((3, m))]])
    by_reference = np.linalg.lstsq(both, np.vstack([np.zeros((n, 3)), np.eye(3)]), rcond=None)[0]
    by_force = np.linalg.lstsq(both, np.vstack([-linear.G[:, :3], np.zeros((3, 3))]), rcond=None)[0]
    return by_reference, by_force


def _block(
    model: _Model, linear: LinearMachine, gain: Array, taken: Array, limits: tuple[Array, Array] | None
) -> ControllerBlock:
    n, m = model.n, model.m
    by_reference, by_force = _targets(model, linear)
    # u = u0 + U_r (r - y0) + U_d d - K (deviation from the states that reference and force ask for), (42).
    from_reference = by_reference[n:] + gain @ by_reference
    states = np.hstack([-gain[:, :n], by_force[n:] + gain @ by_force, -gain[:, n:]])
    constant = (
        model.outputs
        - from_reference @ linear.operating_point.sensed
        + gain @ model.operating_point[[*range(n), *range(n + 3, n + 3 + m)]]
    )
    left = np.eye(n + 3 + m) - taken @ model.H
    B, D = np.zeros((n + 3 + m, SIGNALS)), np.zeros((m, SIGNALS))
    D[:, :3], D[:, 3:6] = from_reference, states @ taken
    D[:, 6] = constant - states @ taken @ model.h
    B[:, 3:6], B[:, 6] = model.F @ taken, model.f - model.F @ taken @ model.h
    low, high = limits if limits is not None else (np.full(m, -np.inf), np.full(m, np.inf))
    return ControllerBlock(
        model.F @ left,
        B,
        states @ left,
        D,
        model.S,
        np.asarray(low, float),
        np.asarray(high, float),
        np.full(n + 3 + m, -1),
        model.operating_point.copy(),
        model.S,
    )
