"""Reading recipes: the shipped ones, and what each mistake says."""

import re

import numpy as np
import pytest

from fieldmap.errors import RecipeError
from fieldmap.maps import generate, read_recipe
from fieldmap.maps.recipe import choose_grid, read_recipe_device
from fieldmap.shipped import shipped_names


@pytest.mark.parametrize("name", shipped_names("maps"))
def test_shipped_recipes_are_sound(name):
    recipe = read_recipe(name)
    device = read_recipe_device(recipe)
    grid = choose_grid(recipe.box(device), recipe.spacing)
    assert recipe.file_name == f"{name}.h5"
    if name == "sample":  # a small box, for a small file
        assert (grid.lower > device.workspace.lower).all()
        assert (grid.upper < device.workspace.upper).all()
        return
    np.testing.assert_allclose(grid.lower, device.workspace.lower)
    np.testing.assert_allclose(grid.upper, device.workspace.upper, atol=1e-15)


def test_everything_a_recipe_can_say(rig):
    text = """
    format = 1
    title = "All keys"
    device = "pair.toml"
    spacing_mm = [2, 2.5, 1.0]
    [box]
    lower_mm = [-1, -2, -3]
    upper_mm = [9, 8, 7]
    [iron]
    model = "linear"
    mu_r = 4000
    tolerance = 1e-4
    refinement = 1.5
    [output]
    file = "other.h5"
    reference_current_A = 1.5
    """
    (rig / "recipe.toml").write_text(text)
    recipe = read_recipe(rig / "recipe.toml")
    assert (recipe.title, recipe.device, recipe.file_name) == ("All keys", "pair.toml", "other.h5")
    assert (recipe.mu_r, recipe.tolerance, recipe.reference_current) == (4000.0, 1e-4, 1.5)
    assert recipe.refinement == 1.5
    np.testing.assert_allclose(recipe.spacing, [2e-3, 2.5e-3, 1e-3])
    np.testing.assert_allclose(recipe.lower, [-1e-3, -2e-3, -3e-3])
    np.testing.assert_allclose(recipe.upper, [9e-3, 8e-3, 7e-3])


def test_what_is_left_out(rig):
    recipe = read_recipe(rig / "recipe.toml")
    assert (recipe.mu_r, recipe.tolerance, recipe.reference_current) == (None, 1e-3, None)
    assert (recipe.lower, recipe.upper, recipe.file_name) == (None, None, "recipe.h5")
    np.testing.assert_allclose(recipe.spacing, 2e-3)


