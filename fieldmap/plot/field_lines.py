"""Lines of the flux density, coloured by |B|. Lengths in mm."""

import numpy as np
import pyvista as pv

from fieldmap.plot.colours import colour_bar, colour_bar_by_decades
from fieldmap.plot.device_drawing import COLOUR_MAP, MM
from fieldmap.plot.shown import Shown
from fieldmap.typing import Array

TITLE = "B, mT"
_GRID_POINTS, _SEEDS = 48, 5
_RANGE = 1e4
"""Of the colours, at most: the far ends of a few lines would take most of them."""


def add_field_lines(scene: pv.Plotter, shown: Shown) -> None:
    """Lines through the middle of the box, in it (a map) or around the whole device (a solution)."""
    shown.need("field", "lower")
    lines = field_lines(shown)
    # From air to iron the flux density grows a thousandfold.
    by_decades = colour_bar_by_decades if shown.everywhere else colour_bar
    low, high = np.percentile(lines[TITLE], [10.0, 98.0])
    settings = by_decades(TITLE, [max(low, high / _RANGE), high])
    radius = 0.0015 * float(np.ptp(np.array(lines.bounds).reshape(3, 2), axis=1).max())
    scene.add_mesh(
        lines.tube(radius=radius, n_sides=8), scalars=TITLE, cmap=COLOUR_MAP, lighting=False, **settings
    )


def field_lines(shown: Shown) -> pv.PolyData:
    """Lines in mm with |B| in mT. The field is sampled on a grid, between whose points it is taken as linear."""
    lower, upper = _extent(shown)
    longest = float((upper - lower).max())
    counts = np.maximum(8, np.ceil(_GRID_POINTS * (upper - lower) / longest)).astype(int)
    grid = pv.ImageData(dimensions=counts, spacing=MM * (upper - lower) / (counts - 1), origin=MM * lower)
    points = np.clip(np.asarray(grid.points) / MM, lower, upper)
    grid["flux density"] = MM * shown.flux_density_at(points)
    lines = grid.streamlines_from_source(
        pv.PolyData(_seeds(shown)),
        vectors="flux density",
        integration_direction="both",
        max_length=4.0 * MM * longest,
        initial_step_length=0.3,
        terminal_speed=1e-9,
    )
    lines[TITLE] = np.linalg.norm(lines["flux density"], axis=1)
    return lines


def _extent(shown: Shown) -> tuple[Array, Array]:
    lower, upper = np.asarray(shown.lower, dtype=float), np.asarray(shown.upper, dtype=float)
    if shown.everywhere and shown.mesh is not None:
        points = np.vstack([shown.mesh.points, lower, upper])
        lower, upper = points.min(axis=0), points.max(axis=0)
        air = 0.15 * (upper - lower)
        return lower - air, upper + air
    inset = 1e-9 * (upper - lower)
    return lower + inset, upper - inset


def _seeds(shown: Shown) -> Array:
    """Points (n, 3) in mm on the middle plane of the box."""
    lower, upper = MM * np.asarray(shown.lower), MM * np.asarray(shown.upper)
    share = (np.arange(_SEEDS) + 0.5) / _SEEDS
    x, y = np.meshgrid(lower[0] + share * (upper[0] - lower[0]), lower[1] + share * (upper[1] - lower[1]))
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.5 * (lower[2] + upper[2]))])
