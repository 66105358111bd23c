"""The optimal regulator of a sampled plant: gains of feedback and estimator, and the controller that runs both with an
integrator and the output that carries the weight.

Cost and noise of the continuous plant are integrated between samples: C. F. Van Loan, Computing integrals involving the
matrix exponential, IEEE Trans. Automatic Control 23 (1978) 395-404; every integral here is a block of one exponential.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from fieldmap import arguments
from fieldmap.control.blocks import ALONE, AxisReading, ControllerBlock, RunningBlock, run_block
from fieldmap.control.linear_models import check_model, zero_order_hold
from fieldmap.core.controller import SIGNALS
from fieldmap.errors import InputError
from fieldmap.plain import Plain, plain_items
from fieldmap.records import Record, tuple_line
from fieldmap.typing import Array

ESTIMATES = ("predicted", "filtered", "delayed")
EQUILIBRIUM_AT = ("reference", "measured")


class Estimator(NamedTuple):
    """A sampled Kalman filter as a system with the inputs (u, y) and the outputs (filtered y, filtered x).

    x[n+1|n] = A_est x[n|n-1] + B_est (u[n], y[n]); (y[n|n], x[n|n]) = C_est x[n|n-1] + D_est (u[n], y[n]):
    docs/theory/control.md (8).
    """

    A_est: Array
    B_est: Array
    C_est: Array
    D_est: Array

    def __repr__(self) -> str:
        return tuple_line(self)

    def to_dict(self) -> dict[str, Plain]:
        """The values by their names, as plain Python."""
        return plain_items(**self._asdict())


def lqrd(A: ArrayLike, B: ArrayLike, Q: ArrayLike, R: ArrayLike, Ts: float) -> Array:
    """Gain of the sampled state feedback that minimises the continuous cost of dx/dt = A x + B u.

    The cost is the integral of x'Q x + u'R u, also between the samples. Equivalent to the command of the same name in
    MATLAB.

    Parameters
    ----------
    A, B
        The plant, (n, n) and (n, m).
    Q
        Weight of the states (n, n), symmetric, positive semidefinite.
    R
        Weight of the inputs (m, m), symmetric, positive definite.
    Ts
        Sampling time, s.

    Returns
    -------
    Array
        k (m, n) of u[n] = -k x[n], held for Ts.

    Raises
    ------
    InputError
        For matrices that do not fit, or a plant that cannot be stabilised.

    Examples
    --------
    >>> lqrd(0.0, 1.0, 1.0, 1.0, 1e-6).round(5).tolist()  # an integrator, hardly sampled: k = sqrt(Q / R)
    [[1.0]]
    """
    A, B, _, _ = check_model("lqrd", (A, B, None, None))
    arguments.check_positive("lqrd", Ts=Ts)
    order, inputs = B.shape
    Q = _symmetric("lqrd(Q)", Q, order)
    R = _symmetric("lqrd(R)", R, inputs, definite=True)
    both = np.block([[A, B], [np.zeros((inputs, order + inputs))]])
    # The cost of one sampling interval is a form in (x, u) at its beginning.
    transition, cost = _integral(both, scipy.linalg.block_diag(Q, R), Ts)
    A_d, B_d = transition[:order, :order], transition[:order, order:]
    Q_d, N_d, R_d = cost[:order, :order], cost[:order, order:], cost[order:, order:]
    return riccati("lqrd", A_d, B_d, Q_d, R_d, N_d)[1]


def kalmd(
    A: ArrayLike,
    B: ArrayLike,
    C: ArrayLike,
    Qn: ArrayLike,
    Rn: ArrayLike,
    Ts: float,
    *,
    D: ArrayLike | None = None,
    G: ArrayLike | None = None,
) -> Estimator:
    """Kalman filter for samples of dx/dt = A x + B u + G w, y = C x + D u + v with continuous white noise.

    Equivalent to MATLAB's command of the same name ("current" estimator).

    Parameters
    ----------
    A, B, C
        The plant, (n, n), (n, m) and (p, n).
    Qn
        Spectral density of w.
    Rn
        Spectral density of v, so that a sample of v has the covariance Rn / Ts.
    Ts
        Sampling time, s.
    D
        Direct gain (p, m); none unless given.
    G
        Input matrix of w, (n, k); B unless given.

    Returns
    -------
    Estimator
        The sampled filter.

    Raises
    ------
    InputError
        For matrices that do not fit, or a plant that cannot be observed.

    Examples
    --------
    >>> kalmd(0.0, 1.0, 1.0, 1.0, 1.0, 1e-6).B_est.round(8).tolist()  # gain sqrt(Qn / Rn) Ts
    [[1e-06, 1e-06]]
    """
    A, B, C, D = check_model("kalmd", (A, B, C, D))
    arguments.check_positive("kalmd", Ts=Ts)
    order = A.shape[0]
    G = B if G is None else arguments.check_matrix("kalmd(G)", G, (order, None))
    Qn = _symmetric("kalmd(Qn)", Qn, G.shape[1])
    Rn = _symmetric("kalmd(Rn)", Rn, C.shape[0], definite=True)
    A_d, B_d = zero_order_hold(A, B, Ts)
    Q_d = _integral(A.T, G @ Qn @ G.T, Ts)[1]
    R_d = Rn / Ts
    P, _ = riccati("kalmd", A_d.T, C.T, Q_d, R_d)
    M = np.linalg.solve(C @ P @ C.T + R_d, C @ P).T
    L = A_d @ M
    kept = np.eye(order) - M @ C
    seen = np.eye(C.shape[0]) - C @ M
    return Estimator(
        A_est=A_d - L @ C,
        B_est=np.hstack([B_d - L @ D, L]),
        C_est=np.vstack([C @ kept, kept]),
        D_est=np.vstack([np.hstack([seen @ D, C @ M]), np.hstack([-M @ D, M])]),
    )


def _integral(A: Array, weight: Array, Ts: float) -> tuple[Array, Array]:
    """exp(A Ts), and the integral of exp(A' t) weight exp(A t) over a sampling interval."""
    size = len(A)
    grown = scipy.linalg.expm(np.block([[-A.T, weight], [np.zeros((size, size)), A]]) * Ts)
    transition = grown[size:, size:]
    integral = transition.T @ grown[:size, size:]
    return transition, 0.5 * (integral + integral.T)


def riccati(
    where: str,
    A: Array,
    B: Array,
    Q: Array,
    R: Array,
    S: Array | None = None,
    must: str = "must have a stabilising solution of its Riccati equation",
    remedy: str = "check that every unstable state is reached by the input (lqrd) or seen in the output (kalmd), and "
    "that the weights do not leave out a mode on the border of stability",
) -> tuple[Array, Array]:
    """The solution of the discrete Riccati equation, and the gain of the feedback that follows from it."""
    failures = (np.linalg.LinAlgError, ValueError)
    # In units of R: a weight of 1e-11, such as a sensor's noise in m^2, hinders the ordering of the modes.
    unit = float(np.abs(R).max())
    weights = Q / unit, R / unit, None if S is None else S / unit
    try:
        try:
            P = unit * scipy.linalg.solve_discrete_are(A, B, *weights[:2], s=weights[2])
        except failures:
            # Balancing makes most problems easier to order, and a few harder.
            P = unit * scipy.linalg.solve_discrete_are(A, B, *weights[:2], s=weights[2], balanced=False)
    except failures as error:
        raise InputError.of(where, must, f"none ({error})", remedy) from None
    # If the input cannot reach a mode, the solver may return a solution that does not stabilise.
    cross = 0.0 if S is None else S.T
    gain = np.asarray(np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A + cross), np.float64)
    slowest = float(np.abs(np.linalg.eigvals(A - B @ gain)).max())
    arguments.check(
        slowest < 1.0, where, must, f"one that leaves a pole at {slowest:.6g} from the origin", remedy
    )
    return P, gain


