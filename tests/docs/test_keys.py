"""The pages of keys have a row for every key of every file, with the schema's description; examples are valid."""

import importlib
import re
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from fieldmap.io.json_schema import FILE_KINDS

ROOT = Path(__file__).parents[2]
KINDS = {kind.name: kind for kind in FILE_KINDS}


@pytest.fixture(scope="module")
def program():
    """The script that writes the pages."""
    sys.path.insert(0, str(ROOT / "scripts" / "dev"))
    yield importlib.import_module("key_pages")
    sys.path.remove(str(ROOT / "scripts" / "dev"))
    sys.modules.pop("key_pages")


def without_examples(text: str) -> list[str]:
    """Lines of a page; rows without their last cell, because an example may come from another file."""
    return [re.sub(r"(?<=[^\\] )\| `[^|]*` \|$", "|", line) for line in text.splitlines()]


@pytest.mark.parametrize("name", sorted(KINDS))
def test_pages_are_those_that_the_program_writes(name, program):
    """`python scripts/dev/key_pages.py` writes them anew."""
    for page, text in program.pages_of(KINDS[name]).items():
        written = (program.FOLDER / f"{page}.md").read_text()
        assert without_examples(written) == without_examples(text)


def text_of(program: Any, name: str) -> str:
    """All pages of a kind of file in docs/keys, joined."""
    first = name.replace(" ", "_")
    names = [first, *(f"{first}_{part}" for part in program.PARTS.get(name, {}))]
    return "\n".join((program.FOLDER / f"{page}.md").read_text() for page in reversed(names))


def tables(program: Any, root: type[BaseModel]) -> list[type[BaseModel]]:
    return [variant.model for place in program.places(root) for variant in place.variants]


@pytest.mark.parametrize("name", sorted(KINDS))
def test_every_key_has_a_row_and_a_meaning(name, program):
    text = text_of(program, name)
    rows = re.findall(r"^\| `(\w+)` \| (.+?) \| (.+?) \| (.+?) \| (.+?) \| `(.+)` \|$", text, re.MULTILINE)
    listed = {row[0] for row in rows}
    for model in tables(program, KINDS[name].schema):
        for key, about in model.model_fields.items():
            assert key in listed
            assert about.description, f"{model.__name__}.{key}"
    assert all(cell.strip() for row in rows for cell in row)


@pytest.mark.parametrize("name", sorted(KINDS))
def test_examples_are_ones_that_the_reader_takes(name, program):
    """Each example is a line of TOML that a table of this kind of file accepts."""
    text = text_of(program, name).split("## Short forms")[0]
    models = tables(program, KINDS[name].schema)
    examples = re.findall(r"^\| `(\w+)` \|.* \| `(.+)` \|$", text, re.MULTILINE)
    assert len(examples) > 4
    for key, line in examples:
        if line.startswith("["):
            assert re.fullmatch(rf"\[+{key}(\.NAME)?\]+", line)
            continue
        ((found, value),) = tomllib.loads(line.replace("\\|", "|")).items()
        fields = [model.model_fields[key] for model in models if key in model.model_fields]
        assert found == key
        assert any(program.fits(about, value) for about in fields), line


def test_units_come_from_the_key(program):
    assert program.unit_of("position_mm") == "mm"
    assert program.unit_of("gain_A_per_V") == "A/V"
    assert program.unit_of("remanence_T") == "T"
    assert program.unit_of("turns") == "—"
    assert program.unit_of("mm_per_V") == "mm/V"
    every = {
        key for kind in KINDS.values() for model in tables(program, kind.schema) for key in model.model_fields
    }
    ends = {key for key in every if re.search(r"_(?:per_\w+|[a-zA-Z]{0,2}[A-Zm]\d?)$", key)}
    assert {key for key in ends if program.unit_of(key) == "—"} == set()
    assert all("/" in program.unit_of(key) for key in every if "_per_" in key)


def test_no_meaning_breaks_off(program):
    """Brackets are closed, and no text ends in an article, a conjunction or a comma."""
    for page in sorted(program.FOLDER.glob("*.md")):
        for line in page.read_text(encoding="utf-8").splitlines():
            cells = re.split(r"(?<!\\)\|", line)[1:-1]
            if len(cells) != 6:
                continue
            for text in (cells[1].strip(), cells[4].strip()):
                assert not re.search(r"(\b(or|and|of|the|an?|with|than|by)|[,;:(])$", text), line
                assert all(text.count(a) == text.count(b) for a, b in ("()", "[]")), line
                assert text.count('"') % 2 == text.count("`") % 2 == 0, line
