"""Which devices the nonlinear solver takes, and what it takes for granted about their materials."""

from fieldmap.device.model import Device
from fieldmap.errors import InputError, Problem

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
        if material.role == "flux barrier":
            given = material.description
        elif not material.saturates and material.initial_mu_r < 1:
            given = f"mu_r = {material.initial_mu_r:g}"
        if given:
            where = f"device '{device.name}', body '{body.name}'"
            problems.append(
                Problem(where, "a nonlinear solve needs mu_r >= 1 in every body", given, _LINEAR_INSTEAD)
            )
    if problems:
        raise InputError(*problems)


def material_assumptions(device: Device) -> tuple[str, ...]:
    """What the laws of the device's iron and magnets assume, one sentence each."""
    notes = []
    for name in dict.fromkeys(body.material for body in device.bodies):
        material = device.materials[name]
        limit = "; no hysteresis" if material.saturates else ""
        notes.append(f"{material.role} '{name}': {material.description}{limit}")
    return tuple(notes)
