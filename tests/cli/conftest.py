"""A small machine with a closed form: a thin loop that carries a dipole below it."""

import contextlib
import difflib
import io
import json
import re
import shlex
from pathlib import Path
from types import SimpleNamespace

import pytest

from fieldmap.cli import main

GOLDEN = Path(__file__).parent / "golden"
DEVICES = Path(__file__).parents[1] / "devices"
DEVICE = (DEVICES / "thin_loop.toml").read_text()

RECIPE = """
format = 1
title = "Field of a thin loop"
device = "thin_loop.toml"
spacing_mm = 2.0

[iron]
model = "linear"
mu_r = "initial"
tolerance = 1e-3

[output]
file = "thin_loop.h5"
reference_current_A = 1.0
"""


@pytest.fixture(scope="session")
def machine(tmp_path_factory):
    """Folder, device, recipe and finished map of the thin loop."""
    folder = tmp_path_factory.mktemp("machine")
    device, recipe, path = folder / "thin_loop.toml", folder / "loop.toml", folder / "out" / "loop.h5"
    device.write_text(DEVICE)
    recipe.write_text(RECIPE)
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        assert main(["map", str(recipe), "-o", str(path)]) == 0
    return SimpleNamespace(folder=folder, device=str(device), recipe=str(recipe), map=str(path))


@pytest.fixture
def unsmoothed(monkeypatch):
    """Scenes with jagged edges: smoothing takes three quarters of the drawing time."""
    monkeypatch.setattr("pyvista.Plotter.enable_anti_aliasing", lambda *_, **__: None)


@pytest.fixture
def command(capsys):
    """command(line, *words): runs `fieldmap LINE WORDS`; returns the exit code, stdout and stderr."""

    def run(line, *words):
        capsys.readouterr()
        code = main([*shlex.split(line), *map(str, words)])
        return code, *capsys.readouterr()

    return run


@pytest.fixture
def answer(command):
    """answer(line, *words): the output of `fieldmap LINE WORDS --json` as Python, with exit code `ends`."""

    def run(line, *words, ends=0):
        code, out, err = command(line, *words, "--json")
        assert code == ends, err
        return json.loads(out)

    return run


VARIES = (
    # Colours, which some CI services force.
    (re.compile(r"\x1b\[[\d;]*m"), ""),
    # Residuals, which depend on rounding, and the number of steps of a search.
    (re.compile(r"[-+]?\d(\.\d+)?e-(0[7-9]|[1-9]\d)\b|\b0\.0e\+00"), "<tiny>"),
    # A direction and its opposite are the same eigenvector.
    (re.compile(r"^ \([-+](.{5}), [-+](.{5}), [-+](.{5})\)", re.MULTILINE), r" (±\1, ±\2, ±\3)"),
    (re.compile(r"\d+ starts, \d+ field points"), "<n> starts, <n> field points"),
    (re.compile(r"[\d.]+ s of one processor: \d+ times"), "<seconds> s of one processor: <n> times"),
    (re.compile(r"\d+\.\d+ MB"), "<size> MB"),
)


def masked(text):
    """The text with placeholders for parts that differ between machines and runs; no blanks at the ends of lines."""
    for pattern, placeholder in VARIES:
        text = pattern.sub(placeholder, text)
    return "".join(f"{line.rstrip()}\n" for line in text.splitlines())


@pytest.fixture
def golden(request):
    """golden(name, text): the text must equal golden/NAME.txt; `pytest --rewrite-golden` writes that file anew."""

    def hold(name, text):
        path, found = GOLDEN / f"{name}.txt", masked(text)
        if request.config.getoption("--rewrite-golden"):
            path.write_text(found, encoding="utf-8")
        expected = path.read_text(encoding="utf-8") if path.is_file() else ""
        lines = (expected.splitlines(keepends=True), found.splitlines(keepends=True))
        difference = "".join(difflib.unified_diff(*lines, f"golden/{path.name}", "printed now"))
        if difference:
            pytest.fail(f"{difference}\nIf this is meant: pytest --rewrite-golden {request.node.nodeid}")

    return hold
