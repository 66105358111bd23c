"""The whole of a device file, and the whole of a material file."""

from typing import TYPE_CHECKING, Any, TypeAlias

from pydantic import Field

from fieldmap.device import parts as model
from fieldmap.device.background import Background
from fieldmap.device.coils import AnyCoil
from fieldmap.device.expansion import expand
from fieldmap.device.materials import AnyMaterial
from fieldmap.device.materials.bh_table import CurveKeys
from fieldmap.device.schema.bodies import AnyBody
from fieldmap.device.schema.payload import AnyPayload
from fieldmap.device.schema.workspace import AnyReference, AnyWorkspace
from fieldmap.errors import DeviceFileError
from fieldmap.inputs.declared import table_of
from fieldmap.inputs.kinds import FileKind
from fieldmap.inputs.tables import Format, Name, Table, Text

if TYPE_CHECKING:
    BackgroundKeys: TypeAlias = Table
    JointKeys: TypeAlias = Table
    DriverKeys: TypeAlias = Table
    SectionKeys: TypeAlias = Table
else:
    BackgroundKeys, JointKeys, DriverKeys, SectionKeys = map(
        table_of, (Background, model.Joint, model.Driver, model.Section)
    )


class DeviceFile(Table):
    """A device file."""

    format: Format
    name: Name = Field(description="short name of the device")
    title: Text = Field(description="one line about the device")
    body: list[AnyBody] = Field(default=[], description="[[body]] tables: the iron and the magnets")
    material: dict[Name, AnyMaterial] = Field(default={}, description="[material.NAME] tables")
    joint: list[JointKeys] = Field(
        default=[], description="[[joint]] tables: thin gaps between bodies that touch"
    )
    coil: list[AnyCoil] = Field(default=[], description="[[coil]] tables; currents follow this order")
    background: BackgroundKeys | None = Field(
        default=None, description="a field that nothing in the device drives"
    )
    payload: AnyPayload | None = Field(default=None, description="the levitated body")
    driver: DriverKeys | None = Field(default=None, description="the amplifiers of the coils")
    workspace: AnyWorkspace | None = Field(default=None, description="where the payload may go")
    section: list[SectionKeys] = Field(default=[], description="[[section]] tables: cross-sections of iron")
    reference: list[AnyReference] = Field(default=[], description="[[reference]] tables: known values")
    provenance: dict[str, Text] = Field(
        default={}, description='"key.path" = "source of the number"; * means any one step'
    )
    parameters: dict[str, Any] = Field(
        default={}, description='numbers, texts and lists that expressions such as "= 2*gap" use'
    )

    @classmethod
    def model_json_schema(cls, *arguments: Any, **named: Any) -> dict[str, Any]:
        """With the short forms that `fieldmap.device.expansion` writes out."""
        return with_short_forms(super().model_json_schema(*arguments, **named))


_AXIS = {"enum": ["x", "y", "z"]}
_PLACE = {"type": "array", "minItems": 3, "maxItems": 3}
_EXPRESSION = {"type": "string", "pattern": "^="}
_REPEAT = {
    "description": "copies of this table; other keys are lists of values, one for each copy",
    "type": "object",
    "properties": {
        "count": {"description": "how many", "anyOf": [{"type": "integer"}, _EXPRESSION]},
        "about": {"description": "axis that they are turned about", **_AXIS},
        "step_deg": {"description": "from one to the next; a full turn divided by count if left out"},
        "centre_mm": {"description": "[x, y, z] of a point of the axis", **_PLACE},
        "step_mm": {"description": "[x, y, z] from one to the next", **_PLACE},
    },
    "additionalProperties": {"anyOf": [{"type": "array"}, _EXPRESSION]},
}
_IMAGE = {
    "type": "object",
    "properties": {
        "plane": {"description": "axis that the mirror is square to", **_AXIS},
        "at_mm": {"description": "where the mirror crosses that axis"},
        "name": {"description": "of the image; {name} stands for the name of the table"},
    },
    "required": ["plane"],
    "additionalProperties": False,
}
_MIRROR = {
    "description": "mirror images beside this table: one mirror, or several in turn",
    "anyOf": [_AXIS, _IMAGE, {"type": "array", "items": {"anyOf": [_AXIS, _IMAGE]}}],
}


def with_short_forms(schema: dict[str, Any]) -> dict[str, Any]:
    """The JSON Schema of a device file that may have short forms."""
    schema["properties"] |= {
        "include": {
            "description": "device files that this one begins with, relative to it, or shipped ones",
            "anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}}],
        },
        "without": {
            "description": "key paths of included files that are left out, such as body.disk",
            "anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}}],
        },
        "defaults": {
            "description": "[defaults.body], [defaults.coil]: keys of all tables of this file that lack them",
            "type": "object",
        },
    }
    for table in schema["$defs"].values():
        keys = table.get("properties", {})
        for key in keys:
            keys[key] = _computable(keys[key])
        if "name" in keys and ("kind" in keys or "mesh_size_mm" in keys):
            keys["repeat"], keys["mirror"] = _REPEAT, _MIRROR
            keys["name"] = {"anyOf": [keys["name"], {"type": "string", "pattern": "[{].*[}]"}]}
    # A file that begins with others, or has defaults, need not be complete by itself.
    short = {"anyOf": [{"required": ["include"]}, {"required": ["defaults"]}]}
    whole = {key: schema.pop(key) for key in ("properties", "required", "additionalProperties", "type")}
    known = dict.fromkeys(whole["properties"], True)
    return {
        **schema,
        "type": "object",
        "if": short,
        "then": {"properties": known, "additionalProperties": False},
        "else": whole,
    }


def _computable(about: Any) -> Any:
    """The schema of a value in which an expression may stand for a number."""
    if not isinstance(about, dict):
        return about
    inner = {
        key: [_computable(one) for one in value]
        if isinstance(value, list) and key in ("anyOf", "oneOf")
        else _computable(value)
        if key == "items"
        else value
        for key, value in about.items()
    }
    if about.get("type") != "number":
        return inner
    outer = {key: inner.pop(key) for key in ("description", "default") if key in inner}
    return {"anyOf": [inner, _EXPRESSION], **outer}


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
    "material",
    MaterialFile,
    DeviceFileError,
    "geometry",
    "materials",
    json_schema="material.schema.json",
)
