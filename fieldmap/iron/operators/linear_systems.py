"""Linear systems of the iron: GMRES for several right-hand sides, sums over elements, and sparse Cholesky factors.

In GMRES one application of the operator serves every column. Each column keeps its own Arnoldi basis (Saad and
Schultz, SIAM J. Sci. Stat. Comput. 7 (1986) 856); the columns share only the products, which take most of the time.

Sparse, symmetric, positive definite systems are solved directly (`fieldmap.kernels.iron.sparse_cholesky`). A pattern is
analysed once, then factored for each set of numbers. The order of elimination is nested dissection of the matrix's
graph (METIS: Karypis and Kumar, SIAM J. Sci. Comput. 20 (1998) 359). The global matrices are sums of element matrices
and all have one pattern.
"""

import importlib.util
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix, csr_matrix, diags_array, tril
from scipy.sparse.linalg import spilu

from fieldmap.errors import NotConverged, Problem
from fieldmap.extras import needs
from fieldmap.kernels.iron import sparse_cholesky as kernel
from fieldmap.records import Record
from fieldmap.threads import in_pieces, thread_count
from fieldmap.typing import Array, Index


def block_gmres(
    apply: Callable[[Array], Array], right: Array, tolerance: float, max_iterations: int
) -> tuple[Array, list[Array]]:
    """Solve apply(x) = right for right (n, c). Returns x (n, c) and the residual norms (c,) after each step,
    relative to the norms of the right-hand side. `apply` should be preconditioned."""
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


def require_convergence(what: str, history: Sequence[Array | float], tolerance: float) -> tuple[float, ...]:
    """The largest residual after each step. Raise NotConverged, with all of them, unless the last is within the
    tolerance."""
    residuals = tuple(float(np.max(step)) for step in history)
    if residuals and residuals[-1] <= tolerance:
        return residuals
    last = f"{residuals[-1]:.2e} after {len(residuals)} steps" if residuals else "no step"
    must_hold = f"the residual must fall to {tolerance:g}"
    remedy = "loosen the tolerance, or look for slivers: bodies that nearly touch, very thin parts"
    raise NotConverged(Problem(f"iron solver, {what}", must_hold, last, remedy), residuals=residuals)


# (columns, share): a supernode and its last child are joined if they have at most this number of columns together, and
# at most this share of the joined columns is zero.
_ZEROS = ((16, 0.6), (32, 0.25), (64, 0.1), (10**9, 0.03))

# Fewest right-hand sides per thread: each thread reads the whole factor.
_COLUMNS_AT_ONCE = 8


class SparseFactor:
    """Solves matrix x = right by the Cholesky factor of a matrix of the pattern `analysis`."""

    def __init__(self, analysis: "Elimination", panels: NDArray[np.floating[Any]]) -> None:
        self._analysis, self._panels = analysis, panels

    @property
    def bytes(self) -> int:
        """Memory of the factor."""
        return self._panels.nbytes

    def solve(self, right: Array) -> Array:
        """x with matrix x = right, for right (n,) or (n, c)."""
        a = self._analysis
        x = np.ascontiguousarray(right.reshape(len(right), -1)[a.order].T)

        def part(first: int, last: int) -> None:
            kernel.solve(a.start, a.rows, a.row_start, a.panel_start, self._panels, x[first:last])

        in_pieces(part, len(x), _COLUMNS_AT_ONCE, thread_count())
        out = np.empty(right.shape)
        out.reshape(len(right), -1)[a.order] = x.T
        return out


