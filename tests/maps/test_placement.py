"""Grids that fill a box from face to face."""

import dataclasses

import numpy as np
import pytest

from fieldmap.device import read_device
from fieldmap.device.model import WorkspaceCylinder
from fieldmap.errors import RecipeError
from fieldmap.maps import read_recipe
from fieldmap.maps.recipe import choose_grid


def grid_for(rig, recipe_text, lines, **changes):
    (rig / "recipe.toml").write_text(recipe_text.replace("spacing_mm = 2.0\n", lines + "\n"))
    device = dataclasses.replace(read_device(rig / "pair.toml"), **changes)
    recipe = read_recipe(rig / "recipe.toml")
    with recipe.document.placing():
        return choose_grid(recipe.box(device), recipe.spacing)


@pytest.mark.parametrize(
    ("spacing", "shape"),
    [("2.0", (11, 11, 13)), ("3.0", (8, 8, 9)), ("[5.0, 4.0, 0.1]", (5, 6, 241)), ("1.99", (12, 12, 14))],
)
def test_spacing_is_an_upper_limit_and_the_box_is_kept(rig, recipe_text, spacing, shape):
    grid = grid_for(rig, recipe_text, f"spacing_mm = {spacing}")
    assert grid.shape == shape
    np.testing.assert_allclose(grid.lower, [-0.01, -0.01, -0.012])
    np.testing.assert_allclose(grid.upper, [0.01, 0.01, 0.012], atol=1e-15)


def test_rounding_adds_no_cell(rig, recipe_text):
    # (0.3 - 0.0) / 0.1 is 2.9999999999999996 or 3.0000000000000004, depending on how it is computed.
    for step in (0.1, 0.3, 0.7, 1.1):
        upper = [round(7 * step, 10)] * 3
        lines = f"spacing_mm = {step}\n[box]\nlower_mm = [0, 0, 0]\nupper_mm = {upper}"
        assert grid_for(rig, recipe_text, lines).shape == (8, 8, 8)


def test_a_cylinder_is_boxed(rig, recipe_text):
    cylinder = WorkspaceCylinder(np.array([0.001, 0.0, -0.01]), 0.005, 0.012)
    grid = grid_for(rig, recipe_text, "spacing_mm = 2.0", workspace=cylinder)
    np.testing.assert_allclose(grid.lower, [-0.004, -0.005, -0.01])
    np.testing.assert_allclose(grid.upper, [0.006, 0.005, 0.002])


def test_no_box_at_all(rig, recipe_text):
    with pytest.raises(RecipeError) as error:
        grid_for(rig, recipe_text, "spacing_mm = 2.0", workspace=None)
    (problem,) = error.value.problems
    assert problem.where.endswith(": box")
    assert problem.received == "nothing"


def test_too_few_nodes_are_counted():
    extent, spacing = np.array([8e-3, 12e-3, 7.5e-3]), np.array([2e-3, 3e-3, 2.5e-3])
    with pytest.raises(RecipeError) as caught:
        choose_grid((np.ones(3), 1.0 + extent), spacing)
    (problem,) = caught.value.problems
    assert (
        problem.received
        == "a box of 8 x 12 x 7.5 mm and a spacing of 2 x 3 x 2.5 mm, which gives 5 x 5 x 4 nodes"
    )
    assert "at least 4 cells" in problem.remedy


def test_cells_are_a_multiple_and_not_larger_than_asked():
    grid = choose_grid((np.zeros(3), np.array([8e-3, 12e-3, 7.5e-3])), np.array([1e-3, 1.4e-3, 0.5e-3]), 8)
    assert grid.shape == (9, 17, 17)
    np.testing.assert_allclose(grid.upper, [8e-3, 12e-3, 7.5e-3])
