"""JSON Schema of files that people write, for editors.

`python -m fieldmap.io.json_schema` rewrites the shipped files. A schema is made from the classes of the reader. It
states keys, types, limits and choices. Only the reader checks rules between keys, such as an empty workspace.
"""

import json
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema

from fieldmap.device.schema import DEVICE, MATERIAL
from fieldmap.dynamics.scenario.schema import SCENARIO
from fieldmap.inputs.kinds import FileKind
from fieldmap.maps.recipe import RECIPE
from fieldmap.planar.device_file import PLANAR_DEVICE
from fieldmap.shipped import shipped_folder
from fieldmap.studies.machine_fit import FIT
from fieldmap.studies.reading import STUDY

FILE_KINDS: tuple[FileKind[Any], ...] = (DEVICE, MATERIAL, PLANAR_DEVICE, RECIPE, STUDY, FIT, SCENARIO)
"""All kinds of files that people write."""

DIALECT = "https://json-schema.org/draft/2020-12/schema"


class _WithoutTitles(GenerateJsonSchema):
    """Leaves out titles made from the names of keys: they would repeat the names, and lose the case of units."""

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False


def json_schema(root: type[BaseModel]) -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of a file."""
    return {"$schema": DIALECT} | root.model_json_schema(schema_generator=_WithoutTitles)


def schema_text(root: type[BaseModel]) -> str:
    """The text of the schema file."""
    return json.dumps(json_schema(root), indent=1, ensure_ascii=False) + "\n"


def schema_files() -> dict[Path, type[BaseModel]]:
    """The shipped schema files, and the classes that they are made from."""
    kinds = [kind for kind in FILE_KINDS if kind.json_schema is not None]
    return {shipped_folder(kind.folder) / str(kind.json_schema): kind.schema for kind in kinds}


if __name__ == "__main__":
    for path, root in schema_files().items():
        path.write_text(schema_text(root), encoding="utf-8")
        print(path)
