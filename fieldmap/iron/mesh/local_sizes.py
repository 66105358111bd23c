"""Element sizes that vary from place to place, and what the mesher made of them."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from fieldmap.records import Record
from fieldmap.typing import Array, Index

_PAIRS = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
# Mean edge of the mesher's tetrahedra over the size that it was asked for (median over several meshes).
_EDGE_PER_SIZE = 1.14
# Ratio of neighbouring element sizes where a fine body meets a coarse one.
GRADING = 0.3
_NEIGHBOURS = 6


@dataclass(frozen=True, eq=False, repr=False)
class LocalSizes(Record):
    """Wanted element sizes (k,) at points (k, 3), m, and layers (l,), the thickness of the first layer at sharp edges
    near edge_points (l, 3). The mesher lets elements grow with the distance from the points."""

    points: Array
    sizes: Array
    edge_points: Array
    layers: Array

    def asked_at(self, places: Array) -> Array:
        """Sizes (n,) that elements at places (n, 3) may have: those of the nearest points, growing from there."""
        if len(self.points) == 0:
            return np.full(len(places), np.inf)
        distance, nearest = cKDTree(self.points).query(
            places, list(range(1, min(_NEIGHBOURS, len(self.points)) + 1))
        )
        return np.asarray((self.sizes[nearest] + GRADING * distance).min(axis=1), np.float64)

    def first_layer(self, places: Array) -> Array:
        """Thickness (n,) at places (n, 3): that of the nearest edge point."""
        if len(self.edge_points) == 0:
            return np.full(len(places), np.inf)
        _, nearest = cKDTree(self.edge_points).query(places)
        return self.layers[nearest]


@dataclass(frozen=True, eq=False, repr=False)
class MesherCells(Record):
    """The mesher's own tetrahedra: number (m,) of that in which each tetrahedron of the mesh lies; centres (k, 3) and
    sizes (k,) in m, in terms of what the mesher is asked for.

    In thin walls it makes edges longer than it was asked for; there the size that was asked for counts, so that a
    smaller one has an effect."""

    number: Index
    centres: Array
    sizes: Array

    @classmethod
    def of(
        cls, points: Array, tets: Index, number: Index, largest: Array, local: LocalSizes | None = None
    ) -> "MesherCells":
        """Of the mesher's points and tets (k, 4), which were to be no larger than `largest` (k,) and `local`."""
        corners = points[tets]
        edges = np.linalg.norm(corners[:, _PAIRS[:, 0]] - corners[:, _PAIRS[:, 1]], axis=2)
        centres = corners.mean(axis=1)
        asked = largest if local is None else np.minimum(largest, local.asked_at(centres))
        return cls(number, centres, np.minimum(edges.mean(axis=1) / _EDGE_PER_SIZE, asked))
