"""What the functions of this room ask of their arguments."""

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.device.model import Payload
from fieldmap.errors import InputError, OutsideMapError, Problem
from fieldmap.levitation.interface import LevitationField
from fieldmap.typing import Array


def check_payload(payload: Payload | None, where: str) -> Payload:
    """A payload with a positive mass and a positive moment."""
    if payload is None:
        raise InputError(
            Problem(
                f"{where}(payload)", "must be a payload", "None", "add a [payload] table to the device file"
            )
        )
    problems = [
        Problem(f"{where}(payload.{name})", "must be positive", f"{value}", f"give the payload a {name}")
        for name, value in (("mass", payload.mass), ("moment", payload.moment))
        if not (np.isfinite(value) and value > 0)
    ]
    if problems:
        raise InputError(*problems)
    return payload


def check_currents(source: LevitationField, currents: ArrayLike, where: str) -> Array:
    """One finite current per coil, in the map's order."""
    values = np.asarray(currents, dtype=float)
    count = len(source.coil_names)
    if values.shape != (count,) or not np.isfinite(values).all():
        raise InputError(
            Problem(
                f"{where}(currents)",
                f"must hold one finite current per coil ({', '.join(source.coil_names)})",
                f"{values.tolist()}",
                f"give {count} values in A, in that order",
            )
        )
    return values


def check_position(source: LevitationField, position: ArrayLike, where: str) -> Array:
    """A finite point (3,) inside the box."""
    point = np.asarray(position, dtype=float)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise InputError(
            Problem(where, "must be three finite coordinates in m", f"{point.tolist()}", "give x, y and z")
        )
    lower, upper = np.asarray(source.lower), np.asarray(source.upper)
    slack = 1e-12 * np.abs(upper - lower).max()
    if (point < lower - slack).any() or (point > upper + slack).any():
        raise OutsideMapError(
            Problem(
                where,
                f"must lie in the box {_millimetres(lower)} to {_millimetres(upper)} mm",
                f"{_millimetres(point)} mm",
                "choose a point inside, or a map that reaches there",
            )
        )
    return np.clip(point, lower, upper)


def _millimetres(point: Array) -> str:
    return "(" + ", ".join(f"{1e3 * x:.6g}" for x in point) + ")"
