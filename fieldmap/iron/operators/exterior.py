"""The air as an operator on the iron's surface.

The potential phi of the iron's own field is continuous; outside it is harmonic and decays. A layer of charge q on
the surface faces makes it: W q = m, the means of phi over the faces. The layer's charge is the sum of the normal
derivatives on both sides, so that the flux that leaves through the faces into the air is

    x = W^-1 m - N^-1 m,      m = M phi,      N = M K^-1 M^T,

where N^-1 m is the flux into the iron, were it air, of the smoothest second-order potential with these face means
(K: the iron's stiffness at mu_r = 1). Both terms see phi through its face means only, so what they do not see costs
nothing, and S = M^T (W^-1 - N^-1) M is positive up to the discretisation error: the whole functional stays convex
however saturated the iron is. (With the plain Schur complement of K in place of N^-1, modes that W does not resolve
would be negative, and Newton's method fails beyond 2.4 T.)
"""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bmat, csr_matrix, identity
from scipy.sparse.linalg import SuperLU, splu

from fieldmap.iron.operators.mutual import MutualPotential

Array = NDArray[np.float64]


# The air problem with given face means is a saddle point; this fraction of the smallest mean potential of a face on
# itself makes it quasi-definite, so that it can be factored without pivoting (Vanderbei, SIAM J. Optim. 5 (1995)).
_REGULARISATION = 1e-8


def factored(matrix: csr_matrix) -> SuperLU:
    """Sparse factor of a symmetric, definite or quasi-definite matrix."""
    return splu(
        matrix.tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )


class Exterior:
    """S for one mesh. face_mean (s, n): M; vacuum (n, n): the iron's stiffness matrix at mu_r = 1."""

    def __init__(self, face_mean: csr_matrix, mutual: MutualPotential, vacuum: csr_matrix) -> None:
        self._mean = face_mean
        self._mutual = mutual
        self._count = face_mean.shape[1]
        small = _REGULARISATION * mutual.diagonal.min()
        self._vacuum = factored(
            bmat([[vacuum, self._mean.T], [self._mean, -small * identity(self._mean.shape[0])]])
        )

    def charge(self, potential: Array, refinements: int = 2) -> Array:
        """Charges (s, c) of the surface faces for nodal potentials (n, c)."""
        return self._mutual.solve(self._mean @ potential, refinements)

    def apply(self, potential: Array, refinements: int = 2) -> Array:
        """S phi (n, c) for phi (n, c); `refinements` of the inverse of W, see `MutualPotential.solve`."""
        return self._mean.T @ self.flux(self._mean @ potential, refinements)

    def flux(self, means: Array, refinements: int = 2) -> Array:
        """Flux (s, c) that leaves through the surface faces into the air for mean potentials (s, c)."""
        right = np.zeros((self._count + len(means), means.shape[1]))
        right[self._count :] = means
        inward = -self._vacuum.solve(right)[self._count :]
        return self._mutual.solve(means, refinements) - inward
