"""The schema files for editors: in step with the reader, and accepting what the reader accepts."""

import json
import tomllib
from functools import cache
from pathlib import Path

import jsonschema
import pytest

from fieldmap.io.json_schema import schema_files, schema_text
from fieldmap.shipped import shipped_folder

GEOMETRY = shipped_folder("geometry")
SCHEMAS = schema_files()
DEVICES = sorted(path for path in GEOMETRY.glob("*.toml") if not path.stem.startswith("planar"))
MATERIALS = sorted((GEOMETRY / "materials").glob("*.toml"))
MISTAKES = tomllib.loads((Path(__file__).parent / "mistakes.toml").read_text())["case"]
# What ties one key to another is beyond JSON Schema; all other mistakes must be seen by an editor too.
BETWEEN_KEYS = {
    "ring inside out",
    "polygon crosses itself",
    "polygon closed twice",
    "polygon without area",
    "profile across the axis",
    "edge coarser than mesh",
    "begins with a cut",
    "STEP file missing",
    "unknown material",
    "body twice",
    "coil twice",
    "corner tighter than the winding",
    "corner rounder than the coil",
    "path clockwise",
    "path too short for its arcs",
    "B falls",
    "H repeats",
    "one B too few",
    "flatter than free space",
    "extension without its saturation",
    "saturation without its extension",
    "table ends above its saturation",
    "table already saturated",
    "section of no body",
    "section twice",
    "section without direction",
    "Marrocco never saturates",
    "Marrocco saturates too late",
    "material file missing",
    "impossible inertia",
    "empty workspace",
    "too few currents",
    "source of nothing",
}
# JSON has no such numbers, so JSON Schema cannot speak of them; and it takes " " for a text.
BEYOND_JSON = {"not a number", "title empty"}


@cache
def validator(name: str) -> jsonschema.Draft202012Validator:
    schema = json.loads((GEOMETRY / name).read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


@pytest.mark.parametrize("path", SCHEMAS, ids=lambda path: path.name)
def test_the_schema_file_is_in_step_with_the_reader(path):
    assert path.read_text() == schema_text(SCHEMAS[path]), "run python -m fieldmap.io.json_schema"


@pytest.mark.parametrize("path", DEVICES, ids=lambda path: path.stem)
def test_shipped_devices_validate(path):
    validator("device.schema.json").validate(tomllib.loads(path.read_text()))


@pytest.mark.parametrize("path", MATERIALS, ids=lambda path: path.stem)
def test_shipped_materials_validate(path):
    validator("material.schema.json").validate(tomllib.loads(path.read_text()))


@pytest.mark.parametrize("path", [*DEVICES, *MATERIALS], ids=lambda path: path.stem)
def test_shipped_files_point_an_editor_at_their_schema(path):
    first = path.read_text().splitlines()[0]
    assert first.startswith("#:schema ")
    assert (path.parent / first.removeprefix("#:schema ")).resolve() in SCHEMAS


def test_the_file_with_everything_validates(valid_text):
    validator("device.schema.json").validate(tomllib.loads(valid_text))


@pytest.mark.parametrize("case", MISTAKES, ids=lambda case: case["id"])
def test_an_editor_sees_the_mistakes_that_a_schema_can_see(case, valid_text):
    data = tomllib.loads(valid_text.replace(case["old"], case["new"], 1))
    seen = not validator("device.schema.json").is_valid(data)
    assert seen == (case["id"] not in BETWEEN_KEYS | BEYOND_JSON)
