"""A rig without iron, quick to map, with a closed form on its axis; and one whose iron saturates."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from fieldmap.maps import generate, generation
from fieldmap.maps.error_bound import certified_bounds
from fieldmap.maps.training import condensation, sampling, sequence

DEVICES = Path(__file__).parents[1] / "devices"
DEVICE = (DEVICES / "pair.toml").read_text()

TWO_CORES = (DEVICES / "two_cores.toml").read_text()

RECIPE = """
format = 1
title = "Between two coils"
device = "pair.toml"
spacing_mm = 2.0
"""

SATURATING = """
format = 1
title = "Below two cores, saturating"
device = "two_cores.toml"
spacing_mm = 2.5

[iron]
model = "saturating"
refinement = {refinement}

[currents]
lower_A = [0.5, -1.0]
upper_A = 2.0
states = {states}
accuracy = {accuracy}
modes = {modes}
points = {points}
fields = {fields}
held_out = {held_out}
"""
FEW_STATES = SATURATING.format(
    refinement=0.3, states=10, accuracy="1e-9", modes=12, points=60, fields=4, held_out=2
)


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
def coarse(rig):
    """The folder of a coarse recipe, quick to map, for tests that do not depend on the nodes."""
    (rig / "recipe.toml").write_text(RECIPE.replace("spacing_mm = 2.0", "spacing_mm = 6.0"))
    return rig


@pytest.fixture
def recipe_text():
    """The recipe's text."""
    return RECIPE


@pytest.fixture(scope="session")
def two_cores():
    """Text of a device of two cores on a bar, with the mirrors x = 0 and y = 0."""
    return TWO_CORES


def write_few_states(folder):
    (folder / "two_cores.toml").write_text(TWO_CORES)
    (folder / "recipe.toml").write_text(FEW_STATES)
    return folder / "recipe.toml"


@pytest.fixture
def few_states(tmp_path):
    """Recipe file of a quick map of the two cores: ten states for training, two held out, four corners. The states do
    not reach the accuracy of the recipe."""
    return write_few_states(tmp_path)


def with_little_care(patch):
    """Limit the rounds of the choice of sample points and the states tried in each. A training that cannot reach the
    accuracy uses up all of them. Other tests cover the accuracy of few points and modes."""
    patch.setattr(condensation, "_STATES", 60)
    patch.setattr(sequence, "ROUNDS", 6)
    patch.setattr(sampling, "_EXTREMES", 8)
    patch.setattr(sampling, "_RANDOM", 8)


@pytest.fixture(scope="session")
def few_states_map(tmp_path_factory):
    """The map of that recipe with its error accepted, to be read only: path, the field function of its certificate, and
    the texts of its progress."""
    asked, told, folder = [], [], tmp_path_factory.mktemp("few_states")

    def keep(data, fields, weights):
        asked.append(fields)
        return certified_bounds(data, fields, weights)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(generation, "certified_bounds", keep)
        with_little_care(patch)
        path = generate(
            write_few_states(folder),
            folder / "map.h5",
            accept_error=True,
            progress=lambda text, share: told.append(text),
        )
    (fields,) = asked
    return SimpleNamespace(path=path, fields=fields, told=told)
