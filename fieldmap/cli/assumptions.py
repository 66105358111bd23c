"""What results rest on, said in words."""

from fieldmap.device.model import Device, Payload, SaturatingMaterial


def saturates(device: Device) -> bool:
    """Whether some body can saturate."""
    return any(isinstance(device.materials[body.material], SaturatingMaterial) for body in device.bodies)


def material_assumptions(device: Device) -> tuple[str, ...]:
    """The laws of the iron in use, with what holds outside the points of a table."""
    from fieldmap.iron.forms.bh_law import initial_mu_r, law_words

    used = {body.material for body in device.bodies}
    return tuple(
        f"iron '{name}': {law_words(material)}; initial mu_r {initial_mu_r(material):.0f}"
        for name, material in device.materials.items()
        if name in used and isinstance(material, SaturatingMaterial)
    )


def payload_assumptions(payload: Payload | None) -> tuple[str, ...]:
    """Where the magnet sits in the payload, and that it is a point."""
    if payload is None:
        return ()
    depth = f"magnet_offset {1e3 * payload.magnet_offset:g} mm"
    return (f"point dipole, {depth} below the point that the sensor reads",)