@dataclass(frozen=True, eq=False, repr=False)
class Elimination(Record):
    """The analysis of a symmetric pattern, for the factors of all its matrices: order (n,) of elimination, and
    supernodes as in `fieldmap.kernels.iron.sparse_cholesky`. entry (k,): numbers of the matrix's entries in the lower
    triangle, front by front; entry_start, place: their places in the fronts.
    """

    order: Index
    start: Index
    rows: Index
    row_start: Index
    parent: Index
    relative: Index
    panel_start: Index
    entry: Index
    entry_start: Index
    place: Index
    work: int

    @classmethod
    def of(cls, matrix: csr_matrix, order: Index | None = None) -> "Elimination":
        """Analyse a matrix with a symmetric pattern, sorted indices and no duplicates. order (n,) of elimination; None:
        nested dissection of the matrix's graph."""
        count = matrix.shape[0]
        if order is None:
            order = nested_dissection(matrix)
        parent = kernel.elimination_tree(*_lower(matrix, order))
        order = order[kernel.postorder(parent)]
        # The pattern and the tree in the new numbers.
        by_rows = _lower(matrix, order)
        parent = kernel.elimination_tree(*by_rows)
        start, node_parent, sizes = _supernodes(parent, kernel.column_counts(*by_rows, parent))
        row_start = np.concatenate([[0], np.cumsum(sizes)])
        entry_rows, entry_columns = _numbered(matrix, order)
        lower = np.flatnonzero(entry_rows >= entry_columns)
        entry = lower[np.lexsort((entry_rows[lower], entry_columns[lower]))]
        entry_rows, entry_columns = entry_rows[entry], entry_columns[entry]
        pointer = np.searchsorted(entry_columns, np.arange(count + 1))
        rows = kernel.supernode_rows(start, pointer, entry_rows, node_parent, row_start)
        number, width = np.arange(len(sizes)), np.diff(start)
        of_row = count * np.repeat(number, sizes)
        rows = rows[np.argsort(rows + of_row)]

        def place_in(node: Index, row: Index) -> Index:
            """Places of rows among the sorted rows of supernodes `node`."""
            return np.searchsorted(rows + of_row, row + count * node) - row_start[node]

        # Only the places of rows that the parent has are used.
        relative = place_in(np.repeat(node_parent, sizes), rows)
        panel_start = np.concatenate([[0], np.cumsum(sizes * width)])
        entry_node = np.repeat(number, width)[entry_columns]
        place = place_in(entry_node, entry_rows) + (entry_columns - start[entry_node]) * sizes[entry_node]
        nodes = (order, start, rows, row_start, node_parent, relative, panel_start)
        work = int(kernel.largest_work(start, row_start, node_parent))
        return cls(*nodes, entry, pointer[start], place, work)

    def factor(self, values: Array, precision: type[np.floating[Any]] = np.float64) -> SparseFactor:
        """Factor of the matrix of this pattern with these numbers (k,), in the order of its `data`.

        Raises NotConverged if it is not positive definite to this precision.
        """
        panels = np.empty(self.panel_start[-1], precision)
        nodes = (self.start, self.row_start, self.parent, self.relative, self.panel_start)
        entries = (values[self.entry].astype(precision), self.entry_start, self.place)
        if kernel.factorise(*entries, *nodes, panels, np.empty(self.work, precision)) >= 0:
            must_hold = "must be positive definite"
            remedy = "look for slivers in the mesh, or for a B-H law that falls"
            raise NotConverged.of("iron solver, stiffness matrix", must_hold, "a pivot below zero", remedy)
        return SparseFactor(self, panels)


def nested_dissection(matrix: csr_matrix) -> Index:
    """Order (n,) of elimination for a matrix with a symmetric pattern, by nested dissection of its graph."""
    rows = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    off = matrix.indices != rows
    pointer = np.concatenate([[0], np.cumsum(np.bincount(rows[off], minlength=matrix.shape[0]))])
    # METIS refuses graphs without edges; any order serves for them.
    if not off.any():
        return np.arange(matrix.shape[0])
    # METIS comes without a wheel for Windows.
    if sys.platform == "win32" and importlib.util.find_spec("pymetis") is None:
        return minimum_degree(matrix)
    with needs("make", "the equations of the iron"):
        import pymetis
    order, _ = pymetis.nested_dissection(pymetis.CSRAdjacency(pointer, matrix.indices[off]))
    return np.asarray(order, np.int64)


