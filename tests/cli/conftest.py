"""A small machine whose answers are known in closed form: a thin loop that carries a dipole below it."""

import contextlib
import io
from pathlib import Path
from types import SimpleNamespace

import pytest

from fieldmap.cli import main

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