def _symmetric(where: str, values: ArrayLike, size: int, definite: bool = False) -> Array:
    matrix = arguments.check_matrix(where, values, (size, size))
    lowest = float(np.linalg.eigvalsh(0.5 * (matrix + matrix.T)).min())
    scale = float(np.abs(matrix).max())
    symmetric = bool(np.abs(matrix - matrix.T).max() <= 1e-12 * scale)
    positive = lowest > 0 if definite else lowest >= -1e-12 * scale
    must = f"must be symmetric, positive {'definite' if definite else 'semidefinite'}"
    received = f"lowest eigenvalue {lowest:.3g}, {'' if symmetric else 'not '}symmetric"
    remedy = "choose weights that make every direction cost something"
    arguments.check(symmetric and positive, where, must, received, remedy)
    return matrix


@dataclass(frozen=True, eq=False, repr=False)
class Regulator(Record):
    """u[n] = equilibrium output - k (x1, x2, ..., x_integral) / divisor: docs/theory/control.md (8), (9).

    k (n + 1,): gains of the n states of the estimator, then of the integral of the deviation from the reference.
    estimator: from `kalmd`, one input and one output; its inputs are deviations from the equilibrium. Ts: sampling
    time, s. equilibrium: (intercept, slope) of the output that holds the body at a position. equilibrium_at: at which
    position this output is taken, "reference" or "measured". estimate: which states are fed back: "predicted"
    x[n|n-1], "filtered" x[n|n], "delayed" x[n-1|n-1]. divisor: of the feedback. lower, upper: limits of the output.
    """

    k: Array
    estimator: Estimator
    Ts: float
    equilibrium: tuple[float, float] = (0.0, 0.0)
    equilibrium_at: str = "reference"
    estimate: str = "filtered"
    divisor: float = 1.0
    lower: float = -np.inf
    upper: float = np.inf

    def __post_init__(self) -> None:
        order = np.atleast_2d(self.estimator.A_est).shape[0]
        shapes = ((order, order), (order, 2), (1 + order, order), (1 + order, 2))
        for name, matrix, shape in zip(Estimator._fields, self.estimator, shapes, strict=True):
            arguments.check_matrix(f"Regulator(estimator.{name})", matrix, shape)
        gain = np.ravel(arguments.check_signal("Regulator(k)", self.k))
        must = f"must have one gain for each of {order} states and one for the integral"
        remedy = "design it with lqrd on with_output_integral(A, B, C); give 0 for no integral"
        arguments.check(gain.size == order + 1, "Regulator(k)", must, f"{gain.size} gains", remedy)
        must = "must not need this sample's output to know this sample's states (D = 0)"
        received, direct = "a first column of D_est that is not zero", np.any(self.estimator.D_est[:, 0])
        arguments.check(not direct, "Regulator(estimator)", must, received, "take a strictly proper plant")
        object.__setattr__(self, "k", gain)
        arguments.check_positive("Regulator", Ts=self.Ts)
        intercept, slope = self.equilibrium
        arguments.check_numbers("Regulator", intercept=intercept, slope=slope, divisor=self.divisor)
        arguments.check_ordered("Regulator", self.lower, self.upper)
        arguments.check_choice("Regulator(estimate)", self.estimate, ESTIMATES)
        arguments.check_choice("Regulator(equilibrium_at)", self.equilibrium_at, EQUILIBRIUM_AT)
        arguments.check(self.divisor != 0, "Regulator(divisor)", "must not be 0", "0", "give 1 for none")


