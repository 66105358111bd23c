"""The modules of the package import each other in one direction only, also within a package and inside functions."""

import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture
def counts(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "scripts" / "dev"))
    return importlib.import_module("architecture_counts")


def test_modules_import_each_other_in_no_circle(counts):
    package = counts.modules(ROOT)
    assert not counts.circles(counts.imports(package))


@pytest.fixture
def written(tmp_path):
    """A small package: a and b import each other, c imports itself by a detour inside a function, d is alone."""
    files = {
        "__init__": "",
        "a": "from fieldmap import b\n",
        "b": "import fieldmap.a\n",
        "sub/__init__": "",
        "sub/c": "def late():\n    from ..d import name\n",
        "d": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from fieldmap.sub.c import late\n",
        "e": "from fieldmap.d import name\n",
    }
    for name, text in files.items():
        path = tmp_path / "fieldmap" / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path


def test_circles_are_found(counts, written):
    package = counts.modules(written)
    at_module_level = ("fieldmap.a", "fieldmap.b")
    assert counts.circles(counts.imports(package, lazy=False)) == (at_module_level,)
    assert counts.circles(counts.imports(package)) == (at_module_level, ("fieldmap.d", "fieldmap.sub.c"))


def test_lines_are_told_apart(counts, written):
    text = '"""Two lines\nof text."""\n\nx = 1  # why\n# alone\ny = """a\nb"""\n'
    (written / "fieldmap" / "a.py").write_text(text)
    lines = counts.lines_of(counts.modules(written)["fieldmap.a"])
    assert (lines.code, lines.docstrings, lines.comments, lines.blank) == (3, 2, 1, 1)


@pytest.mark.parametrize(
    ("line", "prose"),
    [
        ("assert 'must be above zero' in text", 1),
        ("assert problem.where == 'body.disk.mesh_size_mm'", 0),
        ("assert x == 1, 'a message for the reader'", 0),
        ("with pytest.raises(InputError, match='no such file'): pass", 1),
        ("with pytest.raises(InputError, match='mesh_size'): pass", 0),
    ],
)
def test_asserts_on_prose_are_counted(counts, tmp_path, line, prose):
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_it.py").write_text(line + "\n")
    assert sum(counts.prose(tmp_path).values()) == prose


def test_script_prints_counts_of_a_checkout(written):
    script = ROOT / "scripts" / "dev" / "architecture_counts.py"
    command = [sys.executable, str(script), "--json", "--package", str(written)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    printed = json.loads(done.stdout)
    assert printed["files"] == 7
    assert sum(printed["lines"].values()) == 8
    assert printed["circles"] == [["fieldmap.a", "fieldmap.b"], ["fieldmap.d", "fieldmap.sub.c"]]
