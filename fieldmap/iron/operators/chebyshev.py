"""Chebyshev's iteration for several right-hand sides: a fixed, symmetric, linear map, unlike conjugate gradients, so
that it may stand inside another iteration. (Golub and Varga, Numer. Math. 3 (1961) 147; Saad, Iterative Methods for
Sparse Linear Systems, 2nd ed., algorithm 12.1.)"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigvalsh_tridiagonal

Array = NDArray[np.float64]
_LANCZOS_STEPS = 16
# The extreme eigenvalues lie a little outside those that Lanczos has found; the smallest are found last.
_BELOW, _ABOVE = 0.85, 1.05


def spectrum(apply: Callable[[Array], Array], count: int) -> tuple[float, float]:
    """Bounds of the eigenvalues of a symmetric, positive definite map of vectors (n, 1), by Lanczos from a fixed
    random start, with the margins stated above."""
    basis = np.zeros((count, _LANCZOS_STEPS))
    start = np.random.default_rng(1).standard_normal(count)
    basis[:, 0] = start / np.linalg.norm(start)
    diagonal, side = np.zeros(_LANCZOS_STEPS), np.zeros(_LANCZOS_STEPS)
    steps = min(_LANCZOS_STEPS, count)
    for k in range(steps):
        vector = apply(basis[:, k : k + 1])[:, 0]
        diagonal[k] = vector @ basis[:, k]
        for _ in range(2):
            vector = vector - basis[:, : k + 1] @ (basis[:, : k + 1].T @ vector)
        side[k] = np.linalg.norm(vector)
        if k + 1 < steps:
            basis[:, k + 1] = vector / (side[k] or 1.0)
    values = eigvalsh_tridiagonal(diagonal[:steps], side[: steps - 1])
    return _BELOW * float(values[0]), _ABOVE * float(values[-1])


def steps_needed(bounds: tuple[float, float], tolerance: float) -> int:
    """Steps after which the error has fallen to the tolerance, for eigenvalues within the bounds."""
    root = math.sqrt(bounds[1] / bounds[0])
    rate = max((root - 1) / (root + 1), 1e-3)
    return max(1, math.ceil(math.log(tolerance / 2) / math.log(rate)))


def chebyshev(
    apply: Callable[[Array], Array],
    precondition: Callable[[Array], Array],
    right: Array,
    bounds: tuple[float, float],
    steps: int,
) -> Array:
    """x (n, c) with apply(x) about right (n, c), from zero; `bounds` of the preconditioned map's eigenvalues. Needs one
    product less than steps."""
    centre, half = (bounds[1] + bounds[0]) / 2, (bounds[1] - bounds[0]) / 2
    ratio = centre / half
    rho = 1 / ratio
    residual = right
    direction = precondition(right) / centre
    x = direction
    for _ in range(steps - 1):
        residual = residual - apply(direction)
        following = 1 / (2 * ratio - rho)
        direction = following * rho * direction + (2 * following / half) * precondition(residual)
        rho = following
        x = x + direction
    return x
