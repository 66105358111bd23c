"""The tables of a planar device file."""

from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator

from fieldmap.device.coils import CoilName
from fieldmap.device.dimensions import SimplePolygon, counter_clockwise
from fieldmap.device.materials import AnyMaterial
from fieldmap.errors import DeviceFileError
from fieldmap.inputs.kinds import FileKind, register
from fieldmap.inputs.tables import (
    MILLI,
    Format,
    Length,
    Name,
    PlanePoint,
    Positive,
    Table,
    Text,
    broken,
    read_only,
)
from fieldmap.planar import model

Points = Annotated[list[PlanePoint], Field(min_length=1)]
Sides = Annotated[list[Length], Field(min_length=2, max_length=2)]


class PlanarBodyKeys(Table):
    """A polygon of one material."""

    name: Name = Field(description="the body's name")
    material: Name = Field(description="name of a [material.NAME] table")
    corners_mm: SimplePolygon = Field(description="[[x, z], ...] once round the outline")

    def to_model(self) -> model.PlanarBody:
        """In SI."""
        corners = read_only(counter_clockwise(self.corners_mm), MILLI)
        return model.PlanarBody(self.name, self.material, corners)


class PlanarCoilKeys(Table):
    """Conductors in series, all of one section."""

    name: CoilName = Field(description="the coil's name: letters, digits, underscores")
    wire_diameter_mm: Length | None = Field(default=None, description="diameter of round conductors")
    wire_size_mm: Sides | None = Field(
        default=None, validate_default=True, description="[width, height] of rectangular conductors"
    )
    into_page_mm: Points = Field(description="[[x, z], ...] conductors whose positive current flows along +y")
    out_of_page_mm: Points = Field(
        description="[[x, z], ...] conductors whose positive current flows along -y"
    )

    @field_validator("wire_size_mm")
    @classmethod
    def _one_section(cls, value: list[float] | None, info: ValidationInfo) -> list[float] | None:
        given = [key is not None for key in (info.data.get("wire_diameter_mm"), value)]
        if "wire_diameter_mm" in info.data and sum(given) != 1:
            raise broken(
                "a coil has round or rectangular conductors",
                "both wire_diameter_mm and wire_size_mm" if all(given) else "neither",
                "give wire_diameter_mm, or wire_size_mm = [width, height]",
            )
        return value

    def to_model(self) -> model.PlanarCoil:
        """In SI."""
        wire: model.Wire
        if self.wire_diameter_mm is not None:
            wire = model.RoundWire(0.5 * self.wire_diameter_mm * MILLI)
        else:
            assert self.wire_size_mm is not None
            wire = model.RectangularWire(self.wire_size_mm[0] * MILLI, self.wire_size_mm[1] * MILLI)
        return model.PlanarCoil(
            self.name, wire, read_only(self.into_page_mm, MILLI), read_only(self.out_of_page_mm, MILLI)
        )


class WallKeys(Table):
    """A box around everything that no flux passes."""

    lower_mm: PlanePoint = Field(description="[x, z] of the lower left corner")
    upper_mm: PlanePoint = Field(description="[x, z] of the upper right corner")

    @field_validator("upper_mm")
    @classmethod
    def _above(cls, value: list[float], info: ValidationInfo) -> list[float]:
        lower = info.data.get("lower_mm")
        if lower is not None and not (lower[0] < value[0] and lower[1] < value[1]):
            raise broken("upper_mm must exceed lower_mm in x and in z", f"{value}", "exchange the corners")
        return value


class PlanarPayloadKeys(Table):
    """What is levitated."""

    moment_A_m2: Positive = Field(description="magnitude of the vertical dipole moment")


class PlanarFile(Table):
    """A planar device file."""

    format: Format
    space: Literal["plane"] = Field(description="everything extends to infinity across the x-z plane")
    name: Name = Field(description="short name of the device")
    title: Text = Field(description="one line about the device")
    material: dict[Name, AnyMaterial] = Field(default={}, description="[material.NAME] tables")
    body: list[PlanarBodyKeys] = Field(default=[], description="[[body]] tables: the iron")
    coil: Annotated[list[PlanarCoilKeys], Field(min_length=1)] = Field(
        description="[[coil]] tables; currents follow this order"
    )
    walls: WallKeys | None = Field(default=None, description="walls without flux; open space without them")
    payload: PlanarPayloadKeys | None = Field(default=None, description="what is levitated")
    provenance: dict[str, Text] = Field(default={}, description='"key.path" = "where the number comes from"')


PLANAR_DEVICE = register(
    FileKind(
        "planar device",
        PlanarFile,
        DeviceFileError,
        "geometry",
        keys=frozenset({"coil", "body", "material", "payload", "walls"}),
        mark=("space", "plane"),
        taken_by="fieldmap.planar.read_planar_device reads it",
        json_schema="planar.schema.json",
    )
)