def regulator_block(regulator: Regulator, reading: AxisReading) -> ControllerBlock:
    """A regulator with its estimator on one axis, starting at its equilibrium: docs/theory/control.md (8), (9).

    Parameters
    ----------
    regulator
        The regulator.
    reading
        Its reading of the axis.

    Returns
    -------
    ControllerBlock
        The block.
    """
    # Inputs of the estimator: control, then output. a, b predict the states; cx, dx give the filtered states.
    a, b, c, d = (np.asarray(matrix, float) for matrix in regulator.estimator)
    cx, dx, n = c[1:], d[1:, 1], len(a)
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


class RunningRegulator(RunningBlock):
    """A regulator with its memory, for a loop of your own: call `step` once per sample."""

    def __init__(self, regulator: Regulator) -> None:
        self.regulator = regulator
        self.reset()

    def reset(self) -> None:
        """Set all states back to the equilibrium."""
        self._start(regulator_block(self.regulator, ALONE))

    @property
    def states(self) -> Array:
        """The filtered states x[n|n] of the last sample."""
        return _filtered_states(self.memory)


def run_regulator(regulator: Regulator, reference: ArrayLike, measured: ArrayLike) -> tuple[Array, Array]:
    """Run a regulator from its equilibrium for given measurements, in open loop.

    Parameters
    ----------
    regulator
        The regulator.
    reference
        References (n,), or one number.
    measured
        Measurements (n,).

    Returns
    -------
    tuple[Array, Array]
        Outputs (n,), and filtered states (n, order).

    Raises
    ------
    InputError
        For signals that are not finite or do not fit.
    """
    outputs, memories = run_block(regulator_block(regulator, ALONE), "run_regulator", reference, measured)
    return outputs, _filtered_states(memories)


def _filtered_states(memory: Array) -> Array:
    """The filtered states of the last sample in memories (..., 2 n + 1) of `regulator_block`."""
    n = memory.shape[-1] // 2
    return memory[..., n : 2 * n].copy()
