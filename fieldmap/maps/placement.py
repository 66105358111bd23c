"""The box and the grid of a map."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fieldmap.device.model import Device, WorkspaceBox
from fieldmap.maps.recipe import MILLI, Array, Recipe
from fieldmap.store import Grid

FEWEST_NODES = 5
"""Per axis: the differences that the interpolant needs span five nodes."""
MOST_NODES = 2_000_000
"""A map of six coils then takes about 2 GB."""


def choose_grid(recipe: Recipe, device: Device) -> Grid:
    """Nodes that fill the recipe's box, or the box around the device's workspace, from face to face.

    The spacing is the recipe's or a little less, so that it divides the box. Raises RecipeError if there is
    no box, or too few or too many nodes.
    """
    lower, upper = _corners(recipe, device)
    extent = upper - lower
    # A part in 1e9 is rounding: a box of 40 mm takes 10 cells of 4 mm, not 11.
    cells = np.maximum(np.ceil(extent / recipe.spacing * (1 - 1e-9)), 1).astype(np.int64)
    size = f"a box of {_millimetres(extent)} mm and a spacing of {_millimetres(recipe.spacing)} mm"
    if int(cells.min()) + 1 < FEWEST_NODES:
        remedy = f"divide the box into at least {FEWEST_NODES - 1} cells: a smaller spacing or a larger box"
        must_hold = f"at least {FEWEST_NODES} nodes along each axis"
        raise recipe.error("spacing_mm", must_hold, f"{size}, which gives {_by(cells + 1)} nodes", remedy)
    if np.prod((cells + 1).astype(np.float64)) > MOST_NODES:
        must_hold = f"at most {MOST_NODES} nodes"
        remedy = "take a larger spacing or a smaller box; lengths are in mm"
        raise recipe.error("spacing_mm", must_hold, f"{size}, which gives {_by(cells + 1)} nodes", remedy)
    nx, ny, nz = (int(n) + 1 for n in cells)
    return Grid(lower, extent / cells, (nx, ny, nz))


def with_box(device: Device, grid: Grid) -> Device:
    """The same device with the map's box as its workspace, so that geometry checks hold them together."""
    return replace(device, workspace=WorkspaceBox(grid.lower, grid.upper))


def _corners(recipe: Recipe, device: Device) -> tuple[Array, Array]:
    if recipe.lower is not None and recipe.upper is not None:
        return recipe.lower, recipe.upper
    if device.bounds is not None:
        return device.bounds
    must_hold = "a box, since the device has no workspace"
    raise recipe.error("box", must_hold, "nothing", "add [box] with lower_mm and upper_mm, each [x, y, z]")


def _millimetres(lengths: Array) -> str:
    return " x ".join(f"{length / MILLI:g}" for length in lengths)


def _by(numbers: NDArray[np.int64]) -> str:
    return " x ".join(str(int(n)) for n in numbers)
