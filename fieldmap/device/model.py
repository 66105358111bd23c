"""What a machine is: frozen data, SI units, right-handed frame with z up.

Coils and materials have folders of their own, `fieldmap.device.coils` and `fieldmap.device.materials`; their shipped
shapes and laws are offered here too. `fieldmap.device.read_device` makes a device from a file and checks it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fieldmap.device.coils import Coil as Coil
from fieldmap.device.coils.circular import CircularCoil as CircularCoil
from fieldmap.device.coils.path import PathCoil as PathCoil
from fieldmap.device.coils.rounded_rectangle import RoundedRectangleCoil as RoundedRectangleCoil
from fieldmap.device.materials import Material as Material
from fieldmap.device.materials import SaturatingMaterial as SaturatingMaterial
from fieldmap.device.materials.arctangent import Arctangent as Arctangent
from fieldmap.device.materials.bh_table import BHTable as BHTable
from fieldmap.device.materials.flux_barrier import FluxBarrier as FluxBarrier
from fieldmap.device.materials.froehlich import Froehlich as Froehlich
from fieldmap.device.materials.linear import LinearMaterial as LinearMaterial
from fieldmap.device.materials.marrocco import Marrocco as Marrocco
from fieldmap.device.materials.permanent_magnet import PermanentMagnet as PermanentMagnet
from fieldmap.device.placement import Placement as Placement
from fieldmap.field import Bounds
from fieldmap.records import FrozenDict, Record
from fieldmap.typing import Array

_EMPTY: Mapping[str, str] = FrozenDict({})


# ---- shapes, in their local frame: axis along z, base in the plane z = 0, centred in x and y ---------------


@dataclass(frozen=True, repr=False)
class Cylinder(Record):
    """Solid cylinder, 0 <= z <= height."""

    radius: float
    height: float


@dataclass(frozen=True, repr=False)
class Ring(Record):
    """Hollow cylinder, 0 <= z <= height."""

    inner_radius: float
    outer_radius: float
    height: float


@dataclass(frozen=True, repr=False)
class Box(Record):
    """|x| <= size[0]/2, |y| <= size[1]/2, 0 <= z <= size[2]."""

    size: tuple[float, float, float]


@dataclass(frozen=True, repr=False)
class Sphere(Record):
    """Centred at the local origin (not on the plane z = 0)."""

    radius: float


@dataclass(frozen=True, eq=False, repr=False)
class ExtrudedPolygon(Record):
    """Simple polygon `points` (n, 2) in the x-y plane, extruded over 0 <= z <= height."""

    points: Array
    height: float


@dataclass(frozen=True, eq=False, repr=False)
class RevolvedProfile(Record):
    """Simple polygon `points` (n, 2) of (r, z), r >= 0, turned fully about the local z axis."""

    points: Array


@dataclass(frozen=True, repr=False)
class StepFile(Record):
    """Solid(s) of a STEP file; `scale` turns the file's length unit into metres."""

    path: Path
    scale: float


Shape = Cylinder | Ring | Box | Sphere | ExtrudedPolygon | RevolvedProfile | StepFile


@dataclass(frozen=True, repr=False)
class Part(Record):
    """One shape of a body; `operation` is "add" or "cut", applied in order."""

    shape: Shape
    placement: Placement = field(default_factory=Placement)
    operation: str = "add"


@dataclass(frozen=True, repr=False)
class Body(Record):
    """A named piece of one material. Bodies that touch become one magnetic body.

    mesh_size: largest element edge, m. edge_size: size of the first element layer at sharp edges, m,
    or None for no grading.
    """

    name: str
    material: str
    parts: tuple[Part, ...]
    mesh_size: float
    edge_size: float | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Section(Record):
    """What a plane cuts out of iron: origin (3,) in m, normal (3,) of any length; positive flux runs along it.

    bodies: those that are cut, all if empty. half_widths (3,): only what lies within these distances, m, of the
    origin along x, y and z; None for everything.
    """

    name: str
    origin: Array
    normal: Array
    bodies: tuple[str, ...] = ()
    half_widths: Array | None = None


# ---- what is levitated, what drives it, where --------------------------------------------------------------


@dataclass(frozen=True, repr=False)
class MagnetCylinder(Record):
    """Axially magnetised cylinder; remanence in T."""

    diameter: float
    height: float
    remanence: float


