"""Copies and mirror images of the tables of a device file: their keys, where a copy stands, and the short forms in the
JSON Schema for editors."""

from typing import Annotated, Any

from pydantic import Field, ValidationInfo, field_validator

from fieldmap.device.placement import MOST_COPIES, Axis, mirrored_keys, moved_keys, turned_keys
from fieldmap.inputs.tables import LARGEST_LENGTH_MM, Coordinate, Point, Table, broken

Place = tuple[list[float], list[float]]
"""position_mm and rotation_deg."""


class Repeat(Table):
    """Copies of a table. Other keys are lists of values, one for each copy."""

    count: Annotated[int, Field(ge=1, le=MOST_COPIES)] | None = Field(
        default=None,
        validate_default=True,
        description="how many; as many as the lists have values if left out",
    )
    about: Axis | None = Field(default=None, description="axis that they are turned about")
    step_deg: Annotated[float, Field(ge=-LARGEST_LENGTH_MM, le=LARGEST_LENGTH_MM)] | None = Field(
        default=None, description="from one to the next; a full turn divided by count if left out"
    )
    centre_mm: Point | None = Field(default=None, description="[x, y, z] of a point of the axis")
    step_mm: Point | None = Field(default=None, description="[x, y, z] from one to the next")

    @field_validator("count")
    @classmethod
    def _is_known(cls, count: int | None) -> int | None:
        if count is None:
            must_hold = f"count must be a whole number from 1 to {MOST_COPIES}"
            raise broken(must_hold, "nothing", "write for instance count = 6")
        return count

    @field_validator("step_deg", "centre_mm")
    @classmethod
    def _belongs_to_an_axis(cls, value: Any, info: ValidationInfo) -> Any:
        if value is not None and info.data.get("about", "") is None:
            raise broken("step_deg and centre_mm belong to about", "no about", 'add about = "z"')
        return value

    def place(self, k: int, position_mm: list[float], rotation_deg: list[float]) -> Place:
        """Where the k-th copy stands, from 0."""
        if self.about is not None:
            assert self.count is not None
            step = 360.0 / self.count if self.step_deg is None else self.step_deg
            centre = self.centre_mm or [0.0, 0.0, 0.0]
            position_mm, rotation_deg = turned_keys(position_mm, rotation_deg, self.about, k * step, centre)
        if self.step_mm is not None:
            position_mm = moved_keys(position_mm, [k * x for x in self.step_mm])
        return position_mm, rotation_deg


class Image(Table):
    """A mirror image."""

    plane: Axis = Field(description="axis that the mirror is square to")
    at_mm: Coordinate = Field(default=0.0, description="where the mirror crosses that axis")
    name: str | None = Field(
        default=None, description="of the image; {name} stands for the name of the table"
    )

    @property
    def axis(self) -> int:
        """The local axis of a shape, 0 or 1, that changes its sign."""
        return 1 if self.plane == "y" else 0

    def place(self, position_mm: list[float], rotation_deg: list[float]) -> Place:
        """Where the image stands."""
        return mirrored_keys(position_mm, rotation_deg, self.plane, self.at_mm)[:2]


# ---- JSON Schema ----

_EXPRESSION = {"type": "string", "pattern": "^="}
_TEXTS = {"anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}}]}


def with_short_forms(schema: dict[str, Any], copies: dict[str, Any], image: dict[str, Any]) -> dict[str, Any]:
    """The JSON Schema of a device file with its short forms. copies, image: schemas of the tables of these."""
    for keys in (copies["properties"], image["properties"]):
        keys |= {key: _computable(about) for key, about in keys.items()}
    copies["properties"]["count"]["anyOf"].append(_EXPRESSION)
    copies["additionalProperties"] = {"anyOf": [{"type": "array"}, _EXPRESSION]}
    one = {"anyOf": [{"enum": ["x", "y", "z"]}, {"$ref": "#/$defs/Image"}]}
    mirror = {
        "description": "mirror images beside this table: one mirror, or several in turn",
        "anyOf": [*one["anyOf"], {"type": "array", "items": one}],
    }
    schema["properties"] |= {
        "include": {
            "description": "device files that this one begins with, relative to it, or shipped ones",
            **_TEXTS,
        },
        "without": {
            "description": "key paths of included files that are left out, such as body.disk",
            **_TEXTS,
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
            keys["repeat"], keys["mirror"] = {"$ref": "#/$defs/Repeat"}, {"$ref": "#/$defs/Mirror"}
            keys["name"] = {"anyOf": [keys["name"], {"type": "string", "pattern": "[{].*[}]"}]}
    schema["$defs"] |= {"Repeat": copies, "Image": image, "Mirror": mirror}
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
