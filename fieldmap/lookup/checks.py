"""Arguments of a lookup, made into arrays that a kernel may read."""

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.errors import InputError, OutsideMapError, Problem
from fieldmap.typing import Array


def checked_currents(values: ArrayLike, coil_names: tuple[str, ...], n_points: int) -> Array:
    """`values` as (n_coils,) or (n_points, n_coils). Raises InputError for other shapes."""
    n_coils = len(coil_names)
    try:
        array = np.require(values, np.float64, ["C", "W"])
    except (TypeError, ValueError):
        array = np.empty((0, 0, 0))
    if array.shape in ((n_coils,), (n_points, n_coils)):
        return array
    wanted = f"one current per coil {', '.join(coil_names)}: shape ({n_coils},) or ({n_points}, {n_coils})"
    received = f"shape {array.shape}" if array.size else repr(values)[:80]
    raise InputError(_problem("currents", wanted, received))


def outside_error(points: Array, outside: int, lower: Array, upper: Array) -> OutsideMapError:
    """The error for points of which `outside` lie outside the box from lower to upper."""
    with np.errstate(invalid="ignore"):
        excess = np.max(np.maximum(lower - points, points - upper), axis=1)
    worst = points[np.nanargmax(excess)]
    box = " to ".join(str(tuple(round(float(x) * 1e3, 6) for x in corner)) for corner in (lower, upper))
    return OutsideMapError(
        Problem(
            "points",
            f"every point lies in the map's box, {box} mm",
            f"{outside} of {len(points)} points outside, the farthest at "
            f"{tuple(round(float(x) * 1e3, 6) for x in worst)} mm",
            'stay in the box, make a larger map, or open it with outside="nan" to get NaN there',
        )
    )


def _problem(name: str, must_hold: str, received: str) -> Problem:
    return Problem(
        f"lookup, {name}", must_hold, received, "give arrays in metres and amperes, coil order as coil_names"
    )
