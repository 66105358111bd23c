"""The short forms of device files in the JSON Schema for editors; `fieldmap.device.expansion` writes them out."""

from typing import Any

_EXPRESSION = {"type": "string", "pattern": "^="}
_TEXTS = {"anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}}]}


def with_short_forms(schema: dict[str, Any], copies: dict[str, Any], image: dict[str, Any]) -> dict[str, Any]:
    """The JSON Schema of a device file that may have short forms, and those of the tables of copies and of an image."""
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
