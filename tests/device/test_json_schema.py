"""The schema files for editors match the reader, and accept every file that the reader accepts."""

import json
import tomllib
from functools import cache
from pathlib import Path

import jsonschema
import pytest

from fieldmap.inputs.tables import PATTERNS
from fieldmap.io.json_schema import schema_files, schema_text
from fieldmap.shipped import shipped_folder

GEOMETRY = shipped_folder("geometry")
SCHEMAS = schema_files()
SHIPPED = [*sorted(GEOMETRY.glob("*.toml")), *sorted((GEOMETRY / "materials").glob("*.toml"))]
MISTAKES = tomllib.loads((Path(__file__).parent / "mistakes.toml").read_text())["case"]


@cache
def validator(path: Path) -> jsonschema.Draft202012Validator:
    schema = json.loads(path.read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


@pytest.mark.parametrize("path", SCHEMAS, ids=lambda path: path.name)
def test_the_schema_file_is_in_step_with_the_reader(path):
    assert path.read_text() == schema_text(SCHEMAS[path]), "run python -m fieldmap.io.json_schema"


@pytest.mark.parametrize(
    "path", [path for path in SHIPPED if not path.stem.startswith("planar")], ids=lambda path: path.stem
)
def test_shipped_files_validate_against_the_schema_that_they_point_an_editor_at(path):
    text = path.read_text()
    first = text.splitlines()[0]
    assert first.startswith("#:schema ")
    schema = (path.parent / first.removeprefix("#:schema ")).resolve()
    assert schema in SCHEMAS
    validator(schema).validate(tomllib.loads(text))


@pytest.mark.parametrize(
    "case", [{"id": "none", "old": "", "new": ""}, *MISTAKES], ids=lambda case: case["id"]
)
def test_an_editor_sees_the_mistakes_that_a_schema_can_see(case, valid_text):
    data = tomllib.loads(valid_text.replace(case["old"], case["new"], 1))
    valid = validator(GEOMETRY / "device.schema.json").is_valid(data)
    assert valid == (case["id"] == "none" or "beyond_schema" in case)


def patterns(schema):
    """Every pattern in a schema."""
    inner = schema.values() if isinstance(schema, dict) else schema if isinstance(schema, list) else ()
    found = (
        {schema["pattern"]} if isinstance(schema, dict) and isinstance(schema.get("pattern"), str) else set()
    )
    return found.union(*map(patterns, inner))


@pytest.mark.parametrize("path", SCHEMAS, ids=lambda path: path.name)
def test_no_pattern_is_told_as_it_is_written(path):
    """Each pattern has its own words; "= 2*gap" and "{name}" are short forms, which are expanded first."""
    assert patterns(json.loads(path.read_text())) <= {*PATTERNS, "^=", "[{].*[}]"}
