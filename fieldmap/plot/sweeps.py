"""Closed surfaces swept out by rings of points. Lengths in mm."""

import numpy as np
import pyvista as pv

from fieldmap.typing import Array


def closed_tube(rings: Array) -> pv.PolyData:
    """Surface through k rings of n points, (k, n, 3), closed around each ring and from the last to the first."""
    k, n, _ = rings.shape
    index = np.arange(k * n).reshape(k, n)
    ahead, beside = np.roll(index, -1, axis=0), np.roll(index, -1, axis=1)
    corner = np.roll(ahead, -1, axis=1)
    quads = np.stack([np.full_like(index, 4), index, beside, corner, ahead], axis=-1)
    surface = pv.PolyData(rings.reshape(-1, 3), faces=quads.ravel())
    return surface.triangulate()


def revolved(profile: Array, segments: int = 96) -> pv.PolyData:
    """Closed polygon `profile` (k, 2) of (r, z) turned about the z axis."""
    angle = 2.0 * np.pi * np.arange(segments) / segments
    r, z = profile[:, :1], profile[:, 1:]
    rings = np.stack([r * np.cos(angle), r * np.sin(angle), np.broadcast_to(z, (len(z), segments))], axis=-1)
    return closed_tube(rings)
