"""Force and torque on point dipoles from field and gradient."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.errors import InputError, Problem
from fieldmap.lookup.checks import checked_vectors

Array = NDArray[np.float64]


def dipole_wrench(flux: Array, slope: Array, moments: ArrayLike) -> Array:
    """(n, 6): force (N) and torque (N m) on moments (3,) or (n, 3), A m^2, in flux (n, 3) and slope (n, 3, 3).

    T = m x B, thesis eq. (2-7), and F = grad(m . B) = (grad B)^T m, which is (m . grad) B of eq. (2-8) where B is
    curl-free, and is conservative for a fixed moment even if the interpolant is not quite so.
    """
    dipoles, _ = checked_vectors("moments", moments)
    if len(dipoles) not in (1, len(flux)):
        received = f"{len(dipoles)} moments for {len(flux)} positions"
        problem = Problem("lookup, moments", "one for all positions or one each", received, "match them")
        raise InputError(problem)
    dipoles = np.broadcast_to(dipoles, flux.shape)
    force = np.einsum("nij,ni->nj", slope, dipoles)
    return np.concatenate([force, np.cross(dipoles, flux)], axis=1)
