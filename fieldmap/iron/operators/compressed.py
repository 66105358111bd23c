"""W of many faces by blocks: dense where clusters of faces are near each other, of low rank where they are far.

Its inverse is Chebyshev's iteration for several right-hand sides: a fixed, symmetric, linear map, unlike conjugate
gradients, so that it may stand inside another iteration. (Golub and Varga, Numer. Math. 3 (1961) 147; Saad, Iterative
Methods for Sparse Linear Systems, 2nd ed., algorithm 12.1.)

Clusters form a balanced binary tree: every cluster is cut at the median of its longest side, so that all leaves are on
one level and differ by one face at most. Faces are numbered anew, leaf by leaf; a cluster is a run of these numbers.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigvalsh_tridiagonal
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from fieldmap.iron.mesh.charged_faces import NEAR_RADII, ChargedFaces
from fieldmap.iron.operators.mutual import MutualPotential
from fieldmap.kernels.iron.block_product import add_far_product, add_near_product
from fieldmap.kernels.iron.cross_approximation import approximate_far_blocks, pack_factors
from fieldmap.kernels.iron.mutual_potential import fill_near_blocks
from fieldmap.kernels.iron.sparse_inverse import farthest_first, inverse_rows
from fieldmap.records import Record
from fieldmap.threads import over_rows, thread_count
from fieldmap.typing import Array, Index


@dataclass(frozen=True, eq=False, repr=False)
class Clusters(Record):
    """order (n,): old numbers of the faces in the new order; offset[l] (2^l + 1,): where the clusters of level l begin;
    lower[l], upper[l] (2^l, 3): boxes of their centres; radius[l] (2^l,): largest radius of their faces."""

    order: Index
    offset: tuple[Index, ...]
    lower: tuple[Array, ...]
    upper: tuple[Array, ...]
    radius: tuple[Array, ...]

    @classmethod
    def of(cls, faces: ChargedFaces, leaf_size: int) -> "Clusters":
        """Clusters of faces, cut until no leaf has more than `leaf_size` faces."""
        count = len(faces.areas)
        order = np.arange(count)
        offset = [np.array([0, count])]
        while np.diff(offset[-1]).max() > leaf_size:
            ends = offset[-1]
            middles = (ends[:-1] + ends[1:]) // 2
            for start, middle, end in zip(ends[:-1], middles, ends[1:], strict=True):
                centres = faces.centres[order[start:end]]
                axis = np.ptp(centres, axis=0).argmax()
                place = np.argpartition(centres[:, axis], middle - start)
                order[start:end] = order[start:end][place]
            offset.append(np.sort(np.concatenate([ends, middles])))
        starts = [ends[:-1] for ends in offset]
        centres, radii = faces.centres[order], faces.radii[order]
        lower, upper = (tuple(of.reduceat(centres, s) for s in starts) for of in (np.minimum, np.maximum))
        return cls(order, tuple(offset), lower, upper, tuple(np.maximum.reduceat(radii, s) for s in starts))

    def leaf_of_face(self) -> Index:
        """Number (n,) of the leaf that holds each face, in the new order."""
        return np.repeat(np.arange(len(self.offset[-1]) - 1), np.diff(self.offset[-1]))


@dataclass(frozen=True, eq=False, repr=False)
class BlockPartition(Record):
    """Pairs of clusters that cover the lower triangle once: far (b, 4) and near (k, 4), as first and last + 1 of the
    rows and of the columns; near pairs are pairs of leaves, near_leaves (k, 2)."""

    far: Index
    near: Index
    near_leaves: Index

    @classmethod
    def of(cls, clusters: Clusters, separation: float, nearness: float) -> "BlockPartition":
        """Two clusters are far where the distance of their boxes is at least `separation` times the smaller one's
        diagonal and `nearness` times the sum of their largest radii, so that they hold no near pair of faces."""
        pairs, far = np.zeros((1, 2), np.int64), []
        levels = (clusters.offset, clusters.lower, clusters.upper, clusters.radius)
        for level, (offset, lower, upper, radius) in enumerate(zip(*levels, strict=True)):
            if level:
                a, b = pairs.T
                below = [np.column_stack([2 * a + i, 2 * b + j]) for i, j in ((0, 0), (1, 0), (1, 1))]
                pairs = np.concatenate([*below, np.column_stack([2 * a, 2 * b + 1])[a != b]])
            a, b = pairs.T
            gap = np.maximum(0.0, np.maximum(lower[a] - upper[b], lower[b] - upper[a]))
            distance, size = np.linalg.norm(gap, axis=1), np.linalg.norm(upper - lower, axis=1)
            is_far = distance > separation * np.minimum(size[a], size[b])
            is_far &= distance > nearness * (radius[a] + radius[b])
            far.append(_ranges(offset, pairs[is_far]))
            pairs = pairs[~is_far]
        return cls(np.concatenate(far), _ranges(offset, pairs), pairs)


def _ranges(offset: Index, pairs: Index) -> Index:
    a, b = pairs.T
    return np.column_stack([offset[a], offset[a + 1], offset[b], offset[b + 1]])


_LANCZOS_STEPS = 16
# Factors on the extreme eigenvalues of Lanczos: the true ones lie a little outside, and the smallest converges last.
_BELOW, _ABOVE = 0.85, 1.05


def spectrum(apply: Callable[[Array], Array], count: int) -> tuple[float, float]:
    """Bounds of the eigenvalues of a symmetric, positive definite map of vectors (n, 1), by Lanczos from a fixed
    random start, with the factors above."""
    basis = np.zeros((count, _LANCZOS_STEPS))
    start = np.random.default_rng(1).standard_normal(count)
    basis[:, 0] = start / np.linalg.norm(start)
    diagonal, side = np.zeros(_LANCZOS_STEPS), np.zeros(_LANCZOS_STEPS)
    steps = min(_LANCZOS_STEPS, count)
    for k in range(steps):
        vector = apply(basis[:, k : k + 1])[:, 0]
        diagonal[k] = vector @ basis[:, k]
        for _ in range(2):
            vector = vector - basis[:, : k + 1] @ (basis[:, : k + 1].T @ vector)
        side[k] = np.linalg.norm(vector)
        if k + 1 < steps:
            basis[:, k + 1] = vector / (side[k] or 1.0)
    values = eigvalsh_tridiagonal(diagonal[:steps], side[: steps - 1])
    return _BELOW * float(values[0]), _ABOVE * float(values[-1])


def steps_needed(bounds: tuple[float, float], tolerance: float) -> int:
    """Steps after which the error has fallen to the tolerance, for eigenvalues within the bounds."""
    root = math.sqrt(bounds[1] / bounds[0])
    rate = max((root - 1) / (root + 1), 1e-3)
    return max(1, math.ceil(math.log(tolerance / 2) / math.log(rate)))


def chebyshev(
    apply: Callable[[Array], Array],
    precondition: Callable[[Array], Array],
    right: Array,
    bounds: tuple[float, float],
    steps: int,
) -> Array:
    """Approximate solution x (n, c) of apply(x) = right (n, c), from zero; bounds: of the eigenvalues of the
    preconditioned map. Needs one product less than steps."""
    centre, half = (bounds[1] + bounds[0]) / 2, (bounds[1] - bounds[0]) / 2
    ratio = centre / half
    rho = 1 / ratio
    residual = right
    direction = precondition(right) / centre
    x = direction
    for _ in range(steps - 1):
        residual = residual - apply(direction)
        following = 1 / (2 * ratio - rho)
        direction = following * rho * direction + (2 * following / half) * precondition(residual)
        rho = following
        x = x + direction
    return x


def earlier_neighbours(order: Index, centres: Array, width: int) -> tuple[Index, Index]:
    """For the face at every place of the order: the nearest faces among the earlier ones, with the face itself last,
    (n, width), and the number (n,) of entries in use. Each step of the search doubles the number of faces."""
    count = len(order)
    x = centres[order]
    columns = np.zeros((count, width), np.int64)
    filled = np.zeros(count, np.int64)
    begin, end = 0, min(count, width)
    while begin < count:
        tree = cKDTree(x[:end])
        # Of the nearest faces among all up to `end`, about half or more come before the face.
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
    far: tuple[Array, ...],
) -> csr_matrix:
    """G (n, n) such that G^T G approximates W^-1, at most `width` entries a row; centres (n, 3) in the clusters' order.
    near: leaf pairs (k, 2) of the stored blocks, their offsets and data; far: x, y, z of the rule's points."""
    pairs, offset, data = near
    leaf = clusters.leaf_of_face()
    leaves = int(leaf[-1]) + 1
    block_of_leaves = np.full((leaves, leaves), -1, np.int32)
    block_of_leaves[pairs[:, 0], pairs[:, 1]] = np.arange(len(pairs))
    # Single precision is enough to find which is farther. `farthest_first` rearranges the arrays, hence a copy.
    x, y, z = np.array(centres.T, np.float32, order="C")
    order = farthest_first(x, y, z)
    columns, filled = earlier_neighbours(order, centres, width)
    values = np.zeros(columns.shape, np.float32)
    blocks = (leaf, clusters.offset[-1], block_of_leaves, offset, data)
    over_rows(inverse_rows, len(values), columns, filled, *blocks, *far, values, work=width**3 / 6.0)
    used = np.arange(width) < filled[:, None]
    pointer = np.concatenate([[0], np.cumsum(filled)])
    shape = (len(leaf), len(leaf))
    return csr_matrix((values[used], columns[used].astype(np.int32), pointer), shape=shape)


