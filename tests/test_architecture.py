"""Modules of the package do not import each other in circles, not even within a package or inside functions."""

import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def counts():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "scripts" / "dev"))
        return importlib.import_module("architecture_counts")


@pytest.fixture(scope="module")
def package(counts):
    """The modules of this package, read once."""
    return counts.modules(ROOT)


def test_modules_import_each_other_in_no_circle(counts, package):
    assert not counts.circles(counts.imports(package))


def test_packages_import_each_other_in_no_circle(counts, package):
    assert not counts.circles(counts.by_packages(package))


def test_an_import_is_no_string(counts, package):
    """Imports by a quoted name are of libraries, which may be missing, and of modules in the same package: alternatives
    in a folder, and tables for lazy imports. `fieldmap` itself names modules for users.
    """
    named = {
        (module.name, name)
        for module in package.values()
        for name in counts.imports_by_name(module)
        if name.startswith(("fieldmap", "*")) and module.name != "fieldmap"
    }
    others = {(by, name) for by, name in named if by.split(".")[1:2] != name.split(".")[1:2]}
    assert not others


@pytest.fixture
def written(tmp_path):
    """A small package: a and b import each other, c imports itself through d in a function, and e is in no circle."""
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


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("import_module('fieldmap.far.c')", "fieldmap.far.c"),
        ("importlib.import_module('fieldmap.far').c", "fieldmap.far"),
        ("__import__('fieldmap.far.c')", "fieldmap.far.c"),
        ("import_module(f'fieldmap.far.{x}')", "fieldmap.far.*"),
        ("import_module(f'fieldmap.{x}')", "fieldmap.*"),
        ("import_module(TABLE[x])", "fieldmap.far.c"),
        ("import_module(x)", "*"),
        ("require('fieldmap.far.c', 'make', 'late')", "fieldmap.far.c"),
    ],
)
def test_a_circle_of_packages_by_a_name_is_found(counts, written, line, name):
    """Package far imports near; a function in near imports far by name."""
    files = {
        "far/__init__": "",
        "far/c": "from fieldmap.near.d import name\n",
        "near/__init__": "",
        "near/d": f"TABLE = {{'c': 'fieldmap.far.c'}}\n\ndef late(x):\n    return {line}\n",
    }
    for file, text in files.items():
        path = written / "fieldmap" / f"{file}.py"
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    package = counts.modules(written)
    assert name in counts.imports_by_name(package["fieldmap.near.d"])
    assert any({"far", "near"} <= set(circle) for circle in counts.circles(counts.by_packages(package)))


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
