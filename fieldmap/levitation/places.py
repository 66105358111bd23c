"""Places of a payload in the box of a field: checks of one place, and the grid of a search."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_vector
from fieldmap.device.model import Payload
from fieldmap.errors import InputError, OutsideMapError
from fieldmap.field import Bounds
from fieldmap.typing import Array

SEARCH_SHAPE = (7, 7, 15)


def check_position(bounds: Bounds, position: ArrayLike, where: str) -> Array:
    """A finite point (3,) inside a box, m. Raises InputError and OutsideMapError."""
    point = check_point(position, where)
    lower, upper = bounds
    slack = 1e-12 * np.abs(upper - lower).max()
    if (point < lower - slack).any() or (point > upper + slack).any():
        must_hold = f"must lie in the box {_millimetres(lower)} to {_millimetres(upper)} mm"
        remedy = "choose a point inside, or a map that reaches there; of a payload with volume_level = 1 the magnets'"
        remedy += " middles alone must lie in the map"
        raise OutsideMapError.of(where, must_hold, f"{_millimetres(point)} mm", remedy)
    return np.clip(point, lower, upper)


def check_point(position: ArrayLike, where: str) -> Array:
    """A finite point (3,), m. Raises InputError."""
    return check_vector(where, position, "give x, y and z in m")


def check_centre(bounds: Bounds, payload: Payload, position: ArrayLike, where: str) -> Array:
    """A finite centre (3,) of a payload, m. The centre of a point dipole must lie in the box of the field; for a larger
    body the box of centres depends on its orientation (`MagnetBalance.box`). Raises InputError and OutsideMapError."""
    return check_point(position, where) if payload.extended else check_position(bounds, position, where)


def box_of_centres(bounds: Bounds, arms: Array) -> Bounds:
    """The box of centres of a body at which all its points lie in the box of the field, m.

    The centre of a body may lie outside the field's box if all its points lie to one side of the centre.

    Parameters
    ----------
    bounds
        The box of the field, m.
    arms
        Points of the body (n, 3), relative to its centre, m.

    Returns
    -------
    Bounds
        Lower and upper corner (3,), m.

    Raises
    ------
    InputError
        For a body that is larger than the field's box.
    """
    lower, upper = bounds
    low, high = arms.min(axis=0), arms.max(axis=0)
    # Room for rounding in the sum of centre and arm.
    low, high = low - 1e-9 * np.abs(low), high + 1e-9 * np.abs(high)
    if (high - low > upper - lower).any():
        must_hold = "the magnets and the middles of the soft iron must fit into the field's box"
        received = (
            f"they extend over {_millimetres(high - low)} mm, the box over {_millimetres(upper - lower)} mm"
        )
        remedy = "check the centres of the pieces, make a larger map, or take point dipoles: volume_level = 1"
        raise InputError.of("payload", must_hold, received, remedy)
    return lower - low, upper - high


def search_grid(box: Bounds) -> Array:
    """Points (n, 3) that span the box."""
    lower, upper = box
    # Slightly inside the box, so that rounding does not put a point outside.
    margin = 1e-9 * (upper - lower)
    return grid_points(lower + margin, upper - margin, SEARCH_SHAPE)


def grid_points(lower: Array, upper: Array, counts: tuple[int, ...]) -> Array:
    """Points (n, d) of a grid between two corners (d,), the last axis fastest. counts: points along each axis."""
    axes = map(np.linspace, lower, upper, counts)
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(counts))


def _millimetres(point: Array) -> str:
    return "(" + ", ".join(f"{1e3 * x:.6g}" for x in point) + ")"
