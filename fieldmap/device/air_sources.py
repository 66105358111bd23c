"""Currents and magnets of fixed magnetisation in air, of the kinds that magpylib has: the data, and their keys.

A source of current is part of a coil (`fieldmap.device.coils.magpylib`), which scales it; a magnet is part of the
background (`fieldmap.device.background`), which no current drives. Fields: `fieldmap.device.air_fields`. Objects of
magpylib are known by their attributes and the names of their classes, so nothing here imports magpylib.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import model_validator

from fieldmap.device.made import Made
from fieldmap.device.placement import PLACEMENT, Placement
from fieldmap.errors import InputError, Problem
from fieldmap.inputs.declared import Key, table_of
from fieldmap.inputs.tables import Length, NotNegative, Point, Vector, broken
from fieldmap.typing import Array, Index

NEEDS: dict[str, tuple[str, ...]] = {
    "Circle": ("diameter", "current"),
    "Polyline": ("vertices", "current"),
    "TriangleStrip": ("vertices", "current"),
    "TriangleSheet": ("vertices", "faces", "current_densities"),
    "Cuboid": ("dimension", "polarization"),
    "Cylinder": ("dimension", "polarization"),
    "CylinderSegment": ("dimension", "angles", "polarization"),
    "Sphere": ("diameter", "polarization"),
    "Tetrahedron": ("vertices", "polarization"),
    "TriangularMesh": ("vertices", "faces", "polarization"),
    "Triangle": ("vertices", "polarization"),
    "Dipole": ("moment",),
}
"""Attributes that each kind of source needs, by magpylib's names."""

_KIND: Any = Literal.__getitem__(tuple(NEEDS))

CURRENTS = ("Circle", "Polyline", "TriangleStrip", "TriangleSheet")
OTHER = "other"
"""Kind of a magpylib object of any other class, such as a CustomSource, which no file can hold."""


@dataclass(frozen=True, eq=False, repr=False)
class AirSource(Made):
    """A current or a magnet of one of magpylib's classes.

    The attributes are those of the magpylib class, in SI.

    kind: the class in magpylib, or "other": then only `live`, the magpylib object itself, is used. dimension: as in
    magpylib, but for a CylinderSegment inner radius, outer radius and height, with separate angles (2,), deg. faces
    (m, 3): numbers of vertices (n, 3). current in A, current_densities (m, 3) in A/m, polarization (3,) in T, moment
    (3,) in A m^2.
    """

    kind: Annotated[str, Key(_KIND, "class in magpylib", name="type")]
    placement: Placement = field(default_factory=Placement)
    current: Annotated[
        float | None, Key(float | None, "current, in a coil that for 1 A in the coil", "A")
    ] = None
    diameter: Annotated[float | None, Key(Length | None, "of a Circle or Sphere", "mm")] = None
    dimension: Annotated[
        Array | None,
        Key(
            list[NotNegative] | None,
            "of a Cuboid [x, y, z], a Cylinder [diameter, height], a CylinderSegment [inner radius, outer "
            "radius, height]",
            "mm",
        ),
    ] = None
    angles: Annotated[Array | None, Key(list[float] | None, "of a CylinderSegment, [first, last]", "deg")] = (
        None
    )
    vertices: Annotated[Array | None, Key(list[Point] | None, "[[x, y, z], ...]", "mm")] = None
    faces: Annotated[
        Index | None, Key(list[list[int]] | None, "[[i, j, k], ...], numbers of vertices from 0")
    ] = None
    current_densities: Annotated[
        Array | None,
        Key(
            list[Vector] | None,
            "of a TriangleSheet, [x, y, z] for each face, in a coil those for 1 A in the coil",
            "A_per_m",
        ),
    ] = None
    polarization: Annotated[Array | None, Key(Vector | None, "[x, y, z] of a magnet", "T")] = None
    moment: Annotated[Array | None, Key(Vector | None, "[x, y, z] of a Dipole", "A_m2")] = None
    live: Any = None

    @property
    def is_current(self) -> bool:
        """Whether it is a current, not a magnet or an object of another class."""
        return self.kind in CURRENTS

    @property
    def extents(self) -> Array:
        """Extents (3,), m, along the local axes. A CylinderSegment has its diameter, wall and height, an object of
        another class 1 mm."""
        if self.kind == "CylinderSegment":
            inner, outer, height = np.asarray(self.dimension)
            return np.array([2 * outer, outer - inner, height])
        if self.dimension is not None:
            size = np.asarray(self.dimension)
            return size if len(size) == 3 else size[[0, 0, 1]]
        if self.diameter is not None:
            return np.full(3, self.diameter)
        return np.full(3, 1e-3) if self.vertices is None else np.ptp(np.asarray(self.vertices), axis=0)

    @property
    def amperes(self) -> float:
        """The current, A; 0 for a source without one."""
        return 0.0 if self.current is None else self.current


_KEYS: Any = table_of(AirSource, beside={"placement": PLACEMENT})
_NAMES = {one.attribute: key for key, one in _KEYS.declared.items() if one.attribute != "kind"}


class AirSourceKeys(_KEYS):
    """A current or a magnet of one of magpylib's classes."""

    @model_validator(mode="after")
    def _of_its_kind(self) -> "AirSourceKeys":
        needed = NEEDS[self.type]
        given = [name for name in _NAMES if getattr(self, _NAMES[name]) is not None]
        missing = [_NAMES[name] for name in needed if name not in given]
        extra = [_NAMES[name] for name in given if name not in needed]
        if missing or extra:
            must_hold = f"a {self.type} has the keys {', '.join(_NAMES[name] for name in needed)}"
            received = " and ".join(
                [f"no {', '.join(missing)}"] * bool(missing) + [f"{', '.join(extra)} besides"] * bool(extra)
            )
            raise broken(must_hold, received, "correct the keys")
        fault = _fault(self)
        if fault:
            raise broken(*fault)
        return self


