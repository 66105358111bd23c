"""The sparse approximate inverse of W: which faces a row may use, and the factor as a sparse matrix."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from fieldmap.iron.operators.clusters import Clusters
from fieldmap.kernels.sparse_inverse import farthest_first, inverse_rows

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def earlier_neighbours(order: Index, centres: Array, width: int) -> tuple[Index, Index]:
    """For the face at every place of the order, the nearest ones before it and, last, itself: (n, width), of which
    the first `filled` (n,) are set. The search doubles the number of faces from step to step."""
    count = len(order)
    x = centres[order]
    columns = np.zeros((count, width), np.int64)
    filled = np.zeros(count, np.int64)
    begin, end = 0, min(count, width)
    while begin < count:
        tree = cKDTree(x[:end])
        # Among the nearest of all up to `end`, at least about half come before.
        _, found = tree.query(x[begin:end], k=min(end, 3 * width))
        found = found.reshape(end - begin, -1)
        own = np.arange(begin, end)[:, None]
        rank = np.cumsum(found < own, axis=1)
        chosen = (found < own) & (rank < width)
        filled[begin:end] = chosen.sum(axis=1) + 1
        row, place = np.nonzero(chosen)
        columns[begin + row, rank[row, place] - 1] = order[found[row, place]]
        columns[np.arange(begin, end), filled[begin:end] - 1] = order[begin:end]
        begin, end = end, min(count, 2 * end)
    return columns, filled


def inverse_factor(
    clusters: Clusters,
    centres: Array,
    width: int,
    near: tuple[Index, Index, NDArray[np.float32]],
    far: tuple[Array, Array, Array],
) -> csr_matrix:
    """G (n, n) with W^-1 about G^T G, at most `width` entries a row; centres (n, 3) in the clusters' order. near: leaf
    pairs (k, 2) of the stored blocks, their offsets and data; far: x, y, z of the rule's points."""
    pairs, offset, data = near
    leaf = clusters.leaf_of_face()
    leaves = int(leaf[-1]) + 1
    block_of_leaves = np.full((leaves, leaves), -1, np.int32)
    block_of_leaves[pairs[:, 0], pairs[:, 1]] = np.arange(len(pairs))
    # Single precision is enough to say which is farther, and a new copy may be rearranged.
    x, y, z = np.array(centres.T, np.float32)
    order = farthest_first(x, y, z)
    columns, filled = earlier_neighbours(order, centres, width)
    values = np.zeros(columns.shape, np.float32)
    inverse_rows(columns, filled, leaf, clusters.offset[-1], block_of_leaves, offset, data, *far, values)
    used = np.arange(width) < filled[:, None]
    pointer = np.concatenate([[0], np.cumsum(filled)])
    shape = (len(leaf), len(leaf))
    return csr_matrix((values[used], columns[used].astype(np.int32), pointer), shape=shape)
