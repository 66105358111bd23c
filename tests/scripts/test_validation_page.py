"""The validation page agrees with its files."""

import csv
import json
import re

import pytest

COLUMNS = ("row", "name", "kind", "deviation", "agrees", "misprint")
NUMBERS = [
    ("S7", "a", "sharp", "0.001", "true", ""),
    ("S7", "b", "sharp", "0.2", "false", ""),
    ("S7", "c", "sharp", "0.5", "false", "two digits exchanged"),
    ("S12", "d", "measured", "-0.1", "", ""),
    ("S12", "e", "measured", "0.3", "", ""),
    ("S12", "f", "measured", "", "", ""),
]
ROW = {"study": "spheres", "quantity": "error of B", "source": "a formula", "note": ""}


@pytest.fixture
def pages(program, tmp_path):
    with (tmp_path / "numbers.csv").open("w", newline="") as file:
        csv.writer(file).writerows([COLUMNS, *NUMBERS])
    old = [ROW | {"case": "sphere", "value": 0.5, "bound": 1e-3, "verdict": "FAIL"}]
    new = [
        ROW | {"case": "sphere", "value": 5e-4, "bound": 1e-3, "verdict": "pass"},
        ROW | {"case": "rod", "value": 2e-2, "bound": 1e-3, "verdict": "FAIL"},
        ROW | {"study": "killed_runs", "case": "killed run", "value": 0, "bound": 0, "verdict": "FAIL"},
        ROW | {"case": "map, 5 mm", "value": 7e-6, "bound": None, "verdict": "-"},
    ]
    for name, rows in (("old", old), ("new", new)):
        (tmp_path / f"{name}.json").write_text(json.dumps(rows))
    files = [tmp_path / "old.json", tmp_path / "new.json"]
    return program("validation_page").pages(tmp_path / "numbers.csv", files)


def test_studies_that_were_not_run_are_named(pages):
    left_out = next(line for line in pages["validation"].splitlines() if line.startswith("Not run"))
    assert "`unit_linear`" in left_out
    assert "`spheres`" not in left_out


def test_bounds_and_verdicts(pages):
    rows = {
        line.split(" | ")[0][2:]: line.split(" | ")[2:4]
        for line in pages["validation_fields"].splitlines()
        if line[:2] == "| "
    }
    assert rows["sphere"] == ["0.0005", "0.001"]
    assert rows["rod"] == ["0.02 **FAIL**", "0.001"]
    assert "1 of 3" in pages["validation"]
    assert pages["validation"].index("| map, 5 mm |") > pages["validation"].index("## Convergence")
    assert "| killed run |" in pages["validation_machines"]


def test_rows_of_the_thesis(pages):
    page = pages["validation"]
    lines = {
        line.split(" | ")[0]: line.split(" | ")[2:] for line in page.splitlines() if line.startswith("| S")
    }
    assert lines["| S7"][0] == "1 of 2"
    assert lines["| S12"][2] == "3, 20 % |"
    (total,) = (line for line in page.splitlines() if " misprint" in line and line[0].isdigit())
    assert re.findall(r"\d+", total) == ["1", "2", "1", "6"]
