"""The lists of planted errors and of mutants that change nothing fit the code: each stands where it says, and the tests
that are named are there."""

import ast
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ERRORS = tomllib.loads((ROOT / "scripts" / "planted_errors.toml").read_text(encoding="utf-8"))["error"]
EQUIVALENT = tomllib.loads((ROOT / "scripts" / "equivalent_mutants.toml").read_text(encoding="utf-8"))[
    "mutant"
]


@pytest.mark.parametrize("error", ERRORS, ids=[error["what"] for error in ERRORS])
def test_a_planted_error_can_be_planted(error):
    text = (ROOT / error["file"]).read_text(encoding="utf-8")
    assert text.count(error["before"]) == 1
    planted = text.replace(error["before"], error["after"])
    assert planted != text
    ast.parse(planted)
    assert (ROOT / error["tests"].split()[0]).is_file()


@pytest.mark.parametrize("mutant", EQUIVALENT, ids=[mutant["before"] for mutant in EQUIVALENT])
def test_a_mutant_that_changes_nothing_stands_for_a_line_that_is_there(mutant):
    lines = (ROOT / mutant["file"]).read_text(encoding="utf-8").splitlines()
    assert mutant["before"] in {line.strip() for line in lines}
    assert mutant["before"] not in mutant["after"]
    assert len(mutant["why"].split()) > 5
