"""What a machine is made of: frozen data, SI units, right-handed frame with z up.

Coils and materials have folders of their own, `fieldmap.device.coils` and `fieldmap.device.materials`; what is
levitated is in `fieldmap.device.payload`. Values are checked when a `Device` is made of the parts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Self, get_args

import numpy as np

from fieldmap.device.dimensions import (
    FourPoints,
    Gap,
    HalfSection,
    PairOfPatterns,
    SimplePolygon,
    Tetrahedra,
    Triangles,
    counter_clockwise,
    require_above_lower,
    require_closed,
    require_direction,
    require_larger_radius,
    require_solid,
)
from fieldmap.device.made import Made
from fieldmap.device.placement import Movable, Placement
from fieldmap.device.polygons import reflected_polygon
from fieldmap.device.surfaces import read_stl
from fieldmap.errors import InputError, Problem
from fieldmap.field import Bounds
from fieldmap.inputs.declared import Key
from fieldmap.inputs.tables import Length, Name, Point, Positive, Size, Text, Vector, read_only
from fieldmap.typing import Array, Index, PathLike

# ---- shapes, in their local frame: axis along z, base in the plane z = 0, centred in x and y ---------------


@dataclass(frozen=True, repr=False)
class Cylinder(Made):
    """Solid cylinder, 0 <= z <= height."""

    kind: ClassVar[str] = "cylinder"

    radius: Annotated[float, Key(Length, "radius", "mm")]
    height: Annotated[float, Key(Length, "height along the local z axis", "mm")]


@dataclass(frozen=True, repr=False)
class Ring(Made):
    """Hollow cylinder, 0 <= z <= height."""

    kind: ClassVar[str] = "ring"

    inner_radius: Annotated[float, Key(Length, "radius of the bore", "mm")]
    outer_radius: Annotated[float, Key(Length, "outer radius", "mm", check=require_larger_radius)]
    height: Annotated[float, Key(Length, "height along the local z axis", "mm")]


@dataclass(frozen=True, repr=False)
class Box(Made):
    """Block, centred in x and y, 0 <= z <= size[2]."""

    kind: ClassVar[str] = "box"

    size: Annotated[tuple[float, float, float], Key(Size, "[x, y, z] edge lengths", "mm")]

    def __post_init__(self) -> None:
        # An array would be no tuple to those that look for one, and boxes could not be compared.
        if isinstance(self.size, np.ndarray) and self.size.ndim == 1:
            object.__setattr__(self, "size", tuple(self.size.tolist()))


@dataclass(frozen=True, repr=False)
class Sphere(Made):
    """Ball, centred at the local origin."""

    kind: ClassVar[str] = "sphere"

    radius: Annotated[float, Key(Length, "radius", "mm")]


@dataclass(frozen=True, eq=False, repr=False)
class ExtrudedPolygon(Made):
    """Polygon in the local x-y plane, 0 <= z <= height.

    points (n, 2): corners of a simple polygon.
    """

    kind: ClassVar[str] = "extruded_polygon"

    points: Annotated[
        Array,
        Key(SimplePolygon, "[[x, y], ...] corners once round the outline", "mm", make=counter_clockwise),
    ]
    height: Annotated[float, Key(Length, "height along the local z axis", "mm")]


@dataclass(frozen=True, eq=False, repr=False)
class RevolvedProfile(Made):
    """Profile turned fully about the local z axis.

    points (n, 2): corners (r, z) of a simple polygon, r >= 0.
    """

    kind: ClassVar[str] = "revolved_profile"

    points: Annotated[
        Array,
        Key(
            HalfSection,
            "[[r, z], ...] corners of the half section, r >= 0",
            "mm",
            make=counter_clockwise,
        ),
    ]


@dataclass(frozen=True, repr=False)
class StepFile(Made):
    """Solids of a STEP file.

    `scale` turns the file's length unit into metres.
    """

    kind: ClassVar[str] = "step_file"

    path: Annotated[Path, Key(Text, "path of the STEP file, relative to the device file", name="file")]
    scale: Annotated[float, Key(Length, "length of the STEP file's unit", "mm", "unit")] = 1e-3


@dataclass(frozen=True, eq=False, repr=False)
class TriangleSurface(Made):
    """Solid inside a closed surface of triangles.

    triangles (m, 3) are numbers of `points` (n, 3), in m, from 0. Each edge belongs to two triangles, which run along
    it in opposite ways; seen from outside, corners run counter-clockwise.
    """

    kind: ClassVar[str] = "triangle_surface"

    points: Annotated[Array, Key(FourPoints, "[[x, y, z], ...] corners", "mm")]
    triangles: Annotated[
        Index,
        Key(
            Triangles,
            "[[i, j, k], ...] numbers of corners from 0, counter-clockwise from outside",
            check=require_closed,
        ),
    ]

    @classmethod
    def from_stl(cls, path: PathLike, unit: float = 1e-3) -> Self:
        """The surface of an STL file, binary or text; unit: length of the file's unit, m, of which STL says nothing.

        Raises InputError for a file that is none. Whether it bounds a solid is checked when a device is made of it.
        """
        points, triangles = read_stl(Path(path))
        return cls(unit * points, triangles)


@dataclass(frozen=True, eq=False, repr=False)
class VolumeMesh(Made):
    """Mesh of tetrahedra, used as it is.

    tetrahedra (m, 4) are numbers of `points` (n, 3), in m, from 0. The shape of a body of its own,
    without `mesh_size`: nothing is added to it or cut from it.
    """

    kind: ClassVar[str] = "volume_mesh"

    points: Annotated[Array, Key(FourPoints, "[[x, y, z], ...] nodes", "mm")]
    tetrahedra: Annotated[
        Index, Key(Tetrahedra, "[[i, j, k, l], ...] numbers of nodes from 0", check=require_solid)
    ]

    @classmethod
    def from_file(cls, path: PathLike, unit: float = 1e-3, region: str | None = None) -> Self:
        """The tetrahedra of a mesh file: see `MeshFile`, of which this keeps the numbers.

        Raises InputError for a file that cannot be read, has no tetrahedra or lacks the region.
        """
        from fieldmap.device.mesh_files import read_mesh

        mesh = read_mesh(Path(path), region)
        return cls(unit * mesh.points, mesh.tets)


@dataclass(frozen=True, repr=False)
class MeshFile(Made):
    """Tetrahedra of a mesh file, used as they are.

    Files of gmsh, VTK and what else meshio reads. `scale` turns the file's length unit into metres. region: name of
    those cells that are meant, or their number as a text; None for all. The shape of a body of its own, without
    `mesh_size`.
    """

    kind: ClassVar[str] = "mesh_file"

    path: Annotated[Path, Key(Text, "path of the mesh file, relative to the device file", name="file")]
    scale: Annotated[float, Key(Length, "length of the mesh file's unit", "mm", "unit")] = 1e-3
    region: Annotated[
        str | None,
        Key(
            Text | None,
            'name of the cells that are this body, or their number in quotes, "7"; all if left out',
        ),
    ] = None


Shape = (
    Cylinder
    | Ring
    | Box
    | Sphere
    | ExtrudedPolygon
    | RevolvedProfile
    | StepFile
    | TriangleSurface
    | VolumeMesh
    | MeshFile
)
SHAPES = get_args(Shape)
OWN_MESHES = (VolumeMesh, MeshFile)
"""Shapes that are meshes already: of a body of its own, without `mesh_size`."""


@dataclass(frozen=True, repr=False)
class Part(Made):
    """One shape of a body; `operation` is "add" or "cut", applied in order."""

    shape: Shape
    placement: Placement = field(default_factory=Placement)
    operation: str = "add"


@dataclass(frozen=True, repr=False)
class Body(Movable, Made):
    """A named piece of one material. Bodies that touch become one magnetic body.

    parts: a shape, or shapes and `Part`s that are added and cut in this order. mesh_size: largest element edge, m;
    None for a body with a mesh of its own (`VolumeMesh`, `MeshFile`). edge_size: size of the first element layer at
    sharp edges, m, or None for no grading.

    >>> core = Body("core {k}", "steel", Cylinder(0.01, 0.04), mesh_size=5e-3).moved([0.044, 0.0, 0.006])
    >>> [one.name for one in core.around("z", 3)]
    ['core 1', 'core 2', 'core 3']
    """

    name: str
    material: str
    parts: tuple[Part, ...]
    mesh_size: float | None = None
    edge_size: float | None = None

    if TYPE_CHECKING:  # what may be given for the parts

        def __init__(
            self,
            name: str,
            material: str,
            parts: Shape | Part | Sequence[Shape | Part],
            mesh_size: float | None = None,
            edge_size: float | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        given = self.parts if isinstance(self.parts, list | tuple) else (self.parts,)
        parts = tuple(Part(one) if isinstance(one, SHAPES) else one for one in given)
        object.__setattr__(self, "parts", parts)

    @property
    def has_own_mesh(self) -> bool:
        """Whether it is a mesh, not a shape to be meshed."""
        return any(isinstance(part.shape, OWN_MESHES) for part in self.parts)

    def _placed(self, change: Callable[[Placement], Placement], mirror_axis: int | None = None) -> Body:
        parts = tuple(
            replace(part, shape=_reflected(part.shape, mirror_axis), placement=change(part.placement))
            for part in self.parts
        )
        return replace(self, parts=parts)

    def _pattern(self) -> str:
        return self.name if "{k}" in self.name else self.name + " {k}"


def _reflected(shape: Shape, axis: int | None) -> Shape:
    """The shape seen in a mirror across a local axis, 0 or 1; the same where it is symmetric."""
    if axis is None:
        return shape
    if isinstance(shape, StepFile):
        remedy = "make the mirrored solid in the program that wrote the file"
        raise InputError(Problem("mirrored", "a shape that can be mirrored", "a STEP file", remedy))
    if isinstance(shape, MeshFile):
        remedy = "read it by VolumeMesh.from_file, which can be"
        raise InputError(Problem("mirrored", "a shape that can be mirrored", "a mesh file", remedy))
    if isinstance(shape, TriangleSurface):
        points = np.array(shape.points, dtype=float)
        points[:, axis] *= -1
        return replace(shape, points=points, triangles=np.asarray(shape.triangles)[:, ::-1])
    if isinstance(shape, VolumeMesh):
        points = np.array(shape.points, dtype=float)
        points[:, axis] *= -1
        return replace(shape, points=points, tetrahedra=np.asarray(shape.tetrahedra)[:, [0, 2, 1, 3]])
    if isinstance(shape, ExtrudedPolygon):
        return replace(shape, points=read_only(reflected_polygon(shape.points.tolist(), axis)))
    return shape


@dataclass(frozen=True, repr=False)
class Joint(Made):
    """A thin sheet where bodies touch: a gap of air, glue or paper that the drawing does not show.

    gap: thickness in m, 0 for none; between: names of the two bodies, or patterns with * and ? for several; None for
    all contacts that no other joint names. mu_r: relative permeability of what is in the gap. name: for key paths. A
    pair of bodies takes the last joint that names it. The gap is cut out of the body whose end the joint is (of a core
    on a plate: the core), of the smaller one where both are alike; nothing else of it changes.

    >>> ends = Joint(0.1e-3, between=("core *", "disk"))
    >>> ends.holds("disk", "core 1"), ends.holds("plate", "core 1")
    (True, False)
    """

    gap: Annotated[
        float,
        Key(Gap, "thickness, cut out of the body whose end the joint is; 0: no joint", "mm"),
    ]
    between: Annotated[
        tuple[str, str] | None,
        Key(
            PairOfPatterns | None,
            "names of the two bodies, with * and ? as wildcards. A pair takes the last joint that names it. Without "
            "this key: all contacts that no other joint names",
        ),
    ] = None
    mu_r: Annotated[float, Key(Positive, "relative permeability of the material in the gap")] = 1.0
    name: Annotated[str | None, Key(Name | None, "for key paths, such as joint.NAME.gap_mm")] = None

    @property
    def description(self) -> str:
        """In words.

        >>> Joint(0.1e-3, ("core *", "disk")).description
        'joint of 0.1 mm between core * and disk'
        """
        where = "all other contacts" if self.between is None else " and ".join(self.between)
        filled = "" if self.mu_r == 1 else f", mu_r = {self.mu_r:g}"
        return (
            f"joint of {1e3 * self.gap:g} mm between {where}{filled}"
            if self.gap
            else f"no joint between {where}"
        )

    def holds(self, first: str, second: str) -> bool:
        """Whether it names these two bodies, in either order."""
        if self.between is None:
            return True
        return _are_like((first, second), self.between) or _are_like((second, first), self.between)


def _are_like(names: tuple[str, str], patterns: tuple[str, str]) -> bool:
    return all(fnmatchcase(name, pattern) for name, pattern in zip(names, patterns, strict=True))


def joint_of(joints: Sequence[Joint], first: str, second: str) -> Joint | None:
    """The joint between two bodies that touch: the last that names them, else the last of all contacts; None without
    one, and for a gap of zero.

    >>> joints = (Joint(0.0, ("yoke", "plate")), Joint(0.2e-3))
    >>> joint_of(joints, "plate", "yoke") is None, joint_of(joints, "core", "plate").gap
    (True, 0.0002)
    """
    named = [one for one in joints if one.between is not None and one.holds(first, second)]
    found = [*(one for one in joints if one.between is None), *named]
    return found[-1] if found and found[-1].gap > 0 else None


@dataclass(frozen=True, eq=False, repr=False)
class Section(Made):
    """What a plane cuts out of iron: origin (3,) in m, normal (3,) of any length; positive flux runs along it.

    bodies: those that are cut, all if empty. half_widths (3,): only what lies within these distances, m, of the
    origin along x, y and z; None for everything.
    """

    name: Annotated[str, Key(Name, "the section's name, its own among the sections")]
    origin: Annotated[Array, Key(Point, "[x, y, z] of a point of the plane", "mm", "centre")]
    normal: Annotated[
        Array,
        Key(
            Vector,
            "[x, y, z] along the flux that counts as positive; any length",
            check=require_direction,
        ),
    ]
    bodies: Annotated[
        tuple[str, ...],
        Key(list[Name], "names of the bodies that are cut; all if left out"),
    ] = ()
    half_widths: Annotated[
        Array | None,
        Key(Size | None, "[x, y, z]: the section ends at these distances from the centre", "mm"),
    ] = None


# ---- what drives it, and where --------------------------------------------------------------


@dataclass(frozen=True, repr=False)
class Driver(Made):
    """The current amplifier of every coil: gain in A/V, limit in A, supply in V."""

    gain: Annotated[float, Key(Positive, "current per volt at the amplifier's input", "A_per_V")]
    current_limit: Annotated[float, Key(Positive, "largest current of one coil", "A")]
    supply_voltage: Annotated[float | None, Key(Positive | None, "voltage of the supply", "V")] = None


@dataclass(frozen=True, eq=False, repr=False)
class WorkspaceBox(Made):
    """Axis-parallel box.

    lower, upper (3,): corners, m.
    """

    kind: ClassVar[str] = "box"

    lower: Annotated[Array, Key(Point, "[x, y, z] of the corner with the smallest coordinates", "mm")]
    upper: Annotated[Array, Key(Point, "[x, y, z] of the opposite corner", "mm", check=require_above_lower)]

    @property
    def bounds(self) -> Bounds:
        """Its two corners, m."""
        return np.asarray(self.lower, dtype=float), np.asarray(self.upper, dtype=float)


@dataclass(frozen=True, eq=False, repr=False)
class WorkspaceCylinder(Made):
    """Upright cylinder.

    base (3,): centre of its lower face, m; radius and height in m.
    """

    kind: ClassVar[str] = "cylinder"

    base: Annotated[Array, Key(Point, "[x, y, z] of the centre of its lower face", "mm")]
    radius: Annotated[float, Key(Length, "radius", "mm")]
    height: Annotated[float, Key(Length, "height", "mm")]

    @property
    def bounds(self) -> Bounds:
        """Corners of the axis-parallel box around it, m."""
        base = np.asarray(self.base, dtype=float)
        sideways = np.array([self.radius, self.radius, 0.0])
        return base - sideways, base + sideways + [0.0, 0.0, self.height]


Workspace = WorkspaceBox | WorkspaceCylinder


@dataclass(frozen=True, eq=False, repr=False)
class Reference(Made):
    """A known value to hold results against: flux density component or gradient entry at a point.

    quantity: "Bx", "By", "Bz" (T) or "dBx/dx" ... "dBz/dz" (T/m); currents (n_coils,) in A; mu_r: the iron's
    relative permeability for which the value holds, or None; tolerance: relative, of the value itself.
    """

    quantity: str
    at: Annotated[Array, Key(Point, "[x, y, z] of the point", "mm")]
    currents: Annotated[Array, Key(list[float], "one current for each coil, in the file's order", "A")]
    value: float
    source: Annotated[str, Key(Text, "where the value comes from")]
    mu_r: Annotated[
        float | None,
        Key(Positive | None, "relative permeability of the iron for which the value holds"),
    ] = None
    tolerance: Annotated[float | None, Key(Positive | None, "relative uncertainty of the value")] = None
