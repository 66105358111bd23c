"""Lines of the flux density, coloured by |B|. Lengths in mm."""

import numpy as np
import pyvista as pv

from fieldmap.field import Bounds
from fieldmap.plot.colours import colour_bar, colour_bar_by_decades
from fieldmap.plot.device_drawing import COLOUR_MAP, FLUX
from fieldmap.plot.places import MM, box_grid, grid_points, plane_of
from fieldmap.plot.shown import Shown
from fieldmap.plot.solids import extent

_GRID_POINTS, _SEEDS = 48, (5, 5)
_RANGE = 1e4
"""Of the colours, at most: the far ends of a few lines would take most of them."""


def add_field_lines(scene: pv.Plotter, shown: Shown) -> None:
    """Lines through the middle of the box, in it (a map) or around the whole device (a solution)."""
    lines = field_lines(shown)
    # From air to iron the flux density grows a thousandfold.
    by_decades = colour_bar_by_decades if shown.everywhere else colour_bar
    low, high = np.percentile(lines[FLUX], [10.0, 98.0])
    settings = by_decades(FLUX, [max(low, high / _RANGE), high])
    tubes = lines.tube(radius=0.0015 * float(np.ptp(extent(lines), axis=1).max()), n_sides=8)
    scene.add_mesh(tubes, scalars=FLUX, cmap=COLOUR_MAP, lighting=False, **settings)


def field_lines(shown: Shown) -> pv.PolyData:
    """Lines in mm with |B| in mT. The field is sampled on a grid, between whose points it is taken as linear."""
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
