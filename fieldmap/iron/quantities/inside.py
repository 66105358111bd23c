"""Which element contains a point."""

import numpy as np
from numpy.typing import NDArray

from fieldmap.iron.meshing.mesh import IronMesh
from fieldmap.kernels.containment import find_tetrahedron

Array = NDArray[np.float64]


def containing_element(mesh: IronMesh, points: Array) -> NDArray[np.int64]:
    """Element (n,) that contains each point (n, 3), -1 in the air. Points on a surface may fall on either side."""
    corners = mesh.points[mesh.tets]
    lower, upper = corners.min(axis=1), corners.max(axis=1)
    element = np.full(len(points), -1)
    candidates = ((points >= lower.min(axis=0)) & (points <= upper.max(axis=0))).all(axis=1)
    if candidates.any():
        element[candidates] = find_tetrahedron(points[candidates], corners, lower, upper)
    return element
