"""The short forms of device files in the JSON Schema for editors; `fieldmap.device.expansion` writes them out."""

from typing import Any

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
