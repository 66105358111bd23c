"""Reluctivity and remanence of every element, from the materials of the bodies."""

from dataclasses import dataclass

import numpy as np

from fieldmap.device.materials import Material, SaturatingMaterial
from fieldmap.device.model import Device
from fieldmap.errors import InputError, Problem
from fieldmap.iron.elements.bh_law import LawTables
from fieldmap.typing import Array

# An ideal flux barrier is a body of this relative permeability: what it lets through is 1e-4 of what air would.
BARRIER_MU_R = 1e-4


@dataclass(frozen=True, eq=False)
class BodyProperties:
    """Relative permeability (b,) and remanence (b, 3) in T of every body, and how they were chosen."""

    mu_r: Array
    remanence: Array
    assumptions: tuple[str, ...]


def body_properties(device: Device, mu_r: float | None) -> BodyProperties:
    """Constant permeability of every body. `mu_r` replaces that of soft iron (not of barriers or magnets).

    Raises InputError unless mu_r is a finite number > 0.
    """
    if mu_r is not None and not (np.isfinite(mu_r) and mu_r > 0):
        raise InputError(
            Problem(
                "solve_linear, mu_r",
                "the relative permeability must be a finite number > 0",
                repr(mu_r),
                "give for instance mu_r=1000, or None for the device file's own value",
            )
        )
    value = np.empty(len(device.bodies))
    remanence = np.zeros((len(device.bodies), 3))
    notes: dict[str, None] = {}
    for k, body in enumerate(device.bodies):
        material = device.materials[body.material]
        value[k], note = _constant_mu_r(material, mu_r)
        notes[note] = None
        remanence[k] = material.remanence
    return BodyProperties(value, remanence, tuple(notes))


def _constant_mu_r(material: Material, mu_r: float | None) -> tuple[float, str]:
    who = f"{material.role} '{material.name}'"
    if material.role == "flux barrier":
        return BARRIER_MU_R, f"{who}: mu_r = {BARRIER_MU_R:g}"
    if material.role == "iron" and mu_r is not None:
        return mu_r, f"{who}: linear, mu_r = {mu_r:g} as requested"
    slope = material.initial_mu_r
    if isinstance(material, SaturatingMaterial):
        return slope, f"{who}: linear, mu_r = {slope:.0f}, {material.initial_slope}; no saturation"
    return slope, f"{who}: {material.description}"


def straight_laws(mu_r: Array) -> LawTables:
    """One straight law b = mu_r h for each body (b,)."""
    count = len(mu_r)
    coefficients = np.zeros((count, 4))
    coefficients[:, 2] = mu_r
    return LawTables(np.arange(count + 1), np.zeros(count), coefficients, np.full((2, count), np.inf))
