"""Which devices the nonlinear solver takes, and what it takes for granted about their materials."""

from fieldmap.device.model import (
    Device,
    FluxBarrier,
    LinearMaterial,
    PermanentMagnet,
    SaturatingMaterial,
)
from fieldmap.errors import InputError, Problem
from fieldmap.iron.elements.bh_law import law_words

_LINEAR_INSTEAD = "solve it with linear iron: leave --nonlinear out, or in Python call fieldmap.solve_linear"


def require_soft_bodies(device: Device) -> None:
    """Raise InputError, for all bodies at once, unless every one has a B(H) law with mu_r >= 1, and there is one."""
    if not device.bodies:
        raise InputError(
            Problem(
                f"device '{device.name}'",
                "there must be iron for a nonlinear solve",
                "no bodies",
                _LINEAR_INSTEAD,
            )
        )
    problems = []
    for body in device.bodies:
        material = device.materials[body.material]
        given = ""
        if isinstance(material, FluxBarrier):
            given = "an ideal flux barrier"
        elif not isinstance(material, SaturatingMaterial) and material.mu_r < 1:
            given = f"mu_r = {material.mu_r:g}"
        if given:
            where = f"device '{device.name}', body '{body.name}'"
            problems.append(
                Problem(where, "a nonlinear solve needs mu_r >= 1 in every body", given, _LINEAR_INSTEAD)
            )
    if problems:
        raise InputError(*problems)


def material_assumptions(device: Device) -> tuple[str, ...]:
    """What the laws of the device's iron and magnets assume, one sentence each."""
    used = dict.fromkeys(body.material for body in device.bodies)
    notes = []
    for name in used:
        material = device.materials[name]
        if isinstance(material, SaturatingMaterial):
            notes.append(f"iron '{name}': {law_words(material)}; no hysteresis")
        elif isinstance(material, PermanentMagnet):
            notes.append(f"magnet '{name}': constant mu_r = {material.mu_r:g}")
        elif isinstance(material, LinearMaterial):
            notes.append(f"iron '{name}': linear, mu_r = {material.mu_r:g}")
    return tuple(notes)
