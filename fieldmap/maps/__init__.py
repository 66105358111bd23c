"""Recipes, and the maps made from them.

Depends on: errors, kernels, device, store, iron, pydantic.
"""

from fieldmap.extras import needs

# As in fieldmap.iron: scipy is checked here for all modules of the package.
with needs("make", "fieldmap.maps"):
    import scipy

    del scipy

from fieldmap.maps.generation import generate
from fieldmap.maps.recipe import Recipe, read_recipe, recipe_for

__all__ = ["Recipe", "generate", "read_recipe", "recipe_for"]
