"""The mutual potentials of the surface faces and their inverse: the interface for the forms, and dense matrices.

Other threads run while a Cholesky factor or an inverse is computed. SciPy's functions hold the interpreter's lock until
LAPACK is done, so LAPACK's routines are called here by their addresses (scipy.linalg.cython_lapack), without the lock.

W of a mesh with mirrors is one block for each irreducible representation of their group. Faces are numbered (r, a):
face r of one chamber, moved by operation a. W commutes with the operations, so that

    W[(r, a), (s, b)] = w(a^-1 b)[r, s],

and its first block row, N^2/g numbers, determines it. In the coefficients X_ij = sqrt(d/g) sum_a rho_ij(a) x(a) of
an irreducible representation rho of dimension d, W is one block of size d N/g, used for each of the d rows i:

    (W x)_ij = sum_k V_jk X_ik,      V_jk = sum_c rho_jk(c) w(c).

Products and solutions hold for any charges, symmetric or not.
"""

import ctypes
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, TypeVar

import numpy as np
from numba.extending import get_cython_function_address
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_solve

from fieldmap.iron.mesh.chamber import MeshSymmetry
from fieldmap.iron.mesh.charged_faces import ChargedFaces
from fieldmap.iron.symmetry import fourier_matrix, inverses, irreducible_representations, multiplication_table
from fieldmap.kernels.iron.symmetric_product import symmetric_product
from fieldmap.parallel import in_threads, threads_of_kernels, threads_of_linear_algebra
from fieldmap.threads import in_pieces, thread_count
from fieldmap.typing import Array, Index

_PREFIX = {np.dtype(np.float32): "s", np.dtype(np.float64): "d"}


def cholesky_in_place(matrix: NDArray[np.floating[Any]]) -> None:
    """Overwrite the lower triangle of a matrix (n, n) in Fortran's order, float32 or float64, with its factor L.

    Raises LinAlgError if the matrix is not positive definite; its contents are then undefined.
    """
    failed = _call("potrf", matrix)
    if failed:
        raise LinAlgError(f"not positive definite: the leading minor of order {failed} is not positive")


def inverse_in_place(factor: NDArray[np.floating[Any]]) -> None:
    """Overwrite the lower triangle of a factor L (n, n) in Fortran's order with the lower triangle of (L L^T)^-1.

    Raises LinAlgError for a zero on the diagonal.
    """
    failed = _call("potri", factor)
    if failed:
        raise LinAlgError(f"the inverse of a factor has failed at row {failed}")


def _call(routine: str, matrix: NDArray[np.floating[Any]]) -> int:
    if not matrix.flags.f_contiguous or matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
        raise ValueError(f"{routine} takes a square matrix in Fortran's order, not {matrix.shape}")
    size, leading, failed = ctypes.c_int(len(matrix)), ctypes.c_int(max(len(matrix), 1)), ctypes.c_int(0)
    function = _function(_PREFIX[matrix.dtype] + routine)
    function(b"L", ctypes.byref(size), matrix.ctypes.data, ctypes.byref(leading), ctypes.byref(failed))
    return failed.value


@cache
def _function(name: str) -> Any:
    # uplo, n, a, lda, info
    integer = ctypes.POINTER(ctypes.c_int)
    prototype = ctypes.CFUNCTYPE(None, ctypes.c_char_p, integer, ctypes.c_void_p, integer, integer)
    return prototype(get_cython_function_address("scipy.linalg.cython_lapack", name))


# Fewest columns per thread of a product: with fewer, memory bandwidth limits the speed.
_COLUMNS_AT_ONCE = 8
# Numbers that are scaled at a time: 8 MB.
_NUMBERS_AT_ONCE = 1_000_000


