"""Currents and magnets of fixed magnetisation in air, of the kinds that magpylib has: the data, and their keys.

A source of current is part of a coil (`fieldmap.device.coils.magpylib`), which scales it; a magnet is part of the
background (`fieldmap.device.background`), which no current drives. Fields: `fieldmap.sources.air_sources`.
"""

import importlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from fieldmap.device.made import Made
from fieldmap.device.placement import Placement, PlacementKeys
from fieldmap.inputs.tables import MILLI, Length, NotNegative, Point, Vector, broken, read_only
from fieldmap.typing import Array, Index

_NEEDS: dict[str, tuple[str, ...]] = {
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
"""What each kind of source is made of, by magpylib's names."""

CURRENTS = ("Circle", "Polyline", "TriangleStrip", "TriangleSheet")
OTHER = "other"
"""Kind of a magpylib object of any other class, such as a CustomSource: it lives in Python only."""


@dataclass(frozen=True, eq=False, repr=False)
class AirSource(Made):
    """One source of magpylib's kinds, with the attributes that magpylib gives this kind, in SI.

    kind: the class in magpylib, or "other", for which `live` is the object itself and nothing else counts. dimension:
    as in magpylib, of a CylinderSegment inner radius, outer radius and height, with angles (2,), deg, beside it.
    faces (m, 3): rows of vertices (n, 3). current in A, current_densities (m, 3) in A/m, polarization (3,) in T, moment
    (3,) in A m^2.
    """

    kind: str
    placement: Placement = field(default_factory=Placement)
    current: float | None = None
    diameter: float | None = None
    dimension: Array | None = None
    angles: Array | None = None
    vertices: Array | None = None
    faces: Index | None = None
    current_densities: Array | None = None
    polarization: Array | None = None
    moment: Array | None = None
    live: Any = None

    @property
    def is_current(self) -> bool:
        """Whether it is a current, or an object of another class that a coil drives."""
        return self.kind in CURRENTS

    @property
    def amperes(self) -> float:
        """The current, A; 0 of what has none."""
        return 0.0 if self.current is None else self.current

    def flux_density(self, points: Array) -> Array:
        """B (n, 3), T, at points (n, 3), m, in the frame in which the source is placed."""
        return _fields().flux_density(self, points)

    def flux_density_and_gradient(self, points: Array) -> tuple[Array, Array]:
        """B (n, 3), T, and dB_i/dx_j (n, 3, 3), T/m."""
        return _fields().flux_density_and_gradient(self, points)


def _fields() -> ModuleType:
    """What computes them, found by name: the data of a machine know no kernels and no magpylib."""
    return importlib.import_module("fieldmap.sources.air_sources")


class AirSourceKeys(PlacementKeys):
    """A current or a magnet of one of magpylib's classes."""

    attributes: ClassVar[Mapping[str, str]] = {
        "type": "kind",
        "current_densities_A_per_m": "current_densities",
        "moment_A_m2": "moment",
    }

    type: Literal[
        "Circle",
        "Polyline",
        "TriangleStrip",
        "TriangleSheet",
        "Cuboid",
        "Cylinder",
        "CylinderSegment",
        "Sphere",
        "Tetrahedron",
        "TriangularMesh",
        "Triangle",
        "Dipole",
    ] = Field(description="class in magpylib")
    current_A: float | None = Field(default=None, description="current, in a coil that for 1 A in the coil")
    diameter_mm: Length | None = Field(default=None, description="of a Circle or Sphere")
    dimension_mm: list[NotNegative] | None = Field(
        default=None,
        description="of a Cuboid [x, y, z], a Cylinder [diameter, height], a CylinderSegment [inner radius, outer "
        "radius, height]",
    )
    angles_deg: list[float] | None = Field(default=None, description="of a CylinderSegment, [first, last]")
    vertices_mm: list[Point] | None = Field(default=None, description="[[x, y, z], ...]")
    faces: list[list[int]] | None = Field(
        default=None, description="[[i, j, k], ...], numbers of vertices from 0"
    )
    current_densities_A_per_m: list[Vector] | None = Field(
        default=None,
        description="of a TriangleSheet, [x, y, z] for each face, in a coil those for 1 A in the coil",
    )
    polarization_T: Vector | None = Field(default=None, description="[x, y, z] of a magnet")
    moment_A_m2: Vector | None = Field(default=None, description="[x, y, z] of a Dipole")

    @model_validator(mode="after")
    def _of_its_kind(self) -> "AirSourceKeys":
        needed = _NEEDS[self.type]
        given = [name for name in _KEYS if getattr(self, _KEYS[name]) is not None]
        missing = [_KEYS[name] for name in needed if name not in given]
        extra = [_KEYS[name] for name in given if name not in needed]
        if missing or extra:
            must_hold = f"a {self.type} has the keys {', '.join(_KEYS[name] for name in needed)}"
            received = " and ".join(
                [f"no {', '.join(missing)}"] * bool(missing) + [f"{', '.join(extra)} besides"] * bool(extra)
            )
            raise broken(must_hold, received, "correct the keys")
        fault = _fault(self)
        if fault:
            raise broken(*fault)
        return self

    def to_model(self) -> AirSource:
        """In SI."""

        def array(name: str, scale: float = 1.0) -> Array | None:
            value = getattr(self, _KEYS[name])
            return None if value is None else read_only(value, scale)

        return AirSource(
            self.type,
            self.placement(),
            self.current_A,
            None if self.diameter_mm is None else self.diameter_mm * MILLI,
            array("dimension", MILLI),
            array("angles"),
            array("vertices", MILLI),
            None if self.faces is None else np.array(self.faces, dtype=np.int64),
            array("current_densities"),
            array("polarization"),
            array("moment"),
        )


_KEYS = {
    "current": "current_A",
    "diameter": "diameter_mm",
    "dimension": "dimension_mm",
    "angles": "angles_deg",
    "vertices": "vertices_mm",
    "faces": "faces",
    "current_densities": "current_densities_A_per_m",
    "polarization": "polarization_T",
    "moment": "moment_A_m2",
}
_SIZES = {"Cuboid": 3, "Cylinder": 2, "CylinderSegment": 3}
_FEWEST = {"Polyline": 2, "TriangleStrip": 3, "Tetrahedron": 4, "Triangle": 3}


def _fault(keys: AirSourceKeys) -> tuple[str, str, str] | None:
    """What must hold, what was received, and the remedy, of numbers that do not fit together."""
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
