"""B in a box and in iron: slices, isosurfaces, differences, field lines, elements. Lengths in mm."""

from collections.abc import Callable

import numpy as np
import pyvista as pv

from fieldmap.field import Bounds
from fieldmap.plot.device_drawing import FLUX, IRON, add_directions, add_planes
from fieldmap.plot.places import MM, box_grid, grid_points, plane_grids, plane_of
from fieldmap.plot.scales import add_coloured, colour_bar, colour_bar_by_decades
from fieldmap.plot.shown import Shown
from fieldmap.plot.solids import extent
from fieldmap.plot.style import INK
from fieldmap.plot.words import fitting_prefix
from fieldmap.typing import Array

POINTS = 25


# Quantity -> title of the colour bar with unit, and function that returns the values (n,) at points in that unit.
QUANTITIES: dict[str, tuple[str, Callable[[Shown, Array], Array]]] = {
    "B": (FLUX, lambda shown, points: MM * np.linalg.norm(shown.flux_density_at(points), axis=1)),
    "Bz": ("Bz, mT", lambda shown, points: MM * shown.flux_density_at(points)[:, 2]),
    "gradB": (
        "grad B, mT/m",
        lambda shown, points: MM * np.linalg.norm(shown.gradient_at(points), axis=(1, 2)),
    ),
}


def add_slices(scene: pv.Plotter, shown: Shown, quantity: str) -> None:
    """Slices through the middle of the box and on its floor, with a colour bar; for B with arrows of its direction."""
    planes, title = sampled(plane_grids(shown.box), shown, quantity)
    add_planes(scene, planes, title)
    if quantity == "B":
        add_directions(scene, shown.state, shown.box)


def add_difference(scene: pv.Plotter, shown: Shown, quantity: str) -> None:
    """Slices of the difference of two fields, in a unit with readable numbers."""
    planes, title = sampled(plane_grids(shown.box), shown, quantity)
    largest = max(float(np.abs(plane[title]).max()) for plane in planes)
    name, unit = title.split(", m", 1)
    prefix, factor = fitting_prefix(1e-3 * largest)
    of_difference = f"d {name}, {prefix}{unit}"
    for plane in planes:
        plane[of_difference] = 1e-3 * factor * plane[title]
    add_planes(scene, planes, of_difference)


def add_surfaces(scene: pv.Plotter, shown: Shown, quantity: str) -> None:
    """Isosurfaces at the labels of the colour bar and half-way between them."""
    (box,), title = sampled([box_grid(shown.box, (POINTS,) * 3)], shown, quantity)
    settings = colour_bar(title, box[title])
    count = 2 * settings["scalar_bar_args"]["n_labels"] - 1
    low, high = settings["clim"]
    levels = np.linspace(low, high, count)[1:-1]
    surfaces = box.contour(levels.tolist(), scalars=title)
    add_coloured(scene, surfaces, title, settings, opacity=0.55, smooth_shading=True, ambient=0.4)


def sampled(grids: list[pv.ImageData], shown: Shown, quantity: str) -> tuple[list[pv.ImageData], str]:
    """Grids with a quantity as point data, and its title, which is the name of these data."""
    title, values = QUANTITIES[quantity]
    for grid in grids:
        grid[title] = values(shown, grid_points(grid, shown.box))
    return grids, title


_GRID_POINTS, _SEEDS = 48, (5, 5)
_RANGE = 1e4
"""Largest ratio of the limits of the colours; the far ends of a few lines would otherwise take most of them."""


def add_field_lines(scene: pv.Plotter, shown: Shown, _: str) -> None:
    """Lines through the middle of the box, in it (a map) or around the whole device (a solution)."""
    lines = field_lines(shown)
    # In iron the flux density is a thousand times larger than in air.
    by_decades = colour_bar_by_decades if shown.everywhere else colour_bar
    low, high = np.percentile(lines[FLUX], [10.0, 98.0])
    settings = by_decades(FLUX, [max(low, high / _RANGE), high])
    tubes = lines.tube(radius=0.0015 * float(np.ptp(extent(lines), axis=1).max()), n_sides=8)
    add_coloured(scene, tubes, FLUX, settings, lighting=False)


def field_lines(shown: Shown) -> pv.PolyData:
    """Lines in mm with |B| in mT, in a field that is sampled on a grid and interpolated linearly."""
    box = _around(shown)
    size = box[1] - box[0]
    grid = box_grid(box, np.maximum(8, np.ceil(_GRID_POINTS * size / size.max())).astype(int))
    grid["flux density"] = MM * shown.flux_density_at(grid_points(grid, box))
    seeds, _ = plane_of(shown.box, "z", None, _SEEDS)
    lines = grid.streamlines_from_source(
        pv.PolyData(MM * seeds),
        vectors="flux density",
        integration_direction="both",
        max_length=4.0 * MM * float(size.max()),
        initial_step_length=0.3,
        terminal_speed=1e-9,
    )
    lines[FLUX] = np.linalg.norm(lines["flux density"], axis=1)
    return lines


def _around(shown: Shown) -> Bounds:
    """The box in which lines are followed, m."""
    lower, upper = shown.box
    if not shown.everywhere or shown.mesh is None:
        return lower, upper
    points = np.vstack([shown.mesh.points, lower, upper])
    lower, upper = points.min(axis=0), points.max(axis=0)
    air = 0.15 * (upper - lower)
    return lower - air, upper + air


IRON_FLUX = "B in iron, T"


def iron_elements(shown: Shown) -> pv.UnstructuredGrid:
    """Tetrahedra in mm, with |B| in T as cell data if there is a solution."""
    assert shown.mesh is not None
    grid = pv.UnstructuredGrid({pv.CellType.TETRA: shown.mesh.tets}, MM * shown.mesh.points)
    if shown.flux_density is not None:
        grid.cell_data[IRON_FLUX] = np.linalg.norm(shown.flux_density, axis=1)
    return grid


def add_mesh(scene: pv.Plotter, shown: Shown, _: str) -> None:
    """The faces of the elements at the surface, with their edges."""
    surface = iron_elements(shown).extract_surface(algorithm=None)
    scene.add_mesh(surface, color=IRON, show_edges=True, edge_color=INK, line_width=1, ambient=0.4)


def add_iron_field(scene: pv.Plotter, shown: Shown, _: str) -> None:
    """|B| of the elements at the surface, with a colour bar in T.

    The colours end at the 99.5th percentile: at sharp edges |B| grows without bound as the mesh is refined.
    """
    surface = iron_elements(shown).extract_surface(algorithm=None)
    settings = colour_bar(IRON_FLUX, np.minimum(surface[IRON_FLUX], np.percentile(surface[IRON_FLUX], 99.5)))
    add_coloured(scene, surface, IRON_FLUX, settings, lighting=False)
