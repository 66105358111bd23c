"""Sums over elements: global matrices and vectors from those of the elements, which all have one pattern."""

from collections.abc import Callable
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix

from fieldmap.iron.operators.sparse_cholesky import Elimination, SparseFactor
from fieldmap.kernels.iron.sparse_pattern import sparse_pattern
from fieldmap.typing import Array, Index


class ElementSums:
    """unknowns (e, k): numbers of every element's unknowns, of `count` in all; order: that of their elimination, None:
    `nested_dissection` of the pattern. Entries of matrices are held in one order: rows one after the other, columns
    rising."""

    def __init__(self, unknowns: Index, count: int, order: Callable[[], Index] | None = None) -> None:
        self._order = order
        self._unknowns, self._count = np.ascontiguousarray(unknowns).ravel(), count
        pointer, columns, place = sparse_pattern(np.ascontiguousarray(unknowns, np.int64), count)
        self._keys = np.repeat(np.arange(count), np.diff(pointer)) * count + columns
        self._place = place.ravel()
        self._index, self._pointer = columns.astype(np.int32), pointer.astype(np.int32)

    @cached_property
    def diagonal(self) -> Index:
        """Places (n,) of the diagonal."""
        return np.searchsorted(self._keys, np.arange(self._count) * (self._count + 1))

    @property
    def pattern(self) -> csr_matrix:
        """Matrix (n, n) of the pattern, of zeros."""
        return self.matrix(np.zeros(len(self._keys)))

    @cached_property
    def elimination(self) -> Elimination:
        """How matrices of this pattern are factored."""
        order = None if self._order is None else self._order()
        return Elimination.of(self.pattern, order)

    def vector(self, elements: Array) -> Array:
        """Sum (n,) of element vectors (e, k)."""
        return np.asarray(np.bincount(self._unknowns, elements.ravel(), self._count), float)

    def entries(self, elements: Array) -> Array:
        """Entries of the sum of element matrices (e, k, k)."""
        return np.asarray(np.bincount(self._place, elements.ravel(), len(self._keys)), float)

    def entries_of(self, matrix: csr_matrix) -> Array:
        """Entries of a matrix (n, n) whose own lie within the pattern."""
        found = matrix.tocoo()
        place = np.searchsorted(self._keys, found.row.astype(np.int64) * self._count + found.col)
        return np.asarray(np.bincount(place, found.data, len(self._keys)), float)

    def matrix(self, entries: Array) -> csr_matrix:
        """Matrix (n, n) of entries."""
        return csr_matrix((entries, self._index, self._pointer), shape=(self._count, self._count))

    def factor(self, entries: Array) -> SparseFactor:
        """Cholesky factor of the matrix of entries. Raises NotConverged if it is not positive definite."""
        return self.elimination.factor(entries)