def minimum_degree(matrix: csr_matrix) -> Index:
    """Order (n,) of elimination for a matrix with a symmetric pattern, by SuperLU's minimum degree. The factor has 1.2
    to 1.4 times as many entries as with nested dissection, on grids of 12^3 and 24^3 nodes."""
    size = matrix.shape[0]
    pattern = csc_matrix((np.ones(matrix.nnz), matrix.indices, matrix.indptr), shape=matrix.shape)
    # An incomplete factor that drops all it may, because only its order is needed.
    dominant = csc_matrix(pattern + diags_array(np.full(size, float(size))))
    rough = spilu(dominant, drop_tol=1.0, fill_factor=1.0, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0)
    return np.argsort(rough.perm_c).astype(np.int64)


def _numbered(matrix: csr_matrix, order: Index) -> tuple[Index, Index]:
    """Rows and columns (k,) of a matrix's entries, in the numbers of the order."""
    number = np.argsort(order)
    return number[np.repeat(np.arange(len(order)), np.diff(matrix.indptr))], number[matrix.indices]


def _lower(matrix: csr_matrix, order: Index) -> tuple[Index, Index]:
    """Pattern of the strict lower triangle by rows, with rows and columns in the order: pointers and columns."""
    lower = tril(csr_matrix((np.ones(matrix.nnz, np.int8), _numbered(matrix, order))), -1, "csr")
    return lower.indptr.astype(np.int64), lower.indices.astype(np.int64)


def _supernodes(parent: Index, counts: Index) -> tuple[Index, Index, Index]:
    """First columns (m + 1,), parents (m,) and numbers of rows (m,) of supernodes. The columns of the factor have
    `parent` and `counts` entries; a column is joined with its last child if this adds few zeros (`_ZEROS`)."""
    columns, (widths, shares) = np.arange(len(parent) + 1), np.array(_ZEROS).T
    begin, size, into = kernel.join_supernodes(columns, parent, counts, widths, shares)
    kept = np.flatnonzero(into == columns[:-1])
    above = np.where(parent[kept] >= 0, np.searchsorted(kept, into[parent[kept]]), -1)
    return np.append(begin[kept], len(parent)), above, size[kept]


class ElementSums:
    """Sums of element vectors and matrices. unknowns (e, k): numbers of every element's unknowns, `count` in all;
    order: of elimination, None: `nested_dissection` of the pattern. Entries of matrices are held row by row, columns
    rising."""

    def __init__(self, unknowns: Index, count: int, order: Callable[[], Index] | None = None) -> None:
        self._order, self._count = order, count
        self._unknowns = np.ascontiguousarray(unknowns, np.int64).ravel()
        pairs = count * unknowns[:, :, None] + unknowns[:, None, :]
        self._keys, self._place = np.unique(pairs.ravel(), return_inverse=True)
        self._index = (self._keys % count).astype(np.int32)
        self._pointer = np.searchsorted(self._keys, count * np.arange(count + 1)).astype(np.int32)

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
        """The analysis of the pattern, for factors."""
        order = None if self._order is None else self._order()
        return Elimination.of(self.pattern, order)

    def vector(self, elements: Array) -> Array:
        """Sum (n,) of element vectors (e, k)."""
        return np.asarray(np.bincount(self._unknowns, elements.ravel(), self._count), float)

    def entries(self, elements: Array) -> Array:
        """Entries of the sum of element matrices (e, k, k)."""
        return np.asarray(np.bincount(self._place, elements.ravel(), len(self._keys)), float)

    def entries_of(self, matrix: csr_matrix) -> Array:
        """Entries of a matrix (n, n) whose pattern lies within this one."""
        found = matrix.tocoo()
        place = np.searchsorted(self._keys, found.row.astype(np.int64) * self._count + found.col)
        return np.asarray(np.bincount(place, found.data, len(self._keys)), float)

    def matrix(self, entries: Array) -> csr_matrix:
        """Matrix (n, n) of entries."""
        return csr_matrix((entries, self._index, self._pointer), shape=(self._count, self._count))

    def factor(self, entries: Array) -> SparseFactor:
        """Cholesky factor of the matrix of entries. Raises NotConverged if it is not positive definite."""
        return self.elimination.factor(entries)

    def rough_factor(self, entries: Array) -> SparseFactor:
        """As `factor`, in single precision (half the time and memory) if the matrix is positive definite in it."""
        try:
            return self.elimination.factor(entries, np.float32)
        except NotConverged:
            return self.factor(entries)
