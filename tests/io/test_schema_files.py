"""The program that rewrites the schema files writes when run, and not when imported."""

import importlib
import runpy
import sys
from pathlib import Path

from fieldmap.shipped import shipped_folder

NAME = "fieldmap.io.json_schema"


def test_schemas_are_written_by_the_program_alone(monkeypatch, capsys):
    """Equal to the files in the folders, as UTF-8."""
    written = {}
    monkeypatch.setattr(
        Path, "write_text", lambda path, text, encoding: written.update({path: (text, encoding)})
    )
    monkeypatch.delitem(sys.modules, NAME, raising=False)
    schema_files = importlib.import_module(NAME).schema_files
    assert (written, capsys.readouterr().out) == ({}, "")
    monkeypatch.delitem(sys.modules, NAME)
    runpy.run_module(NAME, run_name="".join(["__main", "__"]))
    assert {path.name for path in written} == {
        "device.schema.json",
        "material.schema.json",
        "planar.schema.json",
    }
    assert written.keys() == {*shipped_folder("geometry").glob("*.schema.json")} == schema_files().keys()
    assert capsys.readouterr().out.split() == [str(path) for path in written]
    for path, (text, encoding) in written.items():
        assert (text, encoding) == (path.read_text(encoding="utf-8"), "utf-8")
