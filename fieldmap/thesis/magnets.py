"""S3: volume, mass and dipole moment of the magnets."""

from typing import Any

import numpy as np
import scipy.constants

from fieldmap.device import read_device
from fieldmap.thesis.registry import Ours


def sphere_and_microrobot(inputs: dict[str, Any]) -> dict[str, Any]:
    """Table 2-2 and 3.8: volumes of sphere and cylinder, mass, and the moment (2-12)."""
    sphere = np.pi / 6.0 * (1e-3 * inputs["sphere_diameter_mm"]) ** 3
    cylinder = np.pi / 4.0 * (1e-3 * inputs["magnet_diameter_mm"]) ** 2 * 1e-3 * inputs["magnet_height_mm"]
    payload = read_device("drive_unit").payload
    if payload is None:
        raise LookupError("drive_unit.toml has no payload")
    return {
        "sphere_volume": sphere,
        "sphere_mass": inputs["sphere_density"] * sphere,
        "sphere_moment": _moment(inputs["sphere_remanence_T"], sphere),
        "magnet_moment": _moment(inputs["magnet_remanence_T"], cylinder),
        "payload_mass": Ours(
            1e3 * payload.mass, ("a weighing of theirs; ours is what drive_unit.toml holds",)
        ),
        "payload_moment": Ours(
            payload.moment, ("what drive_unit.toml gives from diameter, height, remanence",)
        ),
    }


def _moment(remanence: float, volume: float) -> float:
    """(2-12), A m^2."""
    return remanence * volume / scipy.constants.mu_0
