"""The list of planted errors fits the code: each stands where it says, and names tests that are there."""

import ast
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ERRORS = tomllib.loads((ROOT / "scripts" / "planted_errors.toml").read_text(encoding="utf-8"))["error"]


@pytest.mark.parametrize("error", ERRORS, ids=[error["what"] for error in ERRORS])
def test_a_planted_error_can_be_planted(error):
    text = (ROOT / error["file"]).read_text(encoding="utf-8")
    assert text.count(error["before"]) == 1
    planted = text.replace(error["before"], error["after"])
    assert planted != text
    ast.parse(planted)
    assert (ROOT / error["tests"].split()[0]).is_file()
