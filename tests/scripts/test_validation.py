"""The table of `make validate`: verdicts, visible failures, and one study that runs."""

import json
import subprocess
import sys

import numpy as np
import pytest

from fieldmap.errors import InputError, Problem
from tests.scripts.conftest import SCRIPTS


@pytest.fixture
def validate(program):
    return program("validate")


def test_a_study_of_closed_forms_runs():
    """Spheres within their bounds, by the command; the exit code follows the verdicts."""
    arguments = [sys.executable, str(SCRIPTS / "validate.py"), "--only", "spheres", "--json"]
    done = subprocess.run(arguments, capture_output=True, text=True)
    rows = json.loads(done.stdout)
    assert done.returncode == 0
    assert len(rows) == 9
    assert all(row["verdict"] == "pass" and row["study"] == "spheres" for row in rows)
    assert all(row["source"] and 0 < row["value"] < row["bound"] for row in rows)
    assert "[1/1] spheres" in done.stderr


@pytest.mark.parametrize(
    ("value", "bound", "verdict"),
    [(1e-3, 2e-3, "pass"), (-3e-3, 2e-3, "FAIL"), (0.5, None, "-"), (float("nan"), 2e-3, "NOT RUN")],
)
def test_verdicts(validate, value, bound, verdict):
    assert validate.Row("case", "B", value, bound, "source").verdict == verdict
    assert validate.Row("case", "B", value, bound, "source", skipped=True).verdict == "skipped"


def test_a_broken_study_is_a_row_and_the_rest_goes_on(validate, monkeypatch):
    def broken():
        yield validate.Row("case", "B", 1.0, 2.0, "source")
        raise InputError(Problem("here", "must work", "nothing", "repair it"))

    def sound():
        yield validate.Row("other", "B", 3.0, 2.0, "source")

    monkeypatch.setattr(validate, "STUDIES", {"broken": (broken, 1.0), "sound": (sound, 1.0)})
    rows = list(validate.run(["broken", "sound"], lambda text: None))
    assert [row.verdict for row in rows] == ["pass", "NOT RUN", "FAIL"]
    assert "must work" in rows[1].note


def test_largest_error_is_that_of_vectors(program):
    error = program("validation.row").largest_error
    exact = np.array([[3.0, 4.0, 0.0], [1.0, 0.0, 0.0]])
    assert error(exact + [[0.0, 0.0, 0.1], [0.3, 0.4, 0.0]], exact) == pytest.approx(0.1)
    assert error(np.eye(3)[None] * 1.1, np.eye(3)[None]) == pytest.approx(0.1)
