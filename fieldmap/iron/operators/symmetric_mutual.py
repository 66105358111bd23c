"""W of a mesh with mirrors: one block for each irreducible representation of their group.

Faces are numbered (r, a): face r of one chamber, moved by operation a. W commutes with the operations, so that

    W[(r, a), (s, b)] = w(a^-1 b)[r, s],

and its first block row, N^2/g numbers, is all there is. In the coefficients X_ij = sqrt(d/g) sum_a rho_ij(a) x(a) of
an irreducible representation rho of dimension d it is one block of size d N/g, used for each of the d rows i:

    (W x)_ij = sum_k V_jk X_ik,      V_jk = sum_c rho_jk(c) w(c).

Products and solutions hold for any charges, symmetric or not.
"""

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from fieldmap.iron.mesh.chamber import MeshSymmetry
from fieldmap.iron.operators.mutual import DenseMutualPotential
from fieldmap.iron.operators.surface import ChargedFaces
from fieldmap.iron.symmetry.group import (
    fourier_matrix,
    inverses,
    irreducible_representations,
    multiplication_table,
)
from fieldmap.parallel import in_threads, threads_of_kernels, threads_of_linear_algebra
from fieldmap.typing import Array, Index

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


class SymmetricMutualPotential:
    """W of surface faces that a group of operations permutes, by blocks."""

    def __init__(
        self,
        surface: ChargedFaces,
        symmetry: MeshSymmetry,
        triangles: Index,
        explicit_inverse: bool = False,
    ) -> None:
        table = multiplication_table(symmetry.group.matrices)
        if table is None:
            raise ValueError("the operations of a mesh must form a group")
        self._faces = face_orbits(symmetry, triangles)
        representations = irreducible_representations(table)
        self._dimensions = [matrices.shape[1] for matrices in representations]
        self._transform = fourier_matrix(representations)
        blocks, diagonal = _blocks(surface, self._faces, representations, inverses(table))
        self._diagonal = np.empty(self._faces.size)
        self._diagonal[self._faces] = diagonal[:, None]
        self._blocks = _side_by_side(lambda block: DenseMutualPotential(block, explicit_inverse), blocks)

    @property
    def diagonal(self) -> Array:
        """Mean potentials (s,) of the faces' own unit charges."""
        return self._diagonal

    @property
    def bytes(self) -> int:
        """Memory of the blocks and their factors."""
        return sum(block.bytes for block in self._blocks)

    @property
    def storage(self) -> str:
        """How it is stored, in words."""
        return f"{len(self._blocks)} dense blocks"

    def __matmul__(self, charge: Array) -> Array:
        """Mean potentials (s, c) of charges (s, c)."""
        return self._blockwise(charge, lambda block, part: block @ part)

    def solve(self, potential: Array, refinements: int = 0) -> Array:
        """Charges (s, c) with these mean potentials (s, c); see `MutualPotential.solve`."""
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
                    # The identity: nothing is there yet.
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
    """function(item) of every item; in threads, unless linear algebra has more of them for one item."""
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
