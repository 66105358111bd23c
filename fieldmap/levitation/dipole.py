"""Force on a point dipole and its derivative, from B and its first two gradients
(docs/theory/equilibrium.md)."""

import numpy as np

from fieldmap.typing import Array


def dipole_force(moment: Array, gradient: Array) -> Array:
    """F_k = m_i dB_i/dx_k, N: (2-9) of the thesis, for a field without currents at the dipole.

    moment (..., 3) in A m^2, gradient (..., 3, 3) in T/m. The same law serves a fixed moment and one that
    follows the field: a turning moment does no first-order work when it is parallel to B.

    >>> import numpy as np
    >>> dipole_force(np.array([0.0, 0.0, 2.0]), np.diag([-0.5, -0.5, 1.0])).tolist()
    [0.0, 0.0, 2.0]
    """
    return np.einsum("...i,...ik->...k", moment, gradient)


def dipole_stiffness(moment: Array, second_gradient: Array) -> Array:
    """K_kl = -dF_k/dx_l = -m_i d2B_i/dx_k dx_l, N/m, for a moment that keeps its direction.

    moment (..., 3) in A m^2, second_gradient (..., 3, 3, 3) in T/m^2. Trace-free wherever B is harmonic
    (Earnshaw): a fixed dipole is never stable in all three directions.
    """
    return -np.einsum("...i,...ikl->...kl", moment, second_gradient)


def aligned_stiffness(magnitude: float, field: Array, gradient: Array, second_gradient: Array) -> Array:
    """Stiffness K_kl = -dF_k/dx_l, N/m, of a dipole of constant magnitude that stays parallel to B.

    F = m grad |B|. The turning adds -m/|B| (G^T G - (G^T b)(G^T b)^T) with b = B/|B|, whose trace is never
    positive: an aligned dipole is at least as unstable as a fixed one. field (3,), gradient (3, 3),
    second_gradient (3, 3, 3). Singular where B = 0.
    """
    norm = float(np.linalg.norm(field))
    direction = field / norm
    along = direction @ gradient
    turning = (gradient.T @ gradient - np.outer(along, along)) / norm
    return dipole_stiffness(magnitude * direction, second_gradient) - magnitude * turning
