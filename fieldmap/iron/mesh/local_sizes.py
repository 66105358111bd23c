"""Element sizes that vary from place to place, and what the mesher made of them."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from fieldmap.records import Record
from fieldmap.typing import Array, Index

_PAIRS = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
# Mean edge of the mesher's tetrahedra over the size that it was asked for (median over several meshes).
_EDGE_PER_SIZE = 1.14


@dataclass(frozen=True, eq=False, repr=False)
class LocalSizes(Record):
    """Wanted element sizes (k,) at points (k, 3), m, and layers (l,), the thickness of the first layer at sharp edges
    near edge_points (l, 3). The mesher lets elements grow with the distance from the points."""

    points: Array
    sizes: Array
    edge_points: Array
    layers: Array

    def first_layer(self, places: Array) -> Array:
        """Thickness (n,) at places (n, 3): that of the nearest edge point."""
        if len(self.edge_points) == 0:
            return np.full(len(places), np.inf)
        _, nearest = cKDTree(self.edge_points).query(places)
        return self.layers[nearest]


@dataclass(frozen=True, eq=False, repr=False)
class MesherCells(Record):
    """The mesher's own tetrahedra: number (m,) of that in which each tetrahedron of the mesh lies; centres (k, 3) and
    sizes (k,) in m, in terms of what the mesher is asked for."""

    number: Index
    centres: Array
    sizes: Array

    @classmethod
    def of(cls, points: Array, tets: Index, number: Index) -> "MesherCells":
        """Of the mesher's points and tets (k, 4)."""
        corners = points[tets]
        edges = np.linalg.norm(corners[:, _PAIRS[:, 0]] - corners[:, _PAIRS[:, 1]], axis=2)
        return cls(number, corners.mean(axis=1), edges.mean(axis=1) / _EDGE_PER_SIZE)
