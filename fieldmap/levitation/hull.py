"""The convex hull of points in space, as a solid whose triangles face outward."""

from __future__ import annotations

import numpy as np
import scipy

from fieldmap.typing import Array, Index

# A hull thinner than this share of its length has no volume.
_THIN = 1e-9


def hull_of(points: Array) -> tuple[Index, Index, float]:
    """Which of points (n, 3) are corners of their hull, (v,); triangles (t, 3), of numbers of corners, outward side
    first; and the volume. Of a flat one no triangles, 0, and all points that differ.
    """
    size = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if len(size) < 3 or size[2] <= _THIN * size[0]:
        kept = np.unique(points, axis=0, return_index=True)[1]
        return kept, np.empty((0, 3), dtype=np.int64), 0.0
    hull = scipy.spatial.ConvexHull(points)
    kept = hull.vertices
    number = np.full(len(points), -1)
    number[kept] = np.arange(len(kept))
    triangles = number[hull.simplices]
    corners = points[kept]
    # Qhull leaves the sense of its triangles open.
    edges = corners[triangles[:, 1:]] - corners[triangles[:, :1]]
    inward = np.einsum("ti,ti->t", np.cross(edges[:, 0], edges[:, 1]), hull.equations[:, :3]) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return kept, triangles, float(hull.volume)
