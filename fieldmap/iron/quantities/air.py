"""Points: which element contains them, those in the air, and means over a body."""

from __future__ import annotations

from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.errors import InputError, Problem
from fieldmap.iron.mesh.mesh import IronMesh, volumes
from fieldmap.kernels.iron.containment import find_tetrahedron
from fieldmap.threads import over_rows
from fieldmap.typing import Array


def containing_element(mesh: IronMesh, points: Array) -> NDArray[np.int64]:
    """Element (n,) that contains each point (n, 3), -1 in the air. Points on a surface may fall on either side."""
    boxes = _boxes(mesh)
    element = np.full(len(points), -1)
    candidates = ((points >= boxes.least) & (points <= boxes.largest)).all(axis=1)
    if candidates.any():
        chosen, found = points[candidates], element[candidates]
        arrays = (chosen, boxes.corners, boxes.lower, boxes.upper, found)
        over_rows(find_tetrahedron, len(chosen), *arrays, work=len(boxes.corners))
        element[candidates] = found
    return element


class _Boxes(NamedTuple):
    """Corners (m, 4, 3) of the elements, the boxes around them, lower and upper (m, 3), and around all, (3,)."""

    corners: Array
    lower: Array
    upper: Array
    least: Array
    largest: Array


# A field is asked for at one point after the other, and the boxes take longer than the field. They do not travel with
# the mesh to other processes.
_KNOWN_BOXES: WeakKeyDictionary[IronMesh, _Boxes] = WeakKeyDictionary()


def _boxes(mesh: IronMesh) -> _Boxes:
    known = _KNOWN_BOXES.get(mesh)
    if known is None:
        corners = mesh.points[mesh.tets]
        lower, upper = corners.min(axis=1), corners.max(axis=1)
        known = _KNOWN_BOXES[mesh] = _Boxes(corners, lower, upper, lower.min(axis=0), upper.max(axis=0))
    return known


def checked_points(points: ArrayLike) -> tuple[Array, bool]:
    """Points (n, 3) and whether a single point (3,) was given. Raises InputError unless finite and of such a shape."""
    x = np.ascontiguousarray(points, dtype=float)
    if x.shape[-1:] != (3,) or x.ndim > 2 or not np.isfinite(x).all():
        raise InputError(
            Problem(
                "points",
                "points must be finite and of shape (n, 3) or (3,)",
                f"shape {x.shape}",
                "give x, y, z in m",
            )
        )
    return np.atleast_2d(x), x.ndim == 1


def refuse_inside(mesh: IronMesh | None, x: Array) -> None:
    """Raise InputError if a point (n, 3) lies inside the iron, where the solver defines no gradient."""
    if mesh is None:
        return
    element = containing_element(mesh, x)
    inside = np.flatnonzero(element >= 0)
    if len(inside):
        name = mesh.body_names[mesh.body[element[inside[0]]]]
        raise InputError(
            Problem(
                "points",
                "the gradient is defined outside the iron only",
                f"{len(inside)} of {len(x)} points inside, the first at {x[inside[0]]} m in body '{name}'",
                "keep the points in the air",
            )
        )


def mean_over_body(mesh: IronMesh | None, body: str, flux_density: Array) -> Array:
    """Volume mean (3,) over a named body of the flux density (e, 3). Raises InputError for an unknown name."""
    names = mesh.body_names if mesh is not None else ()
    if mesh is None or body not in names:
        raise InputError(
            Problem(
                "flux_density, body",
                f"the name must be one of {', '.join(names)}",
                repr(body),
                "use one of these",
            )
        )
    mine = mesh.body == names.index(body)
    volume = volumes(mesh.points, mesh.tets)[mine]
    return volume @ flux_density[mine] / volume.sum()
