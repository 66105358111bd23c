"""The whole of a device file, and the whole of a material file."""

from typing import Annotated

from pydantic import Field, field_validator

from fieldmap.device.schema.bodies import AnyBody
from fieldmap.device.schema.coils import AnyCoil
from fieldmap.device.schema.materials import AnyMaterial, CurveKeys
from fieldmap.device.schema.payload import AnyPayload, DriverKeys
from fieldmap.device.schema.workspace import AnyReference, AnyWorkspace, SectionKeys
from fieldmap.inputs.tables import Name, Table, Text, broken

FORMAT = 1
Format = Annotated[
    int, Field(description="version of the file format: 1", json_schema_extra={"const": FORMAT})
]


def require_known_format(value: int) -> int:
    """Raise unless this is the version that is read here."""
    if value != FORMAT:
        raise broken(
            f"format must be {FORMAT}",
            str(value),
            f"this version of fieldmap reads format {FORMAT} only: install the version that wrote the file",
        )
    return value


class DeviceFile(Table):
    """A device file."""

    format: Format
    name: Name = Field(description="short name of the device")
    title: Text = Field(description="one line about the device")
    body: list[AnyBody] = Field(default=[], description="[[body]] tables: the iron and the magnets")
    material: dict[Name, AnyMaterial] = Field(default={}, description="[material.NAME] tables")
    coil: list[AnyCoil] = Field(default=[], description="[[coil]] tables; currents follow this order")
    payload: AnyPayload | None = Field(default=None, description="what is levitated")
    driver: DriverKeys | None = Field(default=None, description="what drives the coils")
    workspace: AnyWorkspace | None = Field(default=None, description="where the payload may go")
    section: list[SectionKeys] = Field(default=[], description="[[section]] tables: cross-sections of iron")
    reference: list[AnyReference] = Field(default=[], description="[[reference]] tables: known values")
    provenance: dict[str, Text] = Field(
        default={}, description='"key.path" = "where the number comes from"; * stands for any one step'
    )

    _format = field_validator("format")(require_known_format)


class MaterialFile(CurveKeys):
    """A file that holds one measured B-H curve."""

    format: Format
    name: Name = Field(description="short name of the material")
    title: Text = Field(description="one line about the material")
    provenance: dict[str, Text] = Field(default={}, description='"key" = "where the numbers come from"')

    _format = field_validator("format")(require_known_format)
