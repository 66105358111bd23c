"""The script is the command with the options for a complete reproduction."""

import sys

import pytest


@pytest.fixture
def script(program):
    return program("reproduce_thesis")


def test_missing_maps_are_asked_for(script, monkeypatch, tmp_path):
    """tests/thesis/test_plan.py tests that maps are made before the parts that need them."""
    done = []
    monkeypatch.setattr(script, "command_line", lambda words: done.append(words) or 0)
    words = ["S3", "S12", "--report", str(tmp_path / "report"), "--maps", str(tmp_path / "maps")]
    monkeypatch.setattr(sys, "argv", ["reproduce_thesis.py", *words])
    assert script.main() == 0
    assert done == [["thesis", *words, "--make-maps"]]


def test_a_report_without_maps(script, monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "argv", ["reproduce_thesis.py", "S3", "--report", str(tmp_path / "report")])
    assert script.main() == 0
    assert (tmp_path / "report" / "index.html").is_file()
