"""The script makes the maps that are missing, then the report."""

import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "scripts" / "reproduce_thesis.py"


@pytest.fixture
def script(monkeypatch):
    spec = spec_from_file_location("reproduce_thesis", SCRIPT)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_maps_are_made_before_the_report(script, monkeypatch, tmp_path):
    done = []
    monkeypatch.setattr(
        script.fieldmap, "generate", lambda recipe, output, progress: done.append((recipe, output))
    )
    monkeypatch.setattr(script, "command_line", lambda words: done.append(words) or 0)
    maps, report = tmp_path / "maps", tmp_path / "report"
    words = ["S3", "S12", "--report", str(report), "--maps", str(maps)]
    monkeypatch.setattr(sys, "argv", ["reproduce_thesis.py", *words])
    assert script.main() == 0
    assert done == [("division", maps / "division.h5"), ["thesis", *words]]
    (maps / "division.h5").write_bytes(b"a map")
    assert script.main() == 0
    assert done[2:] == [["thesis", *words]]


def test_a_report_without_maps(script, monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "argv", ["reproduce_thesis.py", "S3", "--report", str(tmp_path / "report")])
    assert script.main() == 0
    assert (tmp_path / "report" / "index.html").is_file()
