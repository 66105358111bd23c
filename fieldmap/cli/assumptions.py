"""What results rest on, said in words."""

from typing import Any

from fieldmap.device.materials import Material
from fieldmap.device.model import Device, Payload


def saturates(device: Device) -> bool:
    """Whether some body can saturate."""
    return any(device.materials[body.material].saturates for body in device.bodies)


def material_assumptions(device: Device) -> tuple[str, ...]:
    """The laws of the iron in use, with what holds outside the points of a table."""
    used = {body.material for body in device.bodies}
    return tuple(
        f"iron '{name}': {_law(material)}"
        for name, material in device.materials.items()
        if name in used and material.saturates
    )


def _law(material: Material) -> str:
    """The law with its initial permeability, which a formula states itself."""
    words = material.description
    return words if "initial mu_r" in words else f"{words}; initial mu_r {material.initial_mu_r:.0f}"


def payload_assumptions(payload: Payload | None) -> tuple[str, ...]:
    """Where the magnet sits in the payload, and that it is a point."""
    if payload is None:
        return ()
    depth = f"magnet_offset {1e3 * payload.magnet_offset:g} mm"
    return (f"point dipole, {depth} below the point that the sensor reads",)


def beyond_saturation_warnings(solution: Any, device: Device, currents: Any) -> tuple[str, ...]:
    """A warning for every material of linear iron of which a body carries more than it can polarise."""
    from fieldmap.iron import bodies_beyond_saturation

    warnings: dict[str, str] = {}
    for found in sorted(bodies_beyond_saturation(solution, device, currents), key=lambda body: -body.largest):
        first = (
            f"warning: linear iron does not saturate: up to {found.largest:.3g} T, while '{found.material}' polarises "
            f"{found.most:.3g} T at most; above that are"
        )
        share = f" {100 * found.share:.3g} % of '{found.body}'"
        before = warnings.get(found.material, "")
        warnings[found.material] = f"{before},{share}" if before else first + share
    return tuple(
        f"{text}. Such an answer does not hold: --nonlinear follows a B-H law" for text in warnings.values()
    )
