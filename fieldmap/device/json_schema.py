"""JSON Schema of device and material files, for editors.

`python -m fieldmap.device.json_schema` rewrites the files in geometry/. The schema is made from the same
classes that the reader checks with. It knows keys, types, limits and choices; the rules between keys (an
empty workspace, a corner that is too round) are the reader's alone.
"""

import json
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema

from fieldmap.device.schema import DeviceFile, MaterialFile
from fieldmap.shipped import shipped_folder

DIALECT = "https://json-schema.org/draft/2020-12/schema"
FILES: dict[str, type[BaseModel]] = {
    "device.schema.json": DeviceFile,
    "material.schema.json": MaterialFile,
}


class _WithoutTitles(GenerateJsonSchema):
    """Keys carry descriptions; titles made from their names would only repeat them with the units spoilt."""

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False


def json_schema(root: type[BaseModel]) -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of a file."""
    return {"$schema": DIALECT} | root.model_json_schema(schema_generator=_WithoutTitles)


def schema_text(root: type[BaseModel]) -> str:
    """The text of the schema file."""
    return json.dumps(json_schema(root), indent=1, ensure_ascii=False) + "\n"


def write_schemas(folder: Path) -> list[Path]:
    """Write the schema files into a folder and return their paths."""
    paths = []
    for name, root in FILES.items():
        path = folder / name
        path.write_text(schema_text(root), encoding="utf-8")
        paths.append(path)
    return paths


if __name__ == "__main__":
    for written in write_schemas(shipped_folder("geometry")):
        print(written)
