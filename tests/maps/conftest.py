"""A rig without iron, quick to map, with a closed form on its axis."""

import pytest

DEVICE = """
format = 1
name = "pair"
title = "Two coils on one axis"

[[coil]]
name = "upper"
kind = "circular"
inner_radius_mm = 20.0
outer_radius_mm = 30.0
height_mm = 12.0
turns = 100
position_mm = [0.0, 0.0, 40.0]

[[coil]]
name = "lower"
kind = "circular"
inner_radius_mm = 20.0
outer_radius_mm = 30.0
height_mm = 12.0
turns = 200
position_mm = [0.0, 0.0, -40.0]

[workspace]
shape = "box"
lower_mm = [-10.0, -10.0, -12.0]
upper_mm = [10.0, 10.0, 12.0]
"""

RECIPE = """
format = 1
title = "Between two coils"
device = "pair.toml"
spacing_mm = 2.0
"""


@pytest.fixture
def rig(tmp_path):
    """Folder with pair.toml and a recipe for it, recipe.toml."""
    (tmp_path / "pair.toml").write_text(DEVICE)
    (tmp_path / "recipe.toml").write_text(RECIPE)
    return tmp_path


@pytest.fixture
def recipe_text():
    """The recipe's text."""
    return RECIPE
