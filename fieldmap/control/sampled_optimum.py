"""Optimal regulator and estimator of a continuous plant that is sampled: cost and noise are integrated between samples.

C. F. Van Loan, Computing integrals involving the matrix exponential, IEEE Trans. Automatic Control 23 (1978) 395-404:
every integral here is a block of one exponential.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from fieldmap.arguments import check_matrix, check_positive
from fieldmap.control.linear_models import check_model, zero_order_hold
from fieldmap.errors import InputError, Problem
from fieldmap.plain import Plain, plain_items
from fieldmap.records import tuple_line
from fieldmap.typing import Array


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
        """The arrays by their names, as plain Python."""
        return plain_items(**self._asdict())


def lqrd(A: ArrayLike, B: ArrayLike, Q: ArrayLike, R: ArrayLike, Ts: float) -> Array:
    """Gain k (m, n) of u[n] = -k x[n], held for Ts, that minimises the continuous cost of dx/dt = A x + B u.

    The cost is the integral of x'Q x + u'R u, also between the samples. Q (n, n) symmetric, positive
    semidefinite; R (m, m) symmetric, positive definite; Ts in s. Equivalent to the command of the same name in MATLAB.
    Raises InputError for matrices that do not fit, or a plant that cannot be stabilised.

    >>> lqrd(0.0, 1.0, 1.0, 1.0, 1e-6).round(5).tolist()  # an integrator, hardly sampled: k = sqrt(Q / R)
    [[1.0]]
    """
    A, B, _, _ = check_model("lqrd", (A, B, None, None))
    check_positive("lqrd", Ts=Ts)
    order, inputs = B.shape
    Q = _symmetric("lqrd(Q)", Q, order)
    R = _symmetric("lqrd(R)", R, inputs, definite=True)
    A_d, B_d, cost = _integrated_cost(A, B, scipy.linalg.block_diag(Q, R), Ts)
    Q_d, N_d, R_d = cost[:order, :order], cost[:order, order:], cost[order:, order:]
    P = _riccati("lqrd", A_d, B_d, Q_d, R_d, N_d)
    return np.asarray(np.linalg.solve(R_d + B_d.T @ P @ B_d, B_d.T @ P @ A_d + N_d.T), np.float64)


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
    """Kalman filter for samples, Ts apart, of dx/dt = A x + B u + G w, y = C x + D u + v with continuous white noise.

    Qn: spectral density of w; Rn: of v, so that a sample of v has the covariance Rn / Ts. G: how w enters, B unless
    given. Equivalent to MATLAB's command of the same name ("current" estimator). Raises InputError for matrices that
    do not fit, or a plant that cannot be observed.

    >>> kalmd(0.0, 1.0, 1.0, 1.0, 1.0, 1e-6).B_est.round(8).tolist()  # gain sqrt(Qn / Rn) Ts
    [[1e-06, 1e-06]]
    """
    A, B, C, D = check_model("kalmd", (A, B, C, D))
    check_positive("kalmd", Ts=Ts)
    order = A.shape[0]
    G = B if G is None else check_matrix("kalmd(G)", G, (order, None))
    Qn = _symmetric("kalmd(Qn)", Qn, G.shape[1])
    Rn = _symmetric("kalmd(Rn)", Rn, C.shape[0], definite=True)
    A_d, B_d = zero_order_hold(A, B, Ts)
    Q_d = _integrated_noise(A, G @ Qn @ G.T, Ts)
    R_d = Rn / Ts
    P = _riccati("kalmd", A_d.T, C.T, Q_d, R_d)
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


def _integrated_cost(A: Array, B: Array, weight: Array, Ts: float) -> tuple[Array, Array, Array]:
    """A_d, B_d, and the cost of one sampling interval as a form in (x, u) at its beginning."""
    order, size = A.shape[0], A.shape[0] + B.shape[1]
    both = np.zeros((size, size))
    both[:order] = np.hstack([A, B])
    grown = _doubled(-both.T, weight, both, Ts)
    transition = grown[size:, size:]
    cost = transition.T @ grown[:size, size:]
    return transition[:order, :order], transition[:order, order:], 0.5 * (cost + cost.T)


def _integrated_noise(A: Array, density: Array, Ts: float) -> Array:
    """Covariance that white noise of this density adds in one sampling interval."""
    order = A.shape[0]
    grown = _doubled(-A, density, A.T, Ts)
    covariance = grown[order:, order:].T @ grown[:order, order:]
    return 0.5 * (covariance + covariance.T)


def _doubled(upper_left: Array, upper_right: Array, lower_right: Array, Ts: float) -> Array:
    size = upper_left.shape[0]
    blocks = np.zeros((2 * size, 2 * size))
    blocks[:size] = np.hstack([upper_left, upper_right])
    blocks[size:, size:] = lower_right
    return scipy.linalg.expm(blocks * Ts)


def _riccati(where: str, A: Array, B: Array, Q: Array, R: Array, S: Array | None = None) -> Array:
    try:
        P = scipy.linalg.solve_discrete_are(A, B, Q, R, s=S)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise _no_solution(where, f"none ({error})") from None
    # The solver may return a solution that does not stabilise, where a mode is out of reach.
    cross = 0.0 if S is None else S.T
    gain = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A + cross)
    slowest = float(np.abs(np.linalg.eigvals(A - B @ gain)).max())
    if not slowest < 1.0:
        raise _no_solution(where, f"one that leaves a pole at {slowest:.6g} from the origin")
    return P


def _no_solution(where: str, received: str) -> InputError:
    return InputError(
        Problem(
            where,
            "must have a stabilising solution of its Riccati equation",
            received,
            "check that every unstable state is reached by the input (lqrd) or seen in the output (kalmd), and "
            "that the weights do not leave out a mode on the border of stability",
        )
    )


def _symmetric(where: str, values: ArrayLike, size: int, definite: bool = False) -> Array:
    matrix = check_matrix(where, values, (size, size))
    lowest = float(np.linalg.eigvalsh(0.5 * (matrix + matrix.T)).min())
    scale = float(np.abs(matrix).max())
    symmetric = np.abs(matrix - matrix.T).max() <= 1e-12 * scale
    if not symmetric or lowest < -1e-12 * scale or (definite and lowest <= 0):
        kind = "definite" if definite else "semidefinite"
        raise InputError(
            Problem(
                where,
                f"must be symmetric, positive {kind}",
                f"lowest eigenvalue {lowest:.3g}, {'' if symmetric else 'not '}symmetric",
                "choose weights that make every direction cost something",
            )
        )
    return matrix
