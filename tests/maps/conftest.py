"""A rig without iron, quick to map, with a closed form on its axis; and one whose iron saturates."""

import pytest

from fieldmap.maps import generate

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

TWO_CORES = """
format = 1
name = "two_cores"
title = "Two cores on a bar, a coil on each"

[material.steel]
kind = "froehlich"
mu_r = 2000.0
saturation_polarisation_T = 2.0

[[body]]
name = "bar"
material = "steel"
shape = "box"
size_mm = [60.0, 12.0, 8.0]
position_mm = [0.0, 0.0, 20.0]
mesh_size_mm = 7.0

[[body]]
name = "left core"
material = "steel"
shape = "box"
size_mm = [10.0, 10.0, 20.0]
position_mm = [-22.0, 0.0, 0.0]
mesh_size_mm = 7.0

[[body]]
name = "right core"
material = "steel"
shape = "box"
size_mm = [10.0, 10.0, 20.0]
position_mm = [22.0, 0.0, 0.0]
mesh_size_mm = 7.0

[[coil]]
name = "left"
kind = "circular"
inner_radius_mm = 8.0
outer_radius_mm = 13.0
height_mm = 14.0
turns = 4000
position_mm = [-22.0, 0.0, 10.0]

[[coil]]
name = "right"
kind = "circular"
inner_radius_mm = 8.0
outer_radius_mm = 13.0
height_mm = 14.0
turns = 4000
position_mm = [22.0, 0.0, 10.0]

[workspace]
shape = "box"
lower_mm = [-8.0, -8.0, -16.0]
upper_mm = [8.0, 8.0, -6.0]
"""

RECIPE = """
format = 1
title = "Between two coils"
device = "pair.toml"
spacing_mm = 2.0
"""

FEW_STATES = """
format = 1
title = "Two cores, saturating"
device = "two_cores.toml"
spacing_mm = 2.5

[iron]
model = "saturating"
refinement = 0.5

[currents]
lower_A = [0.5, -1.0]
upper_A = 2.0
states = 10
accuracy = 1e-9
modes = 12
points = 60
fields = 4
held_out = 2
"""


@pytest.fixture
def rig(tmp_path):
    """Folder with pair.toml and a recipe for it, recipe.toml."""
    (tmp_path / "pair.toml").write_text(DEVICE)
    (tmp_path / "recipe.toml").write_text(RECIPE)
    return tmp_path


@pytest.fixture(scope="session")
def rig_map(tmp_path_factory):
    """The map of that recipe, to be read only; the device lies beside it."""
    folder = tmp_path_factory.mktemp("rig")
    (folder / "pair.toml").write_text(DEVICE)
    (folder / "recipe.toml").write_text(RECIPE)
    return generate(folder / "recipe.toml", folder / "map.h5")


@pytest.fixture
def recipe_text():
    """The recipe's text."""
    return RECIPE


@pytest.fixture(scope="session")
def two_cores():
    """Text of a device of two cores on a bar, with the mirrors x = 0 and y = 0."""
    return TWO_CORES


@pytest.fixture
def few_states(tmp_path, two_cores):
    """Recipe file of a quick map of the two cores: ten states for training, two held out, four corners."""
    (tmp_path / "two_cores.toml").write_text(two_cores)
    (tmp_path / "recipe.toml").write_text(FEW_STATES)
    return tmp_path / "recipe.toml"
