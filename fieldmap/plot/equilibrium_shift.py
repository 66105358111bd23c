"""Where the magnet rests over both direction signals, as a surface: signals in %, places in mm, colour the current."""

import numpy as np
import pyvista as pv

from fieldmap.levitation import EquilibriumSurface
from fieldmap.plot.places import MM
from fieldmap.plot.scales import add_coloured
from fieldmap.plot.shown import Shown
from fieldmap.plot.style import INK

LEVEL = "current, A"
PERCENT = 100.0
COORDINATES = {"x": 0, "y": 1}


def shift_titles(quantity: str) -> tuple[str, str, str]:
    """Of the three axes of the scene."""
    return "x signal, %", "y signal, %", f"{quantity}, mm"


def add_shift(scene: pv.Plotter, shown: Shown, quantity: str) -> None:
    """The surface of one coordinate, its grid of signals, and the mean current as colour."""
    assert shown.surface is not None
    surface = shift_surface(shown.surface, quantity)
    # One current everywhere needs no scale of colours.
    level = surface[LEVEL]
    if np.ptp(level) > 1e-6 * np.abs(level).max():
        add_coloured(scene, surface, LEVEL, lighting=False)
    else:
        scene.add_mesh(surface, color="#9db7c9", lighting=False)
    scene.add_mesh(surface.extract_all_edges(), color=INK, line_width=1.5, lighting=False)


def shift_surface(surface: EquilibriumSurface, quantity: str) -> pv.PolyData:
    """Signals in % and a coordinate in mm as points, the mean current in A as point data; holes where there is none."""
    x, y = np.meshgrid(PERCENT * surface.x_signals, PERCENT * surface.y_signals, indexing="ij")
    height = MM * surface.positions[..., COORDINATES[quantity]]
    index = np.arange(x.size).reshape(x.shape)
    corners = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1)
    corners = corners.reshape(-1, 4)
    known = np.isfinite(height.ravel())
    corners = corners[known[corners].all(axis=1)]
    points = np.column_stack([x.ravel(), y.ravel(), np.nan_to_num(height.ravel())])
    mesh = pv.PolyData.from_regular_faces(points, corners)  # type: ignore[arg-type]
    mesh[LEVEL] = np.nan_to_num(surface.levels.ravel())
    return mesh.clean()
