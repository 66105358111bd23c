"""Which part of a body a face of its mesh lies on: parts that change otherwise than together carry their own faces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fieldmap.device.model import Box, Cylinder, Part, Ring, Sphere
from fieldmap.typing import Array

# Of the largest dimension: how far nodes lie off planes. They are on them, but for rounding.
_ON_PLANE = 1e-7
# Of a radius: how far corners of a curved face lie off it, which keep its volume.
_ON_CURVE = 0.05
# Cosine and sine of the angles at which a face lies in a plane, or along an axis.
_ALONG, _ACROSS = 0.999, 0.05


def lies_on(part: Part, corners: Array, normals: Array) -> NDArray[np.bool_]:
    """Which corners (f, 3) of faces, given by corners (f, 3, 3) and unit normals (f, 3), lie on a part's surface, the
    face in one of its planes or curved faces; in a plane of two parts it may reach from one to the other. None lies on
    other parts than boxes, cylinders, rings and spheres.
    """
    turn, shift = part.placement.rotation, part.placement.position
    local, normal = (corners - shift) @ turn, np.abs(normals @ turn)
    match part.shape:
        case Box(size):
            low, high = (
                np.array([-size[0] / 2, -size[1] / 2, 0.0]),
                np.array([size[0] / 2, size[1] / 2, size[2]]),
            )
            slack = _ON_PLANE * max(size)
            inside = ((local > low - slack) & (local < high + slack)).all(axis=2)
            planes = [_in_plane(local, normal, k, at, slack) for k in range(3) for at in (low[k], high[k])]
            return np.asarray(inside & np.any(planes, axis=0)[:, None])
        case Cylinder(radius, height):
            return _on_turned(local, normal, (radius,), 0.0, radius, height)
        case Ring(inner, outer, height):
            return _on_turned(local, normal, (inner, outer), inner, outer, height)
        case Sphere(radius):
            near = _is_near(np.linalg.norm(local, axis=2), radius)
            return np.repeat(near[:, None], 3, axis=1)
    return np.zeros(corners.shape[:2], bool)


def _on_turned(
    local: Array, normal: Array, radii: tuple[float, ...], inner: float, outer: float, height: float
) -> NDArray[np.bool_]:
    """On a solid of revolution with these radii between z = 0 and its height."""
    distance, slack = np.hypot(local[..., 0], local[..., 1]), _ON_PLANE * max(outer, height)
    within = (local[..., 2] > -slack) & (local[..., 2] < height + slack)
    ends = _in_plane(local, normal, 2, 0.0, slack) | _in_plane(local, normal, 2, height, slack)
    reached = (distance >= inner * (1 - _ON_CURVE)) & (distance < outer * (1 + _ON_CURVE))
    curved = np.any([_is_near(distance, radius) for radius in radii], axis=0) & (normal[:, 2] < _ACROSS)
    return np.asarray(within & (ends[:, None] & reached | curved[:, None]))


def _is_near(distance: Array, radius: float) -> NDArray[np.bool_]:
    return np.asarray((np.abs(distance - radius) < _ON_CURVE * radius).all(axis=1))


def _in_plane(local: Array, normal: Array, axis: int, at: float, slack: float) -> NDArray[np.bool_]:
    return np.asarray((np.abs(local[..., axis] - at) < slack).all(axis=1) & (normal[:, axis] > _ALONG))
