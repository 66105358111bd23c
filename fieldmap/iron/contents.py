"""What is in a device: bodies with their volumes, coils, and what the laws of its materials assume."""

from dataclasses import dataclass

import numpy as np

from fieldmap.device.materials import Material
from fieldmap.device.model import Body, Device
from fieldmap.device.tetrahedra import longest_edge, volumes
from fieldmap.iron.geometry.checks import check_geometry
from fieldmap.iron.geometry.own_meshes import own_mesh
from fieldmap.iron.geometry.solids import body_solid
from fieldmap.plain import Plain, plain_items
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class BodyContents(Record):
    """One body: volume, m^3; mesh_size, m; how many parts it is built of; axis (3,) of their shapes, if it is one."""

    name: str
    material: str
    volume: float
    mesh_size: float
    parts: int
    axis: Array | None


@dataclass(frozen=True, eq=False, repr=False)
class CoilContents(Record):
    """One coil: kind, the name of its class; centre (3,), m; axis (3,), a unit vector, about which positive current
    runs counter-clockwise at polarity +1; height, m; resistance, ohm; inductance, H, if stated."""

    name: str
    kind: str
    turns: float
    polarity: int
    centre: Array
    axis: Array
    height: float
    resistance: float | None
    inductance: float | None


@dataclass(frozen=True, eq=False, repr=False)
class DeviceContents(Record):
    """What `fieldmap check` lists of a device whose geometry is sound."""

    device: Device
    bodies: tuple[BodyContents, ...]
    coils: tuple[CoilContents, ...]
    assumptions: tuple[str, ...]

    def to_dict(self) -> dict[str, Plain]:
        """The contents as plain Python, SI units."""
        device = self.device
        return plain_items(
            device=device.name,
            title=device.title,
            source=device.source,
            bodies=self.bodies,
            coils=self.coils,
            payload=device.payload,
            driver=device.driver,
            workspace=device.workspace,
            references=len(device.references),
            assumptions=self.assumptions,
        )


def device_contents(device: Device) -> DeviceContents:
    """Check the geometry of a device and list what is in it. Raises GeometryError.

    >>> import fieldmap as fm
    >>> (sphere,) = device_contents(fm.read_device("loop_and_sphere")).bodies
    >>> f"{sphere.name}: {1e6 * sphere.volume:.3f} cm^3"
    'sphere: 4.189 cm^3'
    """
    check_geometry(device)
    bodies = (
        BodyContents(
            body.name,
            body.material,
            _volume(body),
            _mesh_size(body),
            len(body.parts),
            _common_axis(body),
        )
        for body in device.bodies
    )
    coils = (
        CoilContents(
            coil.name,
            type(coil).__name__,
            coil.turns,
            coil.polarity,
            coil.placement.position,
            coil.placement.rotation[:, 2],
            coil.height,
            coil.resistance,
            coil.inductance,
        )
        for coil in device.coils
    )
    payload = () if device.payload is None else device.payload.assumptions
    return DeviceContents(device, tuple(bodies), tuple(coils), saturation_laws(device) + payload)


def _volume(body: Body) -> float:
    """In m^3; of a body that is a mesh that of its tetrahedra, which is what they fill in a sound device."""
    # Solids are built in mm.
    return float(volumes(*own_mesh(body)).sum()) if body.has_own_mesh else 1e-9 * float(body_solid(body).mass)


def _mesh_size(body: Body) -> float:
    """As the device states it; of a body that is a mesh its longest edge. In m."""
    return longest_edge(*own_mesh(body)) if body.has_own_mesh else body.mesh_size or 0.0


def _common_axis(body: Body) -> Array | None:
    """The local z axis of the shapes, or None where they have several."""
    axes = [np.asarray(part.placement.rotation)[:, 2] for part in body.parts]
    return axes[0] if all(np.allclose(axis, axes[0], atol=1e-9) for axis in axes) else None


def saturation_laws(device: Device) -> tuple[str, ...]:
    """The laws of the saturating iron in use, with their initial permeability and what holds outside their range."""
    used = {body.material for body in device.bodies}
    return tuple(
        f"iron '{name}': {_law(material)}"
        for name, material in device.materials.items()
        if name in used and material.saturates
    )


def _law(material: Material) -> str:
    words = material.description
    # A formula states its initial permeability itself.
    return words if "initial mu_r" in words else f"{words}; initial mu_r {material.initial_mu_r:.0f}"
