"""Recipes, and the maps made from them.

Depends on: errors, kernels, device, store, iron, pydantic.
"""

from fieldmap.maps.generation import generate
from fieldmap.maps.recipe import Recipe, read_recipe, recipe_for

__all__ = ["Recipe", "generate", "read_recipe", "recipe_for"]