class MutualPotential(ABC):
    """W (s, s), see `fieldmap.kernels.iron.mutual_potential`: symmetric, positive definite, in one of several storages.

    diagonal (s,): mean potentials of the faces' own unit charges; bytes: memory of the matrix and of the data for its
    inverse; storage: how it is stored, in words, for the report.
    """

    diagonal: Array
    bytes: int
    storage: str

    @abstractmethod
    def __matmul__(self, charge: Array) -> Array:
        """Mean potentials (s, c) of charges (s, c)."""

    def solve(self, potential: Array, refinements: int = 0) -> Array:
        """Charges (s, c) with these mean potentials (s, c).

        Without refinement this is a fixed linear map to three digits or more, good as a preconditioner. Each refinement
        with the matrix itself gains the same number of digits.
        """
        charge = self._approximate(potential)
        for _ in range(refinements):
            charge = charge + self._approximate(potential - self @ charge)
        return charge

    def _approximate(self, potential: Array) -> Array:
        """`solve` without refinement."""
        raise NotImplementedError


class DenseMutualPotential(MutualPotential):
    """The whole matrix, with its Cholesky factor in single precision.

    The factor takes half the time and memory of a double one; each refinement with the matrix itself gains about four
    digits. explicit_inverse: hold the inverse in place of the factor. It costs twice the factorisation, and each
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
        self.diagonal, self.storage = np.diagonal(matrix), "dense"
        self.bytes = matrix.nbytes + self._factor.nbytes

    def _scaled(self, precision: type[np.floating[Any]]) -> NDArray[np.floating[Any]]:
        """The matrix with a unit diagonal, in Fortran's order; made in pieces, without a temporary of its size."""
        out = np.empty(self.matrix.shape, precision, order="F")
        step = max(1, _NUMBERS_AT_ONCE // len(out))
        for start in range(0, len(out), step):
            here = slice(start, start + step)
            # The matrix is symmetric: its rows are its columns.
            out[:, here] = (self.matrix[here] * self._scale[here] * self._scale.T).T
        return out

    def __matmul__(self, charge: Array) -> Array:
        """Mean potentials (s, c) of charges (s, c)."""
        return _product(self.matrix, charge)

    def _approximate(self, right: Array) -> Array:
        scaled = (self._scale * right).astype(self._factor.dtype)
        if self._inverse is not None:
            return self._scale * _product(self._inverse, scaled)
        return self._scale * cho_solve((self._factor, True), scaled, overwrite_b=True, check_finite=False)


def _product(matrix: NDArray[Any], right: NDArray[Any]) -> NDArray[Any]:
    """Product of a symmetric matrix (n, n) with (n, c); only the upper triangle is read."""
    columns = np.ascontiguousarray(right.T, matrix.dtype)
    out = np.empty_like(columns)

    def part(first: int, last: int) -> None:
        symmetric_product(matrix, columns[first:last], out[first:last])

    in_pieces(part, len(columns), _COLUMNS_AT_ONCE, thread_count())
    return out.T


T = TypeVar("T")
R = TypeVar("R")
# Blocks with fewer numbers are added up in less time than threads take to start.
_WORTH_THREADS = 4_000_000


def face_images(symmetry: MeshSymmetry, triangles: Index) -> Index:
    """images (g, s): the face that each is mapped onto by each operation; triangles (s, 3): nodes of the faces."""
    count = symmetry.node_images.shape[1]
    weight = np.array([count * count, count, 1])
    keys = np.sort(triangles, axis=1) @ weight
    order = np.argsort(keys)
    moved = np.sort(symmetry.node_images[:, triangles], axis=2) @ weight
    return np.asarray(order[np.searchsorted(keys[order], moved)])


def face_orbits(symmetry: MeshSymmetry, triangles: Index) -> Index:
    """faces (n, g): faces[r, a] is the image under operation a of face r of one chamber.

    triangles (s, 3): nodes of the surface faces. No operation but the identity maps a triangle onto itself.
    """
    images = face_images(symmetry, triangles)
    return np.ascontiguousarray(images[:, images.min(axis=0) == np.arange(len(triangles))].T)


class SymmetricMutualPotential(MutualPotential):
    """W of surface faces that a group of operations permutes, by blocks."""

    def __init__(
        self, surface: ChargedFaces, symmetry: MeshSymmetry, triangles: Index, explicit_inverse: bool = False
    ) -> None:
        table = multiplication_table(symmetry.group.matrices)
        if table is None:
            raise ValueError("the operations of a mesh must form a group")
        self._faces = face_orbits(symmetry, triangles)
        representations = irreducible_representations(table)
        self._dimensions = [matrices.shape[1] for matrices in representations]
        self._transform = fourier_matrix(representations)
        blocks, diagonal = _blocks(surface, self._faces, representations, inverses(table))
        self.diagonal = np.empty(self._faces.size)
        self.diagonal[self._faces] = diagonal[:, None]
        self._blocks = _side_by_side(lambda block: DenseMutualPotential(block, explicit_inverse), blocks)
        self.bytes = sum(block.bytes for block in self._blocks)
        self.storage = f"{len(self._blocks)} dense blocks"

    def __matmul__(self, charge: Array) -> Array:
        """Mean potentials (s, c) of charges (s, c)."""
        return self._blockwise(charge, lambda block, part: block @ part)

    def solve(self, potential: Array, refinements: int = 0) -> Array:
        """See `MutualPotential.solve`."""
        return self._blockwise(potential, lambda block, part: block.solve(part, refinements))

    def _blockwise(self, values: Array, apply) -> Array:
        flat = values.reshape(len(values), -1)
        count = len(self._faces)
        # (g, n, c): function on the group, to its coefficients and back.
        by_operation = flat[self._faces.T]
        coefficients = np.tensordot(self._transform, by_operation, axes=1)
        start = 0
        for d, block in zip(self._dimensions, self._blocks, strict=True):
            here = coefficients[start : start + d * d].reshape(d, d * count, -1)
            right = np.moveaxis(here, 0, 1).reshape(d * count, -1)
            moved = np.moveaxis(apply(block, right).reshape(d * count, d, -1), 1, 0)
            coefficients[start : start + d * d] = moved.reshape(d * d, count, -1)
            start += d * d
        out = np.empty_like(flat)
        out[self._faces.T] = np.tensordot(self._transform.T, coefficients, axes=1)
        return out.reshape(values.shape)


def _blocks(
    surface: ChargedFaces, faces: Index, representations: tuple[Array, ...], inverse: Index
) -> tuple[list[Array], Array]:
    """V of every representation, and the diagonal (n,) of the chamber's own block."""
    count = len(faces)
    own = surface.part(faces[:, 0])
    blocks = [np.empty((m.shape[1] * count,) * 2) for m in representations]
    diagonal, block = np.zeros(count), np.empty((count, count))
    small = sum(total.size for total in blocks) < _WORTH_THREADS
    for c, back in enumerate(inverse):
        if back < c:
            continue
        own.mutual_potential_with(surface.part(faces[:, c]), back == c, block)
        if c == 0:
            diagonal = block.diagonal().copy()

        def add(number: int, c: int = c, back: int = back) -> None:
            matrices, total = representations[number], blocks[number]
            view = total.reshape(matrices.shape[1], count, matrices.shape[1], count)
            for j, k in np.ndindex(matrices.shape[1:]):
                if c == 0:
                    # The identity comes first: the block is still empty.
                    view[j, :, k] = block if j == k else 0.0
                    continue
                _add(view[j, :, k], matrices[c, j, k], block)
                if back != c:
                    _add(view[j, :, k], matrices[back, j, k], block.T)

        if small:
            for number in range(len(blocks)):
                add(number)
        else:
            _side_by_side(add, range(len(blocks)))
    return blocks, diagonal


def _side_by_side(function: Callable[[T], R], items: Sequence[T]) -> list[R]:
    """function(item) of every item; in threads, unless linear algebra uses more threads than there are items."""
    threads = threads_of_kernels()
    if len(items) < 2 or threads < 2 or threads_of_linear_algebra() > len(items):
        return [function(item) for item in items]
    return [outcome.result() for outcome in in_threads(function, items, min(threads, len(items)))]


def _add(total: Array, factor: float, block: Array) -> None:
    """total += factor * block, without a temporary for the commonest factors."""
    if factor == 1.0:
        total += block
    elif factor == -1.0:
        total -= block
    elif factor != 0.0:
        total += factor * block
