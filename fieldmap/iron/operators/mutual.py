"""The dense matrix of mutual potentials and its inverse, shared by both forms of the iron problem."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve

Array = NDArray[np.float64]


class MutualPotential:
    """W (s, s), see `fieldmap.kernels.mutual_potential`, with its Cholesky factor in single precision.

    Half the time and memory of a double factor; what needs more digits refines with the matrix itself.
    """

    def __init__(self, matrix: Array) -> None:
        self.matrix = matrix
        self._scale = 1 / np.sqrt(np.diag(matrix))[:, None]
        scaled = matrix * self._scale * self._scale.T
        try:
            self._factor = cho_factor(
                scaled.astype(np.float32), lower=True, overwrite_a=True, check_finite=False
            )
        except LinAlgError:
            self._factor = cho_factor(scaled, lower=True, overwrite_a=True)

    @property
    def bytes(self) -> int:
        """Memory of the matrix and its factor."""
        return self.matrix.nbytes + self._factor[0].nbytes

    def __matmul__(self, charge: Array) -> Array:
        """Mean potentials (s, c) of charges (s, c)."""
        return self.matrix @ charge

    def solve(self, potential: Array, refinements: int = 0) -> Array:
        """Charges (s, c) with these mean potentials (s, c); each refinement gains about four digits."""
        charge = self._approximate(potential)
        for _ in range(refinements):
            charge = charge + self._approximate(potential - self.matrix @ charge)
        return charge

    def _approximate(self, right: Array) -> Array:
        scaled = (self._scale * right).astype(self._factor[0].dtype)
        return self._scale * cho_solve(self._factor, scaled, overwrite_b=True, check_finite=False)
