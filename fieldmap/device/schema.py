"""The kinds of file of devices and materials: their schemas, and how they are found and read."""

from pydantic import Field

from fieldmap.device.expansion import expand
from fieldmap.device.materials.bh_table import CurveKeys
from fieldmap.device.model import DeviceFile
from fieldmap.errors import DeviceFileError
from fieldmap.inputs.kinds import FileKind
from fieldmap.inputs.tables import Format, Name, Text

__all__ = ["DEVICE", "MATERIAL", "DeviceFile", "MaterialFile"]


class MaterialFile(CurveKeys):
    """A file that holds one measured B-H curve."""

    format: Format
    name: Name = Field(description="short name of the material")
    title: Text = Field(description="one line about the material")
    provenance: dict[str, Text] = Field(default={}, description='"key" = "where the numbers come from"')


DEVICE = FileKind(
    "device",
    DeviceFile,
    DeviceFileError,
    "geometry",
    json_schema="device.schema.json",
    expand=expand,
    short_forms=frozenset({"include", "without", "defaults"}),
)
MATERIAL = FileKind(
    "material", MaterialFile, DeviceFileError, "geometry", "materials", json_schema="material.schema.json"
)
