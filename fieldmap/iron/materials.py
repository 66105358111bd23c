"""Data of a device's materials for the solvers: the constant permeability of linear iron, or the laws of iron that
saturates, each with its assumptions."""

from dataclasses import dataclass

import numpy as np

from fieldmap.arguments import finite_number, raise_all
from fieldmap.device.materials import Material, SaturatingMaterial
from fieldmap.device.materials.linear import of_permeability
from fieldmap.device.model import Device
from fieldmap.errors import InputError, Problem
from fieldmap.iron.mesh.mesh import IronMesh
from fieldmap.records import Record
from fieldmap.typing import Array

# Relative permeability of an ideal flux barrier: it lets through 1e-4 of the flux of air.
BARRIER_MU_R = 1e-4
_LINEAR_INSTEAD = "solve it with linear iron: leave --nonlinear out, or in Python call fieldmap.solve_linear"


@dataclass(frozen=True, eq=False, repr=False)
class BodyProperties(Record):
    """Relative permeability (b,) and remanence (b, 3) in T of every body, and how they were chosen.

    weakest: the smallest permeability of all bodies and joints.
    """

    mu_r: Array
    remanence: Array
    assumptions: tuple[str, ...]

    weakest: float = np.inf

    def on(self, mesh: IronMesh) -> "BodyProperties":
        """The properties of the mesh's bodies: the sheets between bodies come last."""
        sheets = len(mesh.body_names) - len(self.mu_r)
        if sheets == 0:
            return self
        value = np.concatenate([self.mu_r, [sheet.mu_r for sheet in mesh.sheets]])
        remanence = np.concatenate([self.remanence, np.zeros((sheets, 3))])
        return BodyProperties(value, remanence, self.assumptions, self.weakest)


def materials_on(device: Device, mesh: IronMesh) -> list[Material]:
    """The materials of the bodies of a mesh: the device's bodies, then the sheets between them."""
    known = [device.materials[body.material] for body in device.bodies]
    return [*known, *(of_permeability(sheet.name, sheet.mu_r) for sheet in mesh.sheets)]


def body_properties(device: Device, mu_r: float | None) -> BodyProperties:
    """Constant permeability of every body. `mu_r` replaces the value of soft iron (not of barriers or magnets).

    Raises InputError unless mu_r is a finite number > 0.
    """
    if mu_r is not None and not (finite_number(mu_r) and mu_r > 0):
        must_hold = "the relative permeability must be a finite number > 0"
        remedy = "give for instance mu_r=1000, or None for the device's own: of a B-H table its initial slope"
        raise InputError.of("solve_linear, mu_r", must_hold, repr(mu_r), remedy)
    value = np.empty(len(device.bodies))
    remanence = np.zeros((len(device.bodies), 3))
    notes: dict[str, None] = {}
    for k, body in enumerate(device.bodies):
        material = device.materials[body.material]
        value[k], note = _constant_mu_r(material, mu_r)
        notes[note] = None
        remanence[k] = material.remanence
    joints = (joint.description for joint in device.joints)
    weakest = min([*value, *(joint.mu_r for joint in device.joints)], default=np.inf)
    return BodyProperties(value, remanence, (*notes, *joints, *device_notes(device)), weakest)


def device_notes(device: Device) -> tuple[str, ...]:
    """Sentences on the device's background and on the keys that were changed in its file; empty without either."""
    changed = (device.changed,) if device.changed else ()
    if device.background is None:
        return changed
    flux = ", ".join(f"{1e3 * x:.4g}" for x in device.background.flux_density)
    gradient = "" if device.background.gradient is None else " with a uniform gradient"
    return (f"background of ({flux}) mT{gradient}, which no current drives", *changed)


def _constant_mu_r(material: Material, mu_r: float | None) -> tuple[float, str]:
    who = f"{material.role} '{material.name}'"
    if material.role == "flux barrier":
        return BARRIER_MU_R, f"{who}: mu_r = {BARRIER_MU_R:g}"
    if material.role == "iron" and mu_r is not None:
        return mu_r, f"{who}: linear, mu_r = {mu_r:g} as requested"
    slope = material.initial_mu_r
    if isinstance(material, SaturatingMaterial):
        memory = f", {material.left_out}" if material.coercive_field else ""
        return slope, f"{who}: linear, mu_r = {slope:.0f}, {material.initial_slope}; no saturation{memory}"
    return slope, f"{who}: {material.description}"


def require_soft_bodies(device: Device) -> None:
    """Raise InputError, with a problem for each fault, unless there are bodies and all of them and all joints have a
    B(H) law with mu_r >= 1."""
    if not device.bodies:
        must_hold = "there must be iron for a nonlinear solve"
        raise InputError.of(f"device '{device.name}'", must_hold, "no bodies", _LINEAR_INSTEAD)
    weak: list[tuple[str, str, str]] = []
    for body in device.bodies:
        material, where = device.materials[body.material], f"body '{body.name}'"
        if material.role == "flux barrier":
            weak.append(("body", where, material.description))
        elif not material.saturates and material.initial_mu_r < 1:
            weak.append(("body", where, f"mu_r = {material.initial_mu_r:g}"))
    thin = (joint for joint in device.joints if joint.mu_r < 1)
    weak += (("joint", joint.description, f"mu_r = {joint.mu_r:g}") for joint in thin)
    must_hold = "a nonlinear solve needs mu_r >= 1 in every"
    raise_all(
        Problem(f"device '{device.name}', {where}", f"{must_hold} {kind}", given, _LINEAR_INSTEAD)
        for kind, where, given in weak
    )


def material_assumptions(device: Device) -> tuple[str, ...]:
    """The assumptions of the laws of the device's iron and magnets, one sentence each."""
    notes = []
    for name in dict.fromkeys(body.material for body in device.bodies):
        material = device.materials[name]
        limit = f"; {material.left_out}" if isinstance(material, SaturatingMaterial) else ""
        notes.append(f"{material.role} '{name}': {material.description}{limit}")
    return (*notes, *(joint.description for joint in device.joints), *device_notes(device))
