"""What results rest on, said in words."""

from fieldmap.device.model import BHTable, Device, Payload


def has_bh_table(device: Device) -> bool:
    """Whether some body can saturate."""
    return any(isinstance(device.materials[body.material], BHTable) for body in device.bodies)


def material_assumptions(device: Device) -> tuple[str, ...]:
    """How the B-H tables in use are extended."""
    used = {body.material for body in device.bodies}
    return tuple(
        f"B-H table '{name}': {material.below} below {material.b[0]:.3g} T "
        f"(mu_r {material.initial_mu_r:.0f}), {material.above} above {material.b[-1]:.3g} T"
        for name, material in device.materials.items()
        if name in used and isinstance(material, BHTable)
    )


def payload_assumptions(payload: Payload | None) -> tuple[str, ...]:
    """Where the magnet sits in the payload, and that it is a point."""
    if payload is None:
        return ()
    depth = f"magnet_offset {1e3 * payload.magnet_offset:g} mm"
    return (f"point dipole, {depth} below the point that the sensor reads",)
