"""The whole of a device file, and the whole of a material file."""

from pydantic import Field

from fieldmap.device.coils import AnyCoil
from fieldmap.device.materials import AnyMaterial
from fieldmap.device.materials.bh_table import CurveKeys
from fieldmap.device.schema.bodies import AnyBody
from fieldmap.device.schema.payload import AnyPayload, DriverKeys
from fieldmap.device.schema.workspace import AnyReference, AnyWorkspace, SectionKeys
from fieldmap.errors import DeviceFileError
from fieldmap.inputs.kinds import FileKind, register
from fieldmap.inputs.tables import Format, Name, Table, Text


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


class MaterialFile(CurveKeys):
    """A file that holds one measured B-H curve."""

    format: Format
    name: Name = Field(description="short name of the material")
    title: Text = Field(description="one line about the material")
    provenance: dict[str, Text] = Field(default={}, description='"key" = "where the numbers come from"')


DEVICE = register(
    FileKind(
        "device",
        DeviceFile,
        DeviceFileError,
        "geometry",
        keys=frozenset({"coil", "body", "material", "payload", "driver", "workspace"}),
        taken_by="`fieldmap check` takes it",
        json_schema="device.schema.json",
    )
)
MATERIAL = register(
    FileKind(
        "material",
        MaterialFile,
        DeviceFileError,
        "geometry",
        "materials",
        keys=frozenset({"H_A_per_m", "B_T"}),
        taken_by='a device file names it: kind = "bh_table", file = "..."',
        json_schema="material.schema.json",
    )
)
