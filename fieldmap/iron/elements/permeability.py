"""Reluctivity and remanence of every element, from the materials of the bodies."""

from dataclasses import dataclass

import numpy as np

from fieldmap.device.model import BHTable, Device, FluxBarrier, LinearMaterial, PermanentMagnet
from fieldmap.errors import InputError, Problem
from fieldmap.iron.elements.bh_law import LawTables, initial_mu_r
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
        if isinstance(material, PermanentMagnet):
            remanence[k] = material.remanence
    return BodyProperties(value, remanence, tuple(notes))


def _constant_mu_r(material, mu_r: float | None) -> tuple[float, str]:
    if isinstance(material, FluxBarrier):
        return BARRIER_MU_R, f"flux barrier '{material.name}': mu_r = {BARRIER_MU_R:g}"
    if isinstance(material, PermanentMagnet):
        return material.mu_r, f"magnet '{material.name}': constant mu_r = {material.mu_r:g}"
    if mu_r is not None:
        return mu_r, f"iron '{material.name}': linear, mu_r = {mu_r:g} as requested"
    if isinstance(material, LinearMaterial):
        return material.mu_r, f"iron '{material.name}': linear, mu_r = {material.mu_r:g}"
    slope = initial_mu_r(material)
    of_what = "law"
    if isinstance(material, BHTable):
        of_what = f"B-H table ({material.below} below the first point)"
    return (
        slope,
        f"iron '{material.name}': linear, mu_r = {slope:.0f}, the initial slope of its {of_what}; no saturation",
    )


def straight_laws(mu_r: Array) -> LawTables:
    """One straight law b = mu_r h for each body (b,)."""
    count = len(mu_r)
    coefficients = np.zeros((count, 4))
    coefficients[:, 2] = mu_r
    return LawTables(np.arange(count + 1), np.zeros(count), coefficients, np.full((2, count), np.inf))
