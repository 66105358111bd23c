"""|B|, B_z and |grad B| in a box: slices and surfaces of equal value. Lengths in mm."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pyvista as pv

from fieldmap.plot.colours import colour_bar
from fieldmap.plot.device_drawing import COLOUR_MAP, FLUX, add_directions, add_planes
from fieldmap.plot.places import MM, box_grid, grid_points, plane_grids
from fieldmap.plot.shown import Shown
from fieldmap.plot.words import fitting_prefix
from fieldmap.records import Record
from fieldmap.typing import Array

POINTS = 25


@dataclass(frozen=True, repr=False)
class Quantity(Record):
    """What is drawn. title: for the colour bar, with its unit; values(shown, points): (n,) in that unit."""

    title: str
    values: Callable[[Shown, Array], Array]


QUANTITIES = {
    "B": Quantity(FLUX, lambda shown, points: MM * np.linalg.norm(shown.flux_density_at(points), axis=1)),
    "Bz": Quantity("Bz, mT", lambda shown, points: MM * shown.flux_density_at(points)[:, 2]),
    "gradB": Quantity(
        "grad B, mT/m", lambda shown, points: MM * np.linalg.norm(shown.gradient_at(points), axis=(1, 2))
    ),
}


def add_slices(scene: pv.Plotter, shown: Shown, quantity: str = "B") -> None:
    """Slices through the middle of the box and its floor, with a colour bar; on those of B, arrows along it."""
    add_planes(scene, _planes(shown, QUANTITIES[quantity]), QUANTITIES[quantity].title)
    if quantity == "B":
        add_directions(scene, shown.state, shown.box)


def add_difference(scene: pv.Plotter, shown: Shown, quantity: str = "B") -> None:
    """Slices of a field that is the difference of two, in the unit that gives readable numbers."""
    chosen = QUANTITIES[quantity]
    planes = _planes(shown, chosen)
    largest = max(float(np.abs(plane[chosen.title]).max()) for plane in planes)
    name, unit = chosen.title.split(", m", 1)
    prefix, factor = fitting_prefix(1e-3 * largest)
    title = f"d {name}, {prefix}{unit}"
    for plane in planes:
        plane[title] = 1e-3 * factor * plane[chosen.title]
    add_planes(scene, planes, title)


def add_surfaces(scene: pv.Plotter, shown: Shown, quantity: str = "B") -> None:
    """Surfaces of equal value at the labels of the colour bar and half-way between them."""
    title = QUANTITIES[quantity].title
    box = sampled_box(shown, QUANTITIES[quantity], POINTS)
    settings = colour_bar(title, box[title])
    count = 2 * settings["scalar_bar_args"]["n_labels"] - 1
    low, high = settings["clim"]
    levels = np.linspace(low, high, count)[1:-1]
    scene.add_mesh(
        box.contour(levels.tolist(), scalars=title),
        scalars=title,
        cmap=COLOUR_MAP,
        opacity=0.55,
        smooth_shading=True,
        ambient=0.4,
        **settings,
    )


def sampled_box(shown: Shown, quantity: Quantity, points: int) -> pv.ImageData:
    """The box as a grid of points^3, mm, with the quantity as point data under its title."""
    grid = box_grid(shown.box, (points,) * 3)
    grid[quantity.title] = quantity.values(shown, grid_points(grid, shown.box))
    return grid


def _planes(shown: Shown, quantity: Quantity) -> list[pv.ImageData]:
    planes = plane_grids(shown.box)
    for plane in planes:
        plane[quantity.title] = quantity.values(shown, grid_points(plane, shown.box))
    return planes
