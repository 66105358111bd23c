"""GMRES for several right-hand sides.

One application of the operator serves every column. Each column keeps its own Arnoldi basis (Saad and
Schultz, SIAM J. Sci. Stat. Comput. 7 (1986) 856); the columns only share the products, which are what costs.
"""

from collections.abc import Callable

import numpy as np

from fieldmap.errors import NotConverged, Problem
from fieldmap.typing import Array


def block_gmres(
    apply: Callable[[Array], Array], right: Array, tolerance: float, max_iterations: int
) -> tuple[Array, list[Array]]:
    """Solve apply(x) = right for right (n, c). Returns x (n, c) and the residual norms (c,) after each step,
    relative to those of the right-hand side. `apply` should be preconditioned."""
    c = right.shape[1]
    norm = np.linalg.norm(right, axis=0)
    safe = np.where(norm > 0, norm, 1.0)
    basis = [right / safe]
    hessenberg = np.zeros((c, max_iterations + 1, max_iterations))
    history: list[Array] = []
    start = np.zeros((c, max_iterations + 1))
    start[:, 0] = 1.0
    coefficients = np.zeros((c, 0))
    for k in range(max_iterations):
        vector = apply(basis[k])
        # Twice, because once loses orthogonality when the columns converge at different steps.
        for _ in range(2):
            for j in range(k + 1):
                overlap = np.einsum("ij,ij->j", basis[j], vector)
                hessenberg[:, j, k] += overlap
                vector = vector - basis[j] * overlap
        length = np.linalg.norm(vector, axis=0)
        hessenberg[:, k + 1, k] = length
        basis.append(np.divide(vector, length, out=np.zeros_like(vector), where=length > 1e-14))
        small, target = hessenberg[:, : k + 2, : k + 1], start[:, : k + 2]
        coefficients = np.stack([np.linalg.lstsq(small[i], target[i], rcond=None)[0] for i in range(c)])
        residual = np.linalg.norm(np.einsum("cij,cj->ci", small, coefficients) - target, axis=1)
        history.append(residual * (norm > 0))
        if (history[-1] < tolerance).all():
            break
    x = sum(basis[j] * coefficients[:, j] for j in range(coefficients.shape[1]))
    return np.asarray(x) * norm, history


def require_convergence(what: str, residuals: tuple[float, ...], tolerance: float) -> None:
    """Raise NotConverged, with the history, unless the last residual is within the tolerance."""
    if residuals and residuals[-1] <= tolerance:
        return
    last = f"{residuals[-1]:.2e} after {len(residuals)} steps" if residuals else "no step"
    raise NotConverged(
        Problem(
            f"iron solver, {what}",
            f"the residual must fall to {tolerance:g}",
            last,
            "loosen the tolerance, or look for slivers: bodies that nearly touch, very thin parts",
        ),
        residuals=residuals,
    )
