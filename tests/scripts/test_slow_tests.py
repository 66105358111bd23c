"""Which slow tests are left out: those of which others run every line."""

from pathlib import Path

from scripts.dev.slow_tests import Measured, chosen, shortened
from scripts.dev.tests_of_lines import reads_definitions

TESTS = Path(__file__).parents[1]

SECONDS = {
    "tests/a.py::long": 9.0,
    "tests/a.py::needed": 8.0,
    "tests/a.py::other": 1.0,
    "tests/a.py::quick": 0.01,
    "tests/a.py::case[1]": 2.0,
    "tests/a.py::case[2]": 0.3,
    "tests/a.py::starts": 5.0,
    "tests/a.py::documents": 5.0,
    "tests/physics/b.py::sphere": 7.0,
}
LINES = {
    "tests/a.py::long": {1, 2},
    "tests/a.py::needed": {1, 7},
    "tests/a.py::other": {1, 2},
    "tests/a.py::quick": {1},
    "tests/a.py::case[1]": {1},
    "tests/a.py::case[2]": {1},
    "tests/a.py::starts": {1},
    "tests/physics/b.py::sphere": {1},
}


def left_out(enough=1, case=0.5):
    tests = {n: Measured(s, 1.0 if n.endswith("starts") else 0.0) for n, s in SECONDS.items()}
    lines = {name: {("fieldmap/x.py", line) for line in those} for name, those in LINES.items()}
    return set(chosen(tests, lines, 0.2, case, enough))


def test_every_line_is_still_run():
    # Of the two that run line 2 the longer one goes; line 7 has one test.
    assert left_out() == {"tests/a.py::long", "tests/a.py::case[1]"}
    stay = set(SECONDS) - left_out()
    assert set().union(*(LINES.get(name, set()) for name in stay)) == {1, 2, 7}


def test_by_two_where_two_are_asked_for():
    assert left_out(enough=2) == {"tests/a.py::case[1]"}


def test_of_a_function_whose_cases_are_long_none_may_stay():
    # The last that runs line 2 stays, as does the case of a closed form.
    assert left_out(case=0.1) == {"tests/a.py::long", "tests/a.py::case[1]", "tests/a.py::case[2]"}


def test_a_function_is_named_once_where_all_its_cases_are_left_out():
    assert shortened(left_out(), SECONDS) == ["tests/a.py::case[1]", "tests/a.py::long"]
    assert shortened(left_out(case=0.1), SECONDS) == ["tests/a.py::case", "tests/a.py::long"]


def test_tests_of_definitions_are_known_by_what_they_read():
    names = {path.name for path in TESTS.rglob("test_*.py") if reads_definitions(path)}
    assert {"test_keys.py", "test_api_signatures.py", "test_json_schema.py", "test_data_classes.py"} <= names
    assert len(names) < 20
