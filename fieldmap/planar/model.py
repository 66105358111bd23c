"""A machine in the plane: everything extends to infinity across it. Frozen data, SI units.

Coordinates (x, z): x to the right, z up, y into the page. Nothing here reads, checks, computes or draws.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from pydantic import Field

from fieldmap.device.coils.base import CoilName
from fieldmap.device.materials import Material
from fieldmap.device.polygons import SimplePolygon, counter_clockwise
from fieldmap.inputs.declared import Key
from fieldmap.inputs.tables import Name, PlanePoint
from fieldmap.records import FrozenDict, Record
from fieldmap.typing import Array

_EMPTY: Mapping[str, str] = FrozenDict({})


@dataclass(frozen=True)
class RoundWire(Record):
    """Section of a round conductor, radius in m; uniform current density."""

    radius: float


@dataclass(frozen=True)
class RectangularWire(Record):
    """Section of a rectangular conductor, sides along x and z in m; uniform current density."""

    width: float
    height: float


Wire = RoundWire | RectangularWire
Points = Annotated[list[PlanePoint], Field(min_length=1)]


@dataclass(frozen=True, eq=False, repr=False)
class PlanarCoil(Record):
    """Conductors in series: a current of 1 A is 1 A in each of them.

    into_page (n, 2) and out_of_page (m, 2): centres (x, z) of the conductors, m, whose current flows along +y and
    along -y when the coil's current is positive.
    """

    name: Annotated[str, Key(CoilName, "the coil's name: letters, digits, underscores")]
    wire: Wire
    into_page: Annotated[
        Array, Key(Points, "[[x, z], ...] conductors whose positive current flows along +y", "mm")
    ]
    out_of_page: Annotated[
        Array, Key(Points, "[[x, z], ...] conductors whose positive current flows along -y", "mm")
    ]


@dataclass(frozen=True, eq=False, repr=False)
class PlanarBody(Record):
    """A polygon of one material.

    corners (n, 2) of (x, z) in m, counter-clockwise with z up.
    """

    name: Annotated[str, Key(Name, "the body's name")]
    material: Annotated[str, Key(Name, "name of a [material.NAME] table")]
    corners: Annotated[
        Array, Key(SimplePolygon, "[[x, z], ...] once round the outline", "mm", make=counter_clockwise)
    ]


@dataclass(frozen=True, eq=False, repr=False)
class PlanarDevice(Record):
    """A whole machine in the plane.

    walls (n, 2): corners of a closed wall around everything that no flux passes, or None for open space. moment: the
    levitated dipole's moment, A m^2, or None. provenance: key paths of the file -> where the number comes from.
    """

    name: str
    title: str
    coils: tuple[PlanarCoil, ...]
    bodies: tuple[PlanarBody, ...] = ()
    materials: Mapping[str, Material] = field(default_factory=dict)
    walls: Array | None = None
    moment: float | None = None
    provenance: Mapping[str, str] = field(default_factory=lambda: _EMPTY)
    source: Path | None = None

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names of the coils, in the order of the currents."""
        return tuple(coil.name for coil in self.coils)
