"""S3 and S6: the magnets, and the lumped model of their levitation."""

from typing import Any

import numpy as np

from fieldmap.constants import MU0
from fieldmap.control import lumped_magnet_from_lift_currents
from fieldmap.device import read_device


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
        "payload_mass": 1e3 * payload.mass,
        "payload_moment": payload.moment,
    }


def _moment(remanence: float, volume: float) -> float:
    """(2-12), A m^2."""
    return remanence * volume / MU0


def lumped_model(inputs: dict[str, Any]) -> dict[str, Any]:
    """(2-18)..(2-22) against differences of the nonlinear equation, and against the identified plant."""
    magnet = lumped_magnet_from_lift_currents(
        inputs["current_at_zero_A"], 1e3 * inputs["slope_A_per_mm"], 1e-3 * inputs["mass_g"]
    )
    z = 1e-3 * inputs["depth_mm"]
    current, plant = magnet.equilibrium_current(z), magnet.plant(z)
    dz, di = 1e-5 * z, 1e-5 * current
    by_z = (magnet.acceleration(z + dz, 0, current) - magnet.acceleration(z - dz, 0, current)) / (2 * dz)
    by_i = (magnet.acceleration(z, 0, current + di) - magnet.acceleration(z, 0, current - di)) / (2 * di)
    return {
        "stiffness_term": plant.A[1, 0] / by_z,
        "current_term": plant.B[1, 0] / by_i,
        "sign_of_gain": float(np.sign(plant.B[1, 0])),
        "sign_of_damping": float(np.sign(inputs["identified_denominator"][1])),
        "product_of_poles": float(np.linalg.det(plant.A)),
    }