# What is put in place of the recipe's last line, and what must be said: key, condition, received, remedy.
MISTAKES = {
    "wrong type": ('spacing_mm = "2"', r'toml:5: spacing_mm: one positive number.*received "2"'),
    "negative": ("spacing_mm = -2.0", "spacing_mm: one positive number, or three.*received -2.0; write for"),
    "zero": ("spacing_mm = 0", "spacing_mm: one positive number.*received 0"),
    "nan": ("spacing_mm = nan", "spacing_mm: one positive number.*received nan"),
    "one of three": ("spacing_mm = [1, 2, -3]", r"spacing_mm: one positive number.*\[1, 2, -3\]"),
    "two of three": ("spacing_mm = [1, 2]", r"spacing_mm: one positive number, or three.*\[1, 2\]"),
    "true": ("spacing_mm = true", "spacing_mm: one positive number.*received true"),
    "missing": ("", "spacing_mm: this key is required.*add spacing_mm"),
    "unknown key": ("spacing_mm = 2\nspacings_mm = 3", 'unknown key "spacings_mm"; did you mean spacing_mm'),
    "unknown table": ("spacing_mm = 2\n[grid]\nn = 3", 'toml:6: grid: known keys.*unknown key "grid"'),
    "not TOML": ("spacing_mm = = 2", "toml:5:14: the file must be valid TOML.*correct the line"),
    "empty box": (
        "spacing_mm = 2\n[box]\nlower_mm = [0, 0, 0]\nupper_mm = [9, 9, -9]",
        r"box.upper_mm: the box must not be empty.*\(along z\); swap the two corners",
    ),
    "half a box": ("spacing_mm = 2\n[box]\nlower_mm = [0, 0, 0]", "box.upper_mm: this key is required"),
    "flat corner": (
        "spacing_mm = 2\n[box]\nlower_mm = [0, 0]\nupper_mm = [9, 9, 9]",
        "box.lower_mm: needs at least 3 entries; received 2 entries",
    ),
    "unknown model": (
        'spacing_mm = 2\n[iron]\nmodel = "magic"',
        "iron.model: must be 'linear', 'saturating' or 'hysteresis'; received \"magic\"",
    ),
    "negative permeability": ("spacing_mm = 2\n[iron]\nmu_r = -5", 'iron.mu_r: "initial".*received -5'),
    "unknown word": ('spacing_mm = 2\n[iron]\nmu_r = "high"', 'iron.mu_r: "initial".*received "high"'),
    "loose tolerance": (
        "spacing_mm = 2\n[iron]\ntolerance = 2.0",
        "iron.tolerance: must be at most 0.1; received 2.0",
    ),
    "no mesh": ("spacing_mm = 2\n[iron]\nrefinement = 0.0", "iron.refinement: must be at least 0.1"),
    "no tolerance": ("spacing_mm = 2\n[iron]\ntolerance = 0.0", "iron.tolerance: must be greater than 0"),
    "no current": (
        "spacing_mm = 2\n[output]\nreference_current_A = 0.0",
        "output.reference_current_A: must be greater than 0; received 0.0",
    ),
    "folder": ('spacing_mm = 2\n[output]\nfile = "a/b.h5"', "output.file: a file name that ends in .h5"),
    "suffix": ('spacing_mm = 2\n[output]\nfile = "map.csv"', 'output.file: .*received "map.csv"'),
    "coarse": (
        "spacing_mm = 7.0",
        "spacing_mm: at least 5 nodes along each axis; received a box of 20 x 20 x 24",
    ),
    "too fine": ("spacing_mm = 0.01", "spacing_mm: at most 2000000 nodes.*2001 x 2001 x 2401 nodes"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_every_mistake_has_its_message_and_leaves_no_file(rig, recipe_text, mistake):
    line, words = MISTAKES[mistake]
    path = rig / "recipe.toml"
    path.write_text(recipe_text.replace("spacing_mm = 2.0\n", line + "\n"))
    with pytest.raises(RecipeError, match=words) as caught:
        generate(path, rig / "out" / "map.h5")
    assert caught.value.exit_code == 2
    assert all(str(path) in problem.where for problem in caught.value.problems)
    assert not (rig / "out").exists()


def test_all_mistakes_at_once_in_the_order_of_lines(rig):
    path = rig / "recipe.toml"
    path.write_text(
        'format = 2\ntitle = ""\ndevice = 5\nspacing_mm = -1\n[iron]\ntolerance = "low"\nmur = 3\n'
    )
    with pytest.raises(RecipeError) as caught:
        read_recipe(path)
    keys = [problem.where.rpartition(": ")[2] for problem in caught.value.problems]
    assert keys == ["format", "title", "device", "spacing_mm", "iron.tolerance", "iron.mur"]


@pytest.mark.parametrize(
    ("device", "words"),
    [
        ("drive_unti", 'a shipped device; received "drive_unti"; did you mean "drive_unit"?'),
        (
            "somewhere/rig.toml",
            'received "somewhere/rig.toml"; give a path relative to the recipe, or one of',
        ),
    ],
)
def test_unknown_device(rig, recipe_text, device, words):
    path = rig / "recipe.toml"
    path.write_text(recipe_text.replace("pair.toml", device))
    with pytest.raises(RecipeError, match=words.replace("?", r"\?")) as caught:
        generate(path, rig / "map.h5")
    assert f"{path}:4: device" in str(caught.value)


def test_unknown_recipe():
    for name, offered in (("quikc", {"quick"}), ("somewhere/else.toml", {"division", "quick"})):
        with pytest.raises(RecipeError) as error:
            read_recipe(name)
        (problem,) = error.value.problems
        assert problem.where == name
        assert offered <= set(re.findall(r'"(\w+)"', problem.remedy))


def test_a_recipe_that_is_no_text(rig):
    (rig / "recipe.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(RecipeError, match="UTF-8"):
        read_recipe(rig / "recipe.toml")
