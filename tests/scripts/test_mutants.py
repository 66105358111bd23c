"""The lists of planted errors and of equivalent mutants fit the code: each line exists where the list says, and the
named tests exist."""

import ast
import tomllib
from pathlib import Path

import pytest

from scripts.dev.tests_of_lines import TestsOfLines as Known
from scripts.dev.tests_of_lines import reads_definitions

ROOT = Path(__file__).parents[2]
ERRORS, EQUIVALENT = (
    tomllib.loads((ROOT / "scripts" / "dev" / f"{name}.toml").read_text(encoding="utf-8"))[key]
    for name, key in (("planted_errors", "error"), ("equivalent_mutants", "mutant"))
)


@pytest.mark.parametrize("error", ERRORS, ids=[error["what"] for error in ERRORS])
def test_a_planted_error_can_be_planted(error):
    text = (ROOT / error["file"]).read_text(encoding="utf-8")
    assert text.count(error["before"]) == 1
    planted = text.replace(error["before"], error["after"])
    assert planted != text
    if error["file"].endswith(".py"):
        ast.parse(planted)
    assert (ROOT / error["tests"].split()[0]).is_file()


@pytest.mark.parametrize("mutant", EQUIVALENT, ids=[mutant["before"] for mutant in EQUIVALENT])
def test_a_mutant_that_changes_nothing_stands_for_a_line_that_is_there(mutant):
    lines = (ROOT / mutant["file"]).read_text(encoding="utf-8").splitlines()
    assert mutant["before"] in {line.strip() for line in lines}
    assert mutant["before"] not in mutant["after"]
    assert len(mutant["why"].split()) > 5


def test_a_file_of_tests_is_run_anew_where_another_of_its_tests_is_left_out(tmp_path):
    tests = tmp_path / "tests"
    tests.mkdir()
    (tests / "test_a.py").write_text("def test_one(): pass")
    known = Known.__new__(Known)
    known._checkout = tmp_path
    hashes = []
    for left_out in ("", "tests/test_b.py::test_one", "tests/test_a.py::test_one"):
        (tests / "slow.txt").write_text(left_out)
        hashes.append(known._hash("tests/test_a.py"))
    assert hashes[0] == hashes[1] != hashes[2]


def test_definitions_are_told_from_what_functions_do(tmp_path):
    lines = [
        "LIMIT = 3",
        "class A:",
        "    n: int = 2",
        "    def f(",
        "        self, x=1,",
        "    ):",
        "        return x",
    ]
    (tmp_path / "a.py").write_text("\n".join(lines))
    known = Known.__new__(Known)
    known._checkout = tmp_path
    assert [k for k in range(1, 8) if known._defines("a.py", k)] == [1, 2, 3, 4, 5, 6]


def test_tests_of_a_table_are_those_that_name_its_module_or_run_what_imports_it(tmp_path):
    for folder in ("fieldmap", "tests"):
        (tmp_path / folder).mkdir()
    (tmp_path / "fieldmap" / "table.py").write_text("LIMIT = 3")
    (tmp_path / "fieldmap" / "user.py").write_text("from fieldmap.table import LIMIT")
    (tmp_path / "fieldmap" / "other.py").write_text("from fieldmap.tables import LIMIT")
    (tmp_path / "tests" / "test_a.py").write_text("import fieldmap.table")
    (tmp_path / "tests" / "test_b.py").write_text("")
    known = Known.__new__(Known)
    known._checkout, known._data = tmp_path, []
    known._lines = {
        f"fieldmap/{k}.py": {1: {f"tests/test_b.py::test_{k}"}} for k in ("table", "user", "other")
    }
    known.seconds = dict.fromkeys(
        ("tests/test_a.py::test_it", "tests/test_b.py::test_user", "tests/test_b.py::test_other"), 0.1
    )
    assert known._beside("fieldmap.table") == {"tests/test_a.py::test_it", "tests/test_b.py::test_user"}


def test_tests_of_definitions_are_known_by_what_they_read():
    names = {path.name for path in (ROOT / "tests").rglob("test_*.py") if reads_definitions(path)}
    assert {"test_keys.py", "test_api_signatures.py", "test_json_schema.py", "test_data_classes.py"} <= names
    assert len(names) < 20
