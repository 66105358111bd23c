"""A small machine whose answers are known in closed form: a thin loop that carries a dipole below it."""

import contextlib
import io
from types import SimpleNamespace

import pytest

from fieldmap.cli import main

# A 1 mm x 1 mm winding of 44 mm mean radius: on the axis it is a filament to 5e-5.
DEVICE = """
format = 1
name = "thin_loop"
title = "A thin loop above a small magnet"

[[coil]]
name = "loop"
kind = "circular"
inner_radius_mm = 43.5
outer_radius_mm = 44.5
height_mm = 1.0
turns = 1000
position_mm = [0.0, 0.0, 0.0]

[payload]
mass_g = 10.0
moment_A_m2 = 0.8
magnet_offset_mm = 5.0

[workspace]
shape = "box"
lower_mm = [-6.0, -6.0, -124.0]
upper_mm = [6.0, 6.0, -60.0]
"""

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