@dataclass(frozen=True, repr=False)
class MagnetSphere(Record):
    """Uniformly magnetised sphere; remanence in T."""

    diameter: float
    remanence: float


@dataclass(frozen=True, repr=False)
class MagnetBlock(Record):
    """Block magnetised along its z edge; remanence in T."""

    size: tuple[float, float, float]
    remanence: float


@dataclass(frozen=True, repr=False)
class Payload(Record):
    """What is levitated. moment: magnitude in A m^2 (from the magnet if it is given).

    magnet_offset: depth of the magnet's centre below the point that the sensor reads, m (an assumption,
    printed with every result that uses it). inertia (3,) kg m^2 or None. drag: N s/m.
    """

    mass: float
    moment: float
    magnet: MagnetCylinder | MagnetSphere | MagnetBlock | None = None
    magnet_offset: float = 0.0
    inertia: tuple[float, float, float] | None = None
    drag: float = 0.0

    @property
    def assumptions(self) -> tuple[str, ...]:
        """That the magnet is a point, and where it sits."""
        depth = f"magnet_offset {1e3 * self.magnet_offset:g} mm"
        return (f"point dipole, {depth} below the point that the sensor reads",)


@dataclass(frozen=True, repr=False)
class Driver(Record):
    """Current amplifier: gain in A/V, limits in A, supply limit in V."""

    gain: float
    current_limit: float
    supply_voltage: float | None = None


@dataclass(frozen=True, eq=False, repr=False)
class WorkspaceBox(Record):
    """Axis-parallel box, corners (3,) in m."""

    lower: Array
    upper: Array

    @property
    def bounds(self) -> Bounds:
        """Its two corners, m."""
        return np.asarray(self.lower, dtype=float), np.asarray(self.upper, dtype=float)


@dataclass(frozen=True, eq=False, repr=False)
class WorkspaceCylinder(Record):
    """Upright cylinder: centre of its lower face (3,), radius and height in m."""

    base: Array
    radius: float
    height: float

    @property
    def bounds(self) -> Bounds:
        """Corners of the axis-parallel box around it, m."""
        base = np.asarray(self.base, dtype=float)
        sideways = np.array([self.radius, self.radius, 0.0])
        return base - sideways, base + sideways + [0.0, 0.0, self.height]


Workspace = WorkspaceBox | WorkspaceCylinder


@dataclass(frozen=True, eq=False, repr=False)
class Reference(Record):
    """A known value to hold results against: flux density component or gradient entry at a point.

    quantity: "Bx", "By", "Bz" (T) or "dBx/dx" ... "dBz/dz" (T/m); currents (n_coils,) in A; mu_r: the iron's
    relative permeability for which the value holds, or None; tolerance: relative, of the value itself.
    """

    quantity: str
    at: Array
    currents: Array
    value: float
    source: str
    mu_r: float | None = None
    tolerance: float | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Device(Record):
    """A whole machine.

    provenance: key paths of the file -> where the number comes from. For the map file's record: `text` is the
    file as read; `included` maps each file that it names to its text (material files) or to "sha256:..." of
    its bytes (STEP files).
    """

    name: str
    title: str
    coils: tuple[Coil, ...]
    bodies: tuple[Body, ...] = ()
    materials: Mapping[str, Material] = field(default_factory=dict)
    payload: Payload | None = None
    driver: Driver | None = None
    workspace: Workspace | None = None
    references: tuple[Reference, ...] = ()
    sections: tuple[Section, ...] = ()
    provenance: Mapping[str, str] = field(default_factory=lambda: _EMPTY)
    source: Path | None = None
    text: str = ""
    included: Mapping[str, str] = field(default_factory=lambda: _EMPTY)

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in current order."""
        return tuple(coil.name for coil in self.coils)

    @property
    def bounds(self) -> Bounds | None:
        """Corners of the axis-parallel box around the workspace, m; None without a workspace."""
        return None if self.workspace is None else self.workspace.bounds

    @property
    def texts(self) -> tuple[str, ...]:
        """All that was read to make it: the file, and name and text (or hash) of each that it names."""
        return (self.text, *(part for pair in sorted(self.included.items()) for part in pair))
