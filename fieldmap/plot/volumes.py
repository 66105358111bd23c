"""|B|, B_z and |grad B| in a box: slices and surfaces of equal value. Lengths in mm."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pyvista as pv

from fieldmap.plot.colours import colour_bar, fitting_prefix
from fieldmap.plot.device_drawing import COLOUR_MAP, MM, add_directions
from fieldmap.plot.shown import Shown
from fieldmap.records import Record
from fieldmap.typing import Array

POINTS, SLICE_POINTS = 25, 61


@dataclass(frozen=True, repr=False)
class Quantity(Record):
    """What is drawn. title: for the colour bar, with its unit; values(shown, points): (n,) in that unit."""

    title: str
    values: Callable[[Shown, Array], Array]


def _strength(shown: Shown, points: Array) -> Array:
    return 1e3 * np.linalg.norm(shown.flux_density_at(points), axis=1)


def _vertical(shown: Shown, points: Array) -> Array:
    return 1e3 * shown.flux_density_at(points)[:, 2]


def _gradient(shown: Shown, points: Array) -> Array:
    return 1e3 * np.linalg.norm(shown.gradient_at(points), axis=(1, 2))


# Not |B|: the text renderer takes | for a column break.
QUANTITIES = {
    "B": Quantity("B, mT", _strength),
    "Bz": Quantity("Bz, mT", _vertical),
    "gradB": Quantity("grad B, mT/m", _gradient),
}


def add_slices(scene: pv.Plotter, shown: Shown, quantity: str = "B") -> None:
    """Slices through the middle of the box and its floor, with a colour bar; on those of B, arrows along it."""
    shown.need("field", "lower")
    chosen = QUANTITIES[quantity]
    _draw_planes(scene, _planes(shown, chosen), chosen.title)
    if quantity == "B":
        add_directions(scene, shown.state, *_inside(shown))


def add_difference(scene: pv.Plotter, shown: Shown, quantity: str = "B") -> None:
    """Slices of a field that is the difference of two, in the unit that gives readable numbers."""
    shown.need("field", "lower")
    chosen = QUANTITIES[quantity]
    planes = _planes(shown, chosen)
    largest = max(float(np.abs(plane[chosen.title]).max()) for plane in planes)
    name, unit = chosen.title.split(", m", 1)
    prefix, factor = fitting_prefix(1e-3 * largest)
    title, factor = f"d {name}, {prefix}{unit}", 1e-3 * factor
    for plane in planes:
        plane[title] = factor * plane[chosen.title]
    _draw_planes(scene, planes, title)


def add_surfaces(scene: pv.Plotter, shown: Shown, quantity: str = "B") -> None:
    """Surfaces of equal value at the labels of the colour bar and half-way between them."""
    shown.need("field", "lower")
    chosen = QUANTITIES[quantity]
    box = sampled_box(shown, chosen, POINTS)
    settings = colour_bar(chosen.title, box[chosen.title])
    low, high = settings["clim"]
    count = 2 * settings["scalar_bar_args"]["n_labels"] - 1
    levels = np.linspace(low, high, count)[1:-1]
    surfaces = box.contour(levels.tolist(), scalars=chosen.title)
    scene.add_mesh(
        surfaces,
        scalars=chosen.title,
        cmap=COLOUR_MAP,
        opacity=0.55,
        smooth_shading=True,
        ambient=0.4,
        **settings,
    )


def sampled_box(shown: Shown, quantity: Quantity, points: int) -> pv.ImageData:
    """The box as a grid of points^3, mm, with the quantity as point data under its title."""
    lower, upper = _inside(shown)
    grid = pv.ImageData(
        dimensions=(points,) * 3, spacing=MM * (upper - lower) / (points - 1), origin=MM * lower
    )
    grid[quantity.title] = quantity.values(shown, np.clip(np.asarray(grid.points) / MM, lower, upper))
    return grid


def _draw_planes(scene: pv.Plotter, planes: list[pv.ImageData], title: str) -> None:
    settings = colour_bar(title, np.concatenate([plane[title] for plane in planes]))
    for plane in planes:
        scene.add_mesh(
            plane,
            scalars=title,
            cmap=COLOUR_MAP,
            lighting=False,
            show_scalar_bar=plane is planes[0],
            **settings,
        )


def _planes(shown: Shown, quantity: Quantity) -> list[pv.ImageData]:
    lower, upper = _inside(shown)
    planes = planes_of_box(lower, upper)
    for plane in planes:
        points = np.clip(np.asarray(plane.points) / MM, lower, upper)
        plane[quantity.title] = quantity.values(shown, points)
    return planes


def planes_of_box(lower: Array, upper: Array) -> list[pv.ImageData]:
    """Grids in mm on the planes x = middle, y = middle and z = floor of a box with corners (3,) in m."""
    middle = 0.5 * (lower + upper)
    planes = []
    for axis, at in ((0, middle[0]), (1, middle[1]), (2, lower[2])):
        counts = [SLICE_POINTS] * 3
        counts[axis] = 1
        spacing = MM * (upper - lower) / (SLICE_POINTS - 1)
        origin = MM * np.where(np.arange(3) == axis, at, lower)
        planes.append(pv.ImageData(dimensions=counts, spacing=spacing, origin=origin))
    return planes


def _inside(shown: Shown) -> tuple[Array, Array]:
    """Corners a hair inside the box, so that rounding leaves no point outside."""
    lower, upper = np.asarray(shown.lower, dtype=float), np.asarray(shown.upper, dtype=float)
    return lower + 1e-9 * (upper - lower), upper - 1e-9 * (upper - lower)
