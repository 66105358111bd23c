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

N^-1 m = y is found by the method of multipliers (Hestenes, J. Optim. Theory Appl. 4 (1969) 303): with a weight D,

    (K + M^T D M) phi = M^T (D m + y),      y <- y + D (m - M phi),

in two steps from zero. The matrix has the pattern of K and is positive definite; the saddle point of K and M, solved
at once, took a factor of more than three times the memory and eighteen times the work at 73 000 faces.
"""

import numpy as np
from scipy.sparse import csr_matrix, diags

from fieldmap.iron.operators.element_sums import ElementSums
from fieldmap.iron.operators.mutual import MutualPotential
from fieldmap.typing import Array

# The weight D times the mean potential of a face on itself. Each step gains three digits or more (measured: 5e-4 and
# 4e-7 for random face means, 2e-5 and 8e-9 for smooth ones); rounding takes away five of the sixteen.
_WEIGHT = 1e5
_STEPS = 2


class Exterior:
    """S for one mesh. face_mean (s, n): M; vacuum: entries of the iron's stiffness matrix at mu_r = 1, in `sums`."""

    def __init__(
        self, face_mean: csr_matrix, mutual: MutualPotential, sums: ElementSums, vacuum: Array
    ) -> None:
        self._mean = face_mean
        self._mutual = mutual
        self._weight = (_WEIGHT / mutual.diagonal)[:, None]
        mass = face_mean.T @ diags(self._weight[:, 0]) @ face_mean
        self._vacuum = sums.factor(vacuum + sums.entries_of(mass))

    def charge(self, potential: Array, refinements: int = 2) -> Array:
        """Charges (s, c) of the surface faces for nodal potentials (n, c)."""
        return self._mutual.solve(self._mean @ potential, refinements)

    def apply(self, potential: Array, refinements: int = 1) -> Array:
        """S phi (n, c) for phi (n, c); `refinements` of the inverse of W, see `MutualPotential.solve`."""
        return self._mean.T @ self.flux(self._mean @ potential, refinements)

    def apply_roughly(self, potential: Array) -> Array:
        """S phi (n, c) for phi (n, c) to three digits, at a third of the cost: a fixed, symmetric map."""
        means = self._mean @ potential
        return self._mean.T @ (self._mutual.solve(means) - self._inward(means, 1))

    def flux(self, means: Array, refinements: int = 2) -> Array:
        """Flux (s, c) that leaves through the surface faces into the air for mean potentials (s, c)."""
        return self._mutual.solve(means, refinements) - self._inward(means)

    def smoothest(self, means: Array) -> Array:
        """The smoothest potentials (n, c), in the norm of K, with these face means (s, c)."""
        flux = self._inward(means)
        return self._vacuum.solve(self._mean.T @ (self._weight * means + flux))

    def _inward(self, means: Array, steps: int = _STEPS) -> Array:
        """N^-1 m (s, c) for m (s, c)."""
        flux = np.zeros_like(means)
        for _ in range(steps):
            potential = self._vacuum.solve(self._mean.T @ (self._weight * means + flux))
            flux = flux + self._weight * (means - self._mean @ potential)
        return flux
