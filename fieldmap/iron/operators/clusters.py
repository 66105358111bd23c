"""Clusters of faces that lie together, and the pairs of clusters that see each other from afar.

A balanced binary tree: every cluster is cut at the median of its longest side, so that all leaves are on one level
and differ by one face at most. Faces are numbered anew, leaf by leaf; a cluster is a run of these numbers.
"""

from dataclasses import dataclass

import numpy as np

from fieldmap.iron.operators.surface import ChargedFaces
from fieldmap.records import Record
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
        """Cut until no leaf has more than `leaf_size` faces."""
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
        centres, radii = faces.centres[order], faces.radii[order]
        starts = [ends[:-1] for ends in offset]
        return cls(
            order,
            tuple(offset),
            tuple(np.minimum.reduceat(centres, s) for s in starts),
            tuple(np.maximum.reduceat(centres, s) for s in starts),
            tuple(np.maximum.reduceat(radii, s) for s in starts),
        )

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
        for level in range(len(clusters.offset)):
            is_far = _is_far(clusters, level, pairs, separation, nearness)
            far.append(_ranges(clusters.offset[level], pairs[is_far]))
            pairs = pairs[~is_far]
            if level + 1 < len(clusters.offset):
                pairs = _children(pairs)
        return cls(np.concatenate(far), _ranges(clusters.offset[-1], pairs), pairs)


def _is_far(clusters: Clusters, level: int, pairs: Index, separation: float, nearness: float):
    lower, upper, radius = clusters.lower[level], clusters.upper[level], clusters.radius[level]
    a, b = pairs.T
    gap = np.maximum(0.0, np.maximum(lower[a] - upper[b], lower[b] - upper[a]))
    distance = np.linalg.norm(gap, axis=1)
    size = np.linalg.norm(upper - lower, axis=1)
    smaller = np.minimum(size[a], size[b])
    return (distance > separation * smaller) & (distance > nearness * (radius[a] + radius[b]))


def _children(pairs: Index) -> Index:
    """Pairs (a, b), a >= b, of the next level below these pairs."""
    a, b = pairs.T
    off = a != b
    return np.concatenate(
        [
            np.column_stack([2 * a, 2 * b]),
            np.column_stack([2 * a + 1, 2 * b]),
            np.column_stack([2 * a + 1, 2 * b + 1]),
            np.column_stack([2 * a, 2 * b + 1])[off],
        ]
    )


def _ranges(offset: Index, pairs: Index) -> Index:
    a, b = pairs.T
    return np.column_stack([offset[a], offset[a + 1], offset[b], offset[b + 1]])
