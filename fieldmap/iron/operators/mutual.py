"""The mutual potentials of the surface faces and their inverse: what the forms ask of them, and the dense matrix."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_solve

from fieldmap.iron.operators.lapack import cholesky_in_place, inverse_in_place
from fieldmap.kernels.iron.symmetric_product import symmetric_product
from fieldmap.typing import Array

# Numbers that are scaled at a time: 8 MB.
_NUMBERS_AT_ONCE = 1_000_000


class MutualPotential(Protocol):
    """W (s, s), see `fieldmap.kernels.iron.mutual_potential`: symmetric, positive definite, however it is stored."""

    @property
    def diagonal(self) -> Array:
        """Mean potentials (s,) of the faces' own unit charges."""
        ...

    @property
    def bytes(self) -> int:
        """Memory of the matrix and of what its inverse needs."""
        ...

    @property
    def storage(self) -> str:
        """How it is stored, in words, for the report."""
        ...

    def __matmul__(self, charge: Array) -> Array:
        """Mean potentials (s, c) of charges (s, c)."""
        ...

    def solve(self, potential: Array, refinements: int = 0) -> Array:
        """Charges (s, c) with these mean potentials (s, c).

        Without refinement a fixed linear map, good as a preconditioner (three digits or more); each refinement with
        the matrix itself gains as many again.
        """
        ...


class DenseMutualPotential:
    """The whole matrix, with its Cholesky factor in single precision.

    Half the time and memory of a double factor; what needs more digits refines with the matrix itself, about four
    at a time. explicit_inverse: hold the inverse in the place of the factor. It costs twice the factorisation, and each
    solution for one column then takes a fifth of the time: one pass over half a matrix.
    """

    def __init__(self, matrix: Array, explicit_inverse: bool = False) -> None:
        self.matrix = matrix
        self._inverse: NDArray[np.floating[Any]] | None = None
        self._scale = 1 / np.sqrt(np.diag(matrix))[:, None]
        self._factor = self._scaled(np.float32)
        try:
            cholesky_in_place(self._factor)
        except LinAlgError:
            self._factor = self._scaled(np.float64)
            cholesky_in_place(self._factor)
        if explicit_inverse:
            inverse_in_place(self._factor)
            # The lower triangle in Fortran's order is the upper one in C's.
            self._inverse = self._factor.T

    def _scaled(self, precision: type[np.floating[Any]]) -> NDArray[np.floating[Any]]:
        """The matrix with a unit diagonal, in Fortran's order, row by row: nothing else of its size is made."""
        out = np.empty(self.matrix.shape, precision, order="F")
        step = max(1, _NUMBERS_AT_ONCE // len(out))
        for start in range(0, len(out), step):
            here = slice(start, start + step)
            # Symmetric: rows of the one are columns of the other.
            out[:, here] = (self.matrix[here] * self._scale[here] * self._scale.T).T
        return out

    @property
    def diagonal(self) -> Array:
        """Mean potentials (s,) of the faces' own unit charges."""
        return np.diagonal(self.matrix)

    @property
    def bytes(self) -> int:
        """Memory of the matrix and its factor."""
        return self.matrix.nbytes + self._factor.nbytes

    @property
    def storage(self) -> str:
        """How it is stored, in words."""
        return "dense"

    def __matmul__(self, charge: Array) -> Array:
        """Mean potentials (s, c) of charges (s, c)."""
        return _product(self.matrix, charge)

    def solve(self, potential: Array, refinements: int = 0) -> Array:
        """Charges (s, c) with these mean potentials (s, c); see `MutualPotential.solve`."""
        charge = self._approximate(potential)
        for _ in range(refinements):
            charge = charge + self._approximate(potential - self @ charge)
        return charge

    def _approximate(self, right: Array) -> Array:
        scaled = (self._scale * right).astype(self._factor.dtype)
        if self._inverse is not None:
            return self._scale * _product(self._inverse, scaled)
        return self._scale * cho_solve((self._factor, True), scaled, overwrite_b=True, check_finite=False)


def _product(matrix: NDArray[Any], right: NDArray[Any]) -> NDArray[Any]:
    """Product of a symmetric matrix (n, n), of which the upper triangle counts, with (n, c)."""
    columns = np.ascontiguousarray(right.T, matrix.dtype)
    out = np.empty_like(columns)
    symmetric_product(matrix, columns, out)
    return out.T
