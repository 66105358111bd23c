"""Plain data as TOML text: tables, arrays of tables, one key a line."""

import json
import re
from typing import Any

_BARE = re.compile(r"[A-Za-z0-9_-]+")


def toml_text(data: dict[str, Any], path: tuple[str, ...] = ()) -> str:
    """The text of a file that tomllib reads as this data.

    >>> print(toml_text({"format": 1, "coil": [{"name": "a", "turns": 840.0}]}))
    format = 1
    <BLANKLINE>
    [[coil]]
    name = "a"
    turns = 840.0
    <BLANKLINE>
    """
    lines = [f"{_key(key)} = {_value(value)}" for key, value in data.items() if not _has_header(value)]
    text = "\n".join(lines) + "\n" if lines else ""
    for key, value in data.items():
        if not _has_header(value):
            continue
        here = (*path, key)
        header = ".".join(map(_key, here))
        for table in value if isinstance(value, list) else [value]:
            brackets = f"[[{header}]]" if isinstance(value, list) else f"[{header}]"
            only_tables = bool(table) and all(map(_has_header, table.values())) and isinstance(value, dict)
            text += ("" if only_tables else f"\n{brackets}\n") + toml_text(table, here)
    return text


def _has_header(value: Any) -> bool:
    return isinstance(value, dict) or (
        isinstance(value, list) and bool(value) and all(isinstance(entry, dict) for entry in value)
    )


def _key(key: str) -> str:
    return key if _BARE.fullmatch(key) else _value(key)


def _value(value: Any) -> str:
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list):
        return "[" + ", ".join(map(_value, value)) + "]"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_key(key)} = {_value(one)}" for key, one in value.items()) + " }"
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value)
