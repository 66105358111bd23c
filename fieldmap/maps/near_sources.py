"""Least distance of the box of a map from iron, magnets and wires.

The field is singular at edges of the iron and on wires, but an interpolant uses its values at the nodes only. In a box
at the distance d from a pole, with nodes h apart, lookups of B have errors of up to 1 % (h / d)^3 of the largest B
(measured for h / d from 2 to 1/3, docs/recipes.md). Bodies closer than this are refused before any work. Other sources
in the box, such as a wire without thickness, show in the error of the finished map.
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

# Smallest error, a share of B, for which this law was measured. Below it the error falls faster with the distance.
_MEASURED = 3e-4
# A map with a larger error than this share of its largest B is refused.
_USELESS = 0.1
# Allowed error of lookups, a share of B, if the recipe states no accuracy: the error in a box one spacing away.
_ALLOWED = 1e-2
_ERROR_AT_ONE_SPACING = 1e-2
_MILLIMETRES = 1e3


def least_distance(spacing: float, error: float) -> float:
    """The distance (m) at which lookups between nodes `spacing` (m) apart have an error, a share of B.

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
        `currents.accuracy` of a recipe of saturating iron, a share of B. The error of lookups may be `HELD_OUT` times
        this, like the error at tested states. None for linear iron, with an error of up to 1 %.
    accept_error
        Accept any distance. A box that touches a body is refused anyway.

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
    """Refuse a finished map with an error of lookups above a tenth of its field.

    Parameters
    ----------
    largest
        Largest B of the map, T: `largest_field`.
    error, bounds
        Measured error, and certified bounds.

    Raises
    ------
    RecipeError
        For such an error, and for an error or a bound that is not finite.
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
