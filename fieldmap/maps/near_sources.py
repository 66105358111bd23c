"""How near the box of a map may come to iron, magnets and wires.

At edges of the iron and on wires the field is singular, and an interpolant knows it at nodes only. In a box at the
distance d of a pole, with nodes h apart, lookups of B are off by up to 1 % (h / d)^3 of its largest value (measured
for h / d from 2 to 1/3, docs/recipes.md). Bodies are refused by this distance before any work. Anything else in the
box, such as a wire without thickness, shows in the error of the finished map.
"""

from collections.abc import Mapping

import numpy as np

from fieldmap.curves import percent
from fieldmap.device.model import Device
from fieldmap.errors import RecipeError
from fieldmap.inputs.document import AtKey
from fieldmap.iron.geometry.checks import distances_to_workspace
from fieldmap.store import FieldError, Grid, MapData
from fieldmap.store.stated_accuracy import HELD_OUT

# Below this the error falls faster than it was measured to.
_MEASURED = 3e-4
# A map that is off by more than this share of its largest B is of no use.
_USELESS = 0.1
# Of lookups, a share of B, where a recipe asks for no accuracy: that of a box one spacing away.
_ALLOWED = 1e-2
_ERROR_AT_ONE_SPACING = 1e-2
_MILLIMETRES = 1e3


def least_distance(spacing: float, error: float) -> float:
    """The distance (m) at which lookups between nodes `spacing` (m) apart are off by an error, a share of B.

    >>> round(least_distance(2e-3, 1e-3), 5)
    0.00431
    """
    return spacing * float(np.cbrt(_ERROR_AT_ONE_SPACING / max(error, _MEASURED)))


def require_distance(device: Device, grid: Grid, accuracy: float | None, accept_error: bool = False) -> None:
    """Refuse a box that comes too near to iron or magnets for the accuracy of lookups.

    Parameters
    ----------
    device
        The device, with the box as its workspace.
    grid
        Nodes in the box.
    accuracy
        `currents.accuracy` of a recipe of saturating iron, a share of B: lookups may be off by `HELD_OUT` times as
        much, as its states. None for linear iron: lookups may be off by 1 %.
    accept_error
        Whether any distance will do. A box that touches a body is refused all the same.

    Raises
    ------
    RecipeError
        One Problem for every body that is too near.
    """
    spacing = float(np.max(grid.spacing))
    allowed = _ALLOWED if accuracy is None else HELD_OUT * accuracy
    reason = "" if accuracy is None else " (twice currents.accuracy)"
    least = least_distance(spacing, allowed)
    problems = []
    for body, distance in distances_to_workspace(device, least).items():
        if accept_error and distance > 0.0:
            continue
        must_hold = (
            f"must keep {_MILLIMETRES * least:.3g} mm from iron and magnets, for lookups within {percent(allowed)} of "
            f"B{reason} between nodes {_MILLIMETRES * spacing:.3g} mm apart"
        )
        finer = _MILLIMETRES * spacing * distance / least
        remedy = "move the box away"
        if distance > 0.0:
            remedy += f", take spacing_mm = {finer:.2g}, or accept the error (--accept-error)"
        problems.append(
            AtKey("box", must_hold, f"{_MILLIMETRES * distance:.3g} mm from body '{body}'", remedy)
        )
    if problems:
        raise RecipeError(*problems)


def require_use(largest: float, error: FieldError, bounds: Mapping[str, FieldError]) -> None:
    """Refuse a finished map whose lookups are off by a tenth of its field.

    Parameters
    ----------
    largest
        Largest sum of its fields' B at a node, T: `largest_field`.
    error, bounds
        Its measured error, and those certified.

    Raises
    ------
    RecipeError
        For such an error, and for one that is not finite.
    """
    numbers = [value for one in (error, *bounds.values()) for value in (one.flux_density, one.gradient)]
    if np.isfinite(numbers).all() and error.flux_density <= _USELESS * largest:
        return
    must_hold = f"lookups must be within {percent(_USELESS)} of the largest B, {largest:.3g} T"
    received = f"{error.flux_density:.3g} T and {error.gradient:.3g} T/m off at the points tried"
    remedy = "keep wires, edges of magnets and point dipoles out of the box, or take a finer spacing"
    raise RecipeError(AtKey("box", must_hold, received, remedy))


def largest_field(data: MapData) -> float:
    """Largest sum over the fields of the norms of B at a node, coils at their reference currents, T."""
    sizes = np.linalg.norm(data.flux_density, axis=-1)
    return float(np.einsum("f,fxyz->xyz", data.field_scale, sizes).max())