_SIZES = {"Cuboid": 3, "Cylinder": 2, "CylinderSegment": 3}
_FEWEST = {"Polyline": 2, "TriangleStrip": 3, "Tetrahedron": 4, "Triangle": 3}


def _fault(keys: AirSourceKeys) -> tuple[str, str, str] | None:
    """What must hold, what was received, and the remedy, for numbers that do not fit together."""
    size = _SIZES.get(keys.type)
    if size is not None and keys.dimension_mm is not None and len(keys.dimension_mm) != size:
        return f"dimension_mm of a {keys.type} has {size} numbers", f"{len(keys.dimension_mm)}", "correct it"
    count = 0 if keys.vertices_mm is None else len(keys.vertices_mm)
    if keys.type in _FEWEST and count < _FEWEST[keys.type]:
        return f"a {keys.type} has at least {_FEWEST[keys.type]} vertices", f"{count}", "add what is missing"
    if keys.faces is not None:
        wrong = [face for face in keys.faces if len(face) != 3 or not all(0 <= k < count for k in face)]
        if wrong:
            must_hold = f"each face is three numbers of vertices, 0 to {count - 1}"
            return must_hold, f"{wrong[0]}", "number the vertices from 0"
        densities = keys.current_densities_A_per_m
        if densities is not None and len(densities) != len(keys.faces):
            return (
                "one current density for each face",
                f"{len(densities)} for {len(keys.faces)}",
                "add or remove",
            )
    if keys.angles_deg is not None:
        first, last = (*keys.angles_deg, 0.0, 0.0)[:2]
        if len(keys.angles_deg) != 2 or not 0 < last - first <= 360:
            return "angles_deg are [first, last], rising by at most 360", f"{keys.angles_deg}", "correct them"
    return None


# ---- objects of magpylib, at the last pose of their paths ----

SOLIDS = ("Cuboid", "Cylinder", "CylinderSegment", "Sphere", "Tetrahedron", "TriangularMesh")

_AXES = {
    **dict.fromkeys(("current", "diameter"), 0),
    **dict.fromkeys(("dimension", "polarization", "moment"), 1),
    **dict.fromkeys(("vertices", "current_densities"), 2),
}
"""Array axes of an attribute at one pose; a path adds one."""


def sources_of(model: Any) -> list[AirSource]:
    """The sources of a model. Raises InputError for an object that is no source, and for a model without sources."""
    problems: list[Problem] = []
    sources = [source_of(thing, problems) for thing in leaves(model)]
    if problems or not sources:
        none = Problem("from_magpylib, model", "at least one source", "none", "add a source")
        raise InputError(*(problems or [none]))
    return [source for source in sources if source is not None]


def per_ampere(source: AirSource, nominal: float | None) -> AirSource:
    """A source with its current or current densities divided by a nominal current, A; without one its current is 1 A,
    and its current densities stay."""
    if source.current is not None:
        return replace(source, current=1.0 if nominal is None else source.current / nominal)
    if source.current_densities is not None and nominal is not None:
        return replace(source, current_densities=source.current_densities / nominal)
    return source


def leaves(model: Any) -> Iterable[Any]:
    """All sources of a Collection (nested ones, too) or of a sequence, or the source itself, without sensors."""
    if hasattr(model, "sources_all"):
        return list(model.sources_all)
    if isinstance(model, list | tuple):
        return [leaf for one in model for leaf in leaves(one)]
    if type(model).__name__ == "Sensor":
        return []
    if not hasattr(model, "getB") or not hasattr(model, "orientation"):
        received = type(model).__name__
        remedy = "give a Collection or a list of sources"
        raise InputError.of("from_magpylib, model", "magpylib sources and Collections", received, remedy)
    return [model]


def _last(thing: Any, name: str) -> Any:
    """An attribute at the end of the path, None where it is not set."""
    value = getattr(thing, name, None)
    if value is None:
        return None
    array = np.asarray(value, dtype=float)
    if array.ndim > _AXES[name]:
        array = array[-1]
    return float(array) if array.ndim == 0 else array


def source_of(thing: Any, problems: list[Problem]) -> AirSource | None:
    """The object as data, at its last pose."""
    position = np.atleast_2d(thing.position)[-1]
    rotation = np.atleast_3d(thing.orientation.as_matrix()).reshape(-1, 3, 3)[-1]
    placement = Placement(np.array(position), np.array(rotation))
    kind = type(thing).__name__
    if type(thing).__module__.split(".")[0] != "magpylib" or kind not in NEEDS:
        return AirSource(OTHER, live=thing)
    values = {name: _last(thing, name) for name in NEEDS[kind] if name in _AXES}
    missing = [name for name, value in values.items() if value is None]
    if missing:
        must_hold, received = f"{', '.join(missing)} must be set", "None"
        label = getattr(thing.style, "label", None) or kind
        problems.append(Problem(f"from_magpylib, {label}", must_hold, received, "set it in magpylib"))
        return None
    if kind == "CylinderSegment":
        values["dimension"], values["angles"] = values["dimension"][:3], values["dimension"][3:]
    if "faces" in NEEDS[kind]:
        values["faces"] = np.array(thing.faces, dtype=np.int64)
    return AirSource(kind, placement, **values)