# Relative error of every far block, in the Frobenius norm. All entries of W are positive, so that the error of W
# is at most this fraction of its own norm. The same holds for rounding to single precision, with 6e-8.
TOLERANCE = 1e-6
_LEAF_SIZE = 64
_SEPARATION = 0.7
# Far blocks of higher rank are cut in four; none was met.
_RANK_LIMIT = 64
# Number of parts of a product: the most threads that can share it.
_PARTS = 8
# Size of the scratch for making far blocks, in numbers of 8 bytes: 200 MB.
_SCRATCH = 25_000_000
# Most entries in a row of the sparse inverse. Relative error of `solve` without refinement; each refinement multiplies
# the error by this number.
_ROW_WIDTH = 96
_SOLVE_TOLERANCE = 3e-4
# Rank of a far block, averaged over its rows and columns: measured 9 to 13, for the prediction of memory.
_EXPECTED_RANK = 14


@dataclass(frozen=True, eq=False)
class _FarBlocks:
    """Low-rank blocks (b, 4), their ranks and factors, see `fieldmap.kernels.iron.cross_approximation`."""

    blocks: Index
    ranks: Index
    offset: Index
    data: NDArray[np.float32]


class CompressedMutualPotential(MutualPotential):
    """W of many faces by blocks. tolerance: relative error of every far block."""

    def __init__(self, faces: ChargedFaces, tolerance: float = TOLERANCE) -> None:
        self._clusters = Clusters.of(faces, _LEAF_SIZE)
        self._order = self._clusters.order
        partition = BlockPartition.of(self._clusters, _SEPARATION, NEAR_RADII)
        ordered = faces.part(self._order)
        # x, y and z (3, n) of the three points of the degree-2 rule.
        points = tuple(np.ascontiguousarray(ordered.rule_points(2)[0].transpose(2, 1, 0)))
        self._near = partition.near
        self._near_offset = np.concatenate([[0], np.cumsum(np.multiply(*_sides(self._near)))])
        self._near_data = np.empty(self._near_offset[-1], np.float32)
        given = (self._near, self._near_offset, self._order, ordered.kernel_geometry(), *points, NEAR_RADII)
        work = 10.0 * len(self._near_data) / max(len(self._near), 1)
        over_rows(fill_near_blocks, len(self._near), *given, self._near_data, work=work)
        self._far = _far_blocks(partition.far, points, tolerance)
        self.diagonal = np.empty(len(self._order))
        self.diagonal[self._order] = self._diagonal_of_leaves()
        near = partition.near_leaves, self._near_offset, self._near_data
        self._factor = inverse_factor(self._clusters, ordered.centres, _ROW_WIDTH, near, points)
        self._transposed = self._factor.T.tocsr()
        self._bounds = spectrum(
            lambda x: self._factor @ self._product(self._transposed @ x), len(self._order)
        )
        self._steps = steps_needed(self._bounds, _SOLVE_TOLERANCE)
        sparse = sum(m.data.nbytes + m.indices.nbytes for m in (self._factor, self._transposed))
        self.bytes = self._near_data.nbytes + sum(part.data.nbytes for part in self._far) + sparse
        blocks = sum(len(part.ranks) for part in self._far)
        dense = 4 * len(self._order) * (len(self._order) + 1) // 2
        self.storage = (
            f"compressed: {len(self._near)} dense blocks, {blocks} of low rank (mean {self.mean_rank:.1f}), "
            f"{100 * self.bytes / dense:.0f} % of one dense triangle"
        )

    @property
    def mean_rank(self) -> float:
        """Rank of the far blocks, averaged over their rows and columns."""
        sides = [np.add(*_sides(part.blocks)) for part in self._far]
        total = sum(int(side.sum()) for side in sides)
        ranks = sum(int(side @ part.ranks) for side, part in zip(sides, self._far, strict=True))
        return ranks / max(total, 1)

    def __matmul__(self, charge: Array) -> Array:
        """Mean potentials (s, c) of charges (s, c)."""
        flat = charge.reshape(len(charge), -1)
        out = np.empty(flat.shape)
        out[self._order] = self._product(flat[self._order])
        return out.reshape(charge.shape)

    def _approximate(self, potential: Array) -> Array:
        right, out = potential[self._order], np.empty(potential.shape)
        out[self._order] = chebyshev(self._product, self._precondition, right, self._bounds, self._steps)
        return out

    def _precondition(self, right: Array) -> Array:
        # The entries are single, the sums double: rounded sums would not be linear, and the flux form's projection
        # onto zero net flux, which cancels large constants, would see it (measured: 5e-6 of B).
        return self._transposed @ (self._factor @ right)

    def _product(self, charge: Array) -> Array:
        """Mean potentials of charges (n, c), both in the clusters' order."""
        count, columns = charge.shape
        groups = -(-columns // 4)
        padded = np.zeros((count, 4 * groups))
        padded[:, :columns] = charge
        x = np.ascontiguousarray(padded.reshape(count, groups, 4).swapaxes(0, 1))
        # One sum per part, for any number of threads: the result always has the same bits.
        y = np.zeros((_PARTS, *x.shape))
        # Each of the parts reads its share of the stored numbers once for four columns.
        work = self._near_data.size * groups / len(y)
        over_rows(add_near_product, len(y), self._near, self._near_offset, self._near_data, x, y, work=work)
        for part in self._far:
            work = part.data.size * groups / len(y)
            over_rows(
                add_far_product, len(y), part.blocks, part.ranks, part.offset, part.data, x, y, work=work
            )
        return y.sum(axis=0).swapaxes(0, 1).reshape(count, 4 * groups)[:, :columns]

    def _diagonal_of_leaves(self) -> Array:
        own = np.flatnonzero(self._near[:, 0] == self._near[:, 2])
        own = own[np.argsort(self._near[own, 0])]
        blocks = zip(self._near_offset[own], self._near_offset[own + 1], self._near[own], strict=True)
        parts = [self._near_data[start:end][:: last - first + 1] for start, end, (first, last, *_) in blocks]
        return np.concatenate(parts).astype(float)


def predicted_bytes(faces: ChargedFaces) -> int:
    """Memory that `CompressedMutualPotential` will need while it is made, from its blocks alone."""
    partition = BlockPartition.of(Clusters.of(faces, _LEAF_SIZE), _SEPARATION, NEAR_RADII)
    rows, columns = _sides(partition.near)
    far_rows, far_columns = _sides(partition.far)
    blocks = 4 * int(rows @ columns) + 4 * _EXPECTED_RANK * int((far_rows + far_columns).sum())
    # Sparse factor and transposed: 8 bytes an entry each; as much again while they are made.
    return blocks + 32 * _ROW_WIDTH * len(faces.areas) + 8 * _SCRATCH


def _sides(blocks: Index) -> tuple[Index, Index]:
    return blocks[:, 1] - blocks[:, 0], blocks[:, 3] - blocks[:, 2]


def _far_blocks(blocks: Index, points: tuple[Array, ...], tolerance: float) -> list[_FarBlocks]:
    """All far blocks, as many at a time as fit into the scratch; blocks of too high a rank are cut in four."""
    parts: list[_FarBlocks] = []
    while len(blocks):
        rows, columns = _sides(blocks)
        blocks = blocks[np.argsort(-(rows + columns), kind="stable")]
        rows, columns = _sides(blocks)
        size = _RANK_LIMIT * (rows + columns)
        heap = np.cumsum(size) // max(_SCRATCH, int(size.max()))
        failed = []
        for chosen in np.split(blocks, np.flatnonzero(np.diff(heap)) + 1):
            part, rest = _approximated(chosen, points, tolerance)
            parts.append(part)
            failed.append(rest)
        blocks = _quarters(np.concatenate(failed))
    return parts


def _approximated(blocks: Index, points: tuple[Array, ...], tolerance: float) -> tuple[_FarBlocks, Index]:
    rows, columns = _sides(blocks)
    place = np.concatenate([[0], np.cumsum(_RANK_LIMIT * (rows + columns))])
    scratch = np.empty(place[-1])
    slots, ranks = 8 * thread_count(), np.zeros(len(blocks), np.int64)
    given = (blocks, place, _RANK_LIMIT, *points, tolerance, slots, scratch, ranks)
    over_rows(approximate_far_blocks, slots, *given, work=len(scratch) / slots)
    good = ranks >= 0
    accepted, place = blocks[good], place[:-1][good]
    rows, columns = _sides(accepted)
    offset = np.concatenate([[0], np.cumsum(ranks[good] * (rows + columns))])
    data = np.empty(offset[-1], np.float32)
    packed = (accepted, place, _RANK_LIMIT, ranks[good], offset, scratch, data)
    over_rows(pack_factors, len(accepted), *packed, work=0.5 * len(data) / max(len(accepted), 1))
    return _FarBlocks(accepted, ranks[good], offset, data), blocks[~good]


def _quarters(blocks: Index) -> Index:
    r0, r1, c0, c1 = blocks.T
    rm, cm = (r0 + r1) // 2, (c0 + c1) // 2
    parts = [(r0, rm, c0, cm), (r0, rm, cm, c1), (rm, r1, c0, cm), (rm, r1, cm, c1)]
    return np.concatenate([np.column_stack(part) for part in parts])
