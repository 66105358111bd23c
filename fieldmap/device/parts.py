"""Parts of a machine: frozen data, SI units, right-handed frame with z up.

Coils, materials and shapes have folders of their own, `fieldmap.device.coils`, `fieldmap.device.materials` and
`fieldmap.device.shapes`; the levitated body is in `fieldmap.device.payload`. Values are checked when a `Device` is made
of the parts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, Field, ValidationInfo

from fieldmap.device.drives import DriveChoice
from fieldmap.device.made import Made
from fieldmap.device.placement import PLACEMENT, Movable, Placement
from fieldmap.device.shapes import SHAPE_KEYS, Shape
from fieldmap.field import Bounds
from fieldmap.inputs.declared import Key, choice_of, choice_with, first_line, table_of
from fieldmap.inputs.tables import (
    LARGEST_LENGTH_MM,
    Length,
    Name,
    Point,
    Positive,
    Size,
    Text,
    Vector,
    broken,
    text_like,
)
from fieldmap.typing import Array


@dataclass(frozen=True, repr=False)
class Part(Made):
    """One shape of a body; `operation` is "add" or "cut", applied in order."""

    shape: Shape
    placement: Placement = field(default_factory=Placement)
    operation: Annotated[
        str, Key(Literal["add", "cut"], "add this shape to the body, or cut it out of the parts before it")
    ] = "add"


AnyPart: Any = choice_of(
    (
        table_of(
            Part,
            name=f"{keys.makes.__name__}Part",
            beside={"shape": keys, "placement": PLACEMENT},
            text=first_line(keys.makes),
        )
        for keys in SHAPE_KEYS.values()
        if not keys.makes.has_own_mesh
    ),
    "shape",
)


def _finer_than_the_mesh(edge_size: float | None, info: ValidationInfo) -> None:
    mesh_size = info.data.get("mesh_size_mm")
    if edge_size is not None and mesh_size is not None and edge_size > mesh_size:
        raise broken(
            f"edge_size_mm must not be larger than mesh_size_mm = {mesh_size:g}",
            f"{edge_size:g}",
            "give the size of the fine layer at the edges (0.25 to 1 mm is usual), or leave the key out",
        )


def _begins_with_something(parts: list[Any], info: ValidationInfo) -> None:
    if parts and parts[0].operation != "add":
        raise broken(
            "the first part of a body must be added",
            'operation = "cut" in part 1',
            'begin with an "add" part; later parts cut from it',
        )


@dataclass(frozen=True, repr=False)
class Body(Movable, Made):
    """A named piece of one material. Bodies that touch become one magnetic body.

    parts: a shape, or shapes and `Part`s that are added and cut in this order. mesh_size: largest element edge, m;
    None for a body with a mesh of its own (`VolumeMesh`, `MeshFile`). edge_size: size of the first element layer at
    sharp edges, m, or None for no grading.

    >>> from fieldmap.device.shapes.turned import Cylinder
    >>> core = Body("core {k}", "steel", Cylinder(0.01, 0.04), mesh_size=5e-3).moved([0.044, 0.0, 0.006])
    >>> [one.name for one in core.around("z", 3)]
    ['core 1', 'core 2', 'core 3']
    """

    name: Annotated[str, Key(Name, "the body's name: letters, digits, spaces, _ + -")]
    material: Annotated[str, Key(Name, "name of a [material.NAME] table of this file")]
    parts: Annotated[
        tuple[Part, ...],
        Key(
            Annotated[list[AnyPart], Field(min_length=1)],
            "[[body.part]] tables, applied in order",
            name="part",
            check=_begins_with_something,
        ),
    ]
    mesh_size: Annotated[float | None, Key(Length, "largest element edge", "mm")] = None
    edge_size: Annotated[
        float | None,
        Key(
            Length | None,
            "size of the first element layer at sharp edges; leave out for no grading",
            "mm",
            check=_finer_than_the_mesh,
        ),
    ] = None

    if TYPE_CHECKING:  # types that `parts` accepts

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
        parts = tuple(Part(one) if isinstance(one, Shape) else one for one in given)
        object.__setattr__(self, "parts", parts)

    @property
    def has_own_mesh(self) -> bool:
        """Whether the body is given as a mesh, not as a shape to be meshed."""
        return any(part.shape.has_own_mesh for part in self.parts)

    def _placed(self, change: Callable[[Placement], Placement], mirror_axis: int | None = None) -> Body:
        shapes = [
            part.shape if mirror_axis is None else part.shape.reflected(mirror_axis) for part in self.parts
        ]
        parts = tuple(
            replace(part, shape=shape, placement=change(part.placement))
            for part, shape in zip(self.parts, shapes, strict=True)
        )
        return replace(self, parts=parts)

    def _pattern(self) -> str:
        return self.name if "{k}" in self.name else self.name + " {k}"


def _inline(keys: Any) -> Any:
    """The table of a body of one shape, which holds the keys of the shape as well."""
    shape = keys.makes
    part = table_of(
        Part,
        name=f"{shape.__name__}Alone",
        without=("operation",),
        beside={"shape": keys, "placement": PLACEMENT},
        takes=lambda one: one.operation == "add",
    )
    of_mesh = ("mesh_size", "edge_size") if shape.has_own_mesh else ()
    return table_of(
        Body,
        name=f"{shape.__name__}Body",
        without=("parts", *of_mesh),
        beside={"parts": part},
        needed=() if of_mesh else ("mesh_size",),
        text=first_line(shape),
    )


_OF_PARTS: Any = table_of(
    Body, name="CompositeBody", needed=("mesh_size",), text="A body of several parts, added and cut in order."
)
_OF_PARTS.written_as = "write [[body.part]] tables"
_SEVERAL_PARTS = "several parts"
AnyBody: Any = choice_with(
    {kind: _inline(keys) for kind, keys in SHAPE_KEYS.items()} | {_SEVERAL_PARTS: _OF_PARTS},
    lambda table: _SEVERAL_PARTS if "part" in table else table.get("shape"),
    "shape",
)


_LEAST_GAP_MM = 1e-3


def _no_gap_or_a_micrometre(gap: float) -> float:
    if 0 < gap < _LEAST_GAP_MM:
        must_hold = f"gap_mm must be 0 or at least {_LEAST_GAP_MM:g}"
        raise broken(must_hold, f"{gap:g}", "no ground face is known to a micrometre: leave the joint out")
    return gap


_Gap = Annotated[Annotated[float, Field(ge=0, le=LARGEST_LENGTH_MM)], AfterValidator(_no_gap_or_a_micrometre)]
_BodyPattern = Annotated[
    str,
    text_like(
        r"^[A-Za-z0-9*?][A-Za-z0-9 _+\-*?]*$",
        "the name of a body, or a pattern with * and ? for several",
        "write it as at the [[body]]",
    ),
]
_PairOfPatterns = Annotated[list[_BodyPattern], Field(min_length=2, max_length=2)]


@dataclass(frozen=True, repr=False)
class Joint(Made):
    """A thin sheet where bodies touch: a gap of air, glue or paper that the drawing does not show.

    gap: thickness in m, 0 for none; between: names of the two bodies, or patterns with * and ? for several; None for
    all contacts that no other joint names. mu_r: relative permeability of the material in the gap. name: for key paths.
    A pair of bodies takes the last joint that names it. The gap is cut out of the body that ends at the joint (for a
    core on a plate: the core), or out of the smaller body if both or neither end there; the rest of the body stays.

    >>> ends = Joint(0.1e-3, between=("core *", "disk"))
    >>> ends.holds("disk", "core 1"), ends.holds("plate", "core 1")
    (True, False)
    """

    gap: Annotated[
        float, Key(_Gap, "thickness, cut out of the body whose end the joint is; 0: no joint", "mm")
    ]
    between: Annotated[
        tuple[str, str] | None,
        Key(
            _PairOfPatterns | None,
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
        """Whether the joint names these two bodies, in either order.

        Parameters
        ----------
        first, second
            Names of the bodies.

        Returns
        -------
        bool
            True if it does.
        """
        orders = (first, second), (second, first)
        return self.between is None or any(all(map(fnmatchcase, names, self.between)) for names in orders)


def joint_of(joints: Sequence[Joint], first: str, second: str) -> Joint | None:
    """The joint between two bodies that touch: the last that names them, else the last joint for all contacts.

    Parameters
    ----------
    joints
        The joints of a device.
    first, second
        Names of the bodies.

    Returns
    -------
    Joint | None
        The joint; None without one, and for a gap of zero.

    Examples
    --------
    >>> joints = (Joint(0.0, ("yoke", "plate")), Joint(0.2e-3))
    >>> joint_of(joints, "plate", "yoke") is None, joint_of(joints, "core", "plate").gap
    (True, 0.0002)
    """
    named = [one for one in joints if one.between is not None and one.holds(first, second)]
    found = [*(one for one in joints if one.between is None), *named]
    return found[-1] if found and found[-1].gap > 0 else None


def _require_direction(normal: list[float], info: ValidationInfo) -> None:
    if not any(normal):
        raise broken("the vector must have a direction", "[0, 0, 0]", "give for instance [0, 0, 1]")


@dataclass(frozen=True, eq=False, repr=False)
class Section(Made):
    """Plane cross-section of iron: origin (3,) in m, normal (3,) of any length along positive flux.

    bodies: names of the bodies that are cut; all if empty. half_widths (3,): the section ends at these distances, m,
    from the origin along x, y and z; None for no limit.
    """

    name: Annotated[str, Key(Name, "the section's name, its own among the sections")]
    origin: Annotated[Array, Key(Point, "[x, y, z] of a point of the plane", "mm", "centre")]
    normal: Annotated[
        Array,
        Key(Vector, "[x, y, z] along the flux that counts as positive; any length", check=_require_direction),
    ]
    bodies: Annotated[
        tuple[str, ...], Key(list[Name], "names of the bodies that are cut; all if left out")
    ] = ()
    half_widths: Annotated[
        Array | None, Key(Size | None, "[x, y, z]: the section ends at these distances from the centre", "mm")
    ] = None


@dataclass(frozen=True, eq=False, repr=False)
class FieldSensor(Made):
    """An element that reads the flux density at a place along an axis, such as a Hall or a fluxgate element.

    position (3,): of the sensitive spot, m. axis (3,): of any length; a positive reading is a flux density along it.
    The element itself is taken to be small and not magnetic. Its electronics are an instrument
    (`fieldmap.instruments.FieldElement`).
    """

    name: Annotated[str, Key(Name, "the sensor's name, its own among the sensors")]
    position: Annotated[Array, Key(Point, "[x, y, z] of the sensitive spot", "mm")]
    axis: Annotated[
        Array,
        Key(
            Vector,
            "[x, y, z] along the flux density that counts as positive; any length",
            check=_require_direction,
        ),
    ]

    @property
    def direction(self) -> Array:
        """Unit vector (3,) along the axis."""
        return np.asarray(self.axis / np.linalg.norm(self.axis))


# ---- amplifiers and workspace ----


@dataclass(frozen=True, repr=False)
class Driver(DriveChoice, Made):
    """The amplifier of every coil: gain in A/V, limit in A, supply in V, and the drive.

    For a drive that sets a voltage, the gain is the steady current per volt at the amplifier's input.
    """

    gain: Annotated[float, Key(Positive, "current per volt at the amplifier's input", "A_per_V")]
    current_limit: Annotated[float, Key(Positive, "largest current of one coil", "A")]
    supply_voltage: Annotated[float | None, Key(Positive | None, "voltage of the supply", "V")] = None


def _require_above_lower(upper: list[float], info: ValidationInfo) -> None:
    lower = info.data.get("lower_mm", [])
    empty = [axis for axis, low, high in zip("xyz", lower, upper, strict=False) if high <= low]
    if empty:
        raise broken(
            "the box must not be empty: every entry of upper_mm above that of lower_mm",
            f"upper_mm = {upper} with lower_mm = {lower} (along {', '.join(empty)})",
            "swap the two corners, or correct them; z is up, so -140 lies below -76",
        )


@dataclass(frozen=True, eq=False, repr=False)
class WorkspaceBox(Made):
    """Axis-parallel box.

    lower, upper (3,): corners, m.
    """

    kind: ClassVar[str] = "box"

    lower: Annotated[Array, Key(Point, "[x, y, z] of the corner with the smallest coordinates", "mm")]
    upper: Annotated[Array, Key(Point, "[x, y, z] of the opposite corner", "mm", check=_require_above_lower)]

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
AnyWorkspace: Any = choice_of(
    (table_of(space, "shape") for space in (WorkspaceBox, WorkspaceCylinder)), "shape"
)


@dataclass(frozen=True, eq=False, repr=False)
class Reference(Made):
    """A known value for comparison with results: flux density component or gradient entry at a point.

    quantity: "Bx", "By", "Bz" (T) or "dBx/dx" ... "dBz/dz" (T/m); currents (n_coils,) in A; mu_r: the iron's
    relative permeability for which the value holds, or None; tolerance: relative, of the value itself.
    """

    quantity: str
    at: Annotated[Array, Key(Point, "[x, y, z] of the point", "mm")]
    currents: Annotated[Array, Key(list[float], "one current for each coil, in the file's order", "A")]
    value: float
    source: Annotated[str, Key(Text, "where the value comes from")]
    mu_r: Annotated[
        float | None, Key(Positive | None, "relative permeability of the iron for which the value holds")
    ] = None
    tolerance: Annotated[float | None, Key(Positive | None, "relative uncertainty of the value")] = None


_FLUX = ("Bx", "By", "Bz")
_SLOPES = tuple(f"dB{i}/d{j}" for i in "xyz" for j in "xyz")


def _reference(name: str, quantities: tuple[str, ...], what: str, unit: str, text: str) -> Any:
    """The table of references of one kind of quantity, whose value has this unit."""
    allowed: Any = Literal.__getitem__(quantities)
    return table_of(
        Reference,
        name=name,
        instead={"quantity": Key(allowed, what), "value": Key(float, "its value", unit)},
        takes=lambda one: isinstance(one.quantity, str) and one.quantity in quantities,
        text=text,
    )


_FLUX_DENSITY = _reference(
    "FluxDensityReference", _FLUX, "component of the flux density", "T", "A known component of B."
)
_GRADIENT = _reference(
    "GradientReference", _SLOPES, "entry of the gradient", "T_per_m", "A known entry of the gradient of B."
)


def _kind_of_reference(table: dict[str, Any]) -> Any:
    quantity = table.get("quantity")
    return "flux density" if quantity in _FLUX else "gradient" if quantity in _SLOPES else quantity


AnyReference: Any = choice_with(
    {"flux density": _FLUX_DENSITY, "gradient": _GRADIENT}, _kind_of_reference, "quantity"
)
