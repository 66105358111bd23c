"""The iron of a solution: its mesh, and |B| in every element. Lengths in mm."""

import numpy as np
import pyvista as pv

from fieldmap.plot.colours import colour_bar
from fieldmap.plot.device_drawing import COLOUR_MAP, IRON
from fieldmap.plot.places import MM
from fieldmap.plot.shown import Shown
from fieldmap.plot.solids import tetrahedra
from fieldmap.plot.style import INK

TITLE = "B in iron, T"


def iron_elements(shown: Shown) -> pv.UnstructuredGrid:
    """Tetrahedra in mm with |B| in T as cell data, if the solution is there."""
    assert shown.mesh is not None
    grid = tetrahedra(shown.mesh.tets, MM * shown.mesh.points)
    if shown.flux_density is not None:
        grid.cell_data[TITLE] = np.linalg.norm(shown.flux_density, axis=1)
    return grid


def add_mesh(scene: pv.Plotter, shown: Shown) -> None:
    """The faces of the elements at the surface, with their edges."""
    surface = iron_elements(shown).extract_surface(algorithm=None)
    scene.add_mesh(surface, color=IRON, show_edges=True, edge_color=INK, line_width=1, ambient=0.4)


def add_iron_field(scene: pv.Plotter, shown: Shown) -> None:
    """|B| of the elements at the surface, with a colour bar in T.

    The colours end at the 99.5th percentile: at sharp edges |B| grows without bound as the mesh is refined.
    """
    surface = iron_elements(shown).extract_surface(algorithm=None)
    settings = colour_bar(TITLE, np.minimum(surface[TITLE], np.percentile(surface[TITLE], 99.5)))
    scene.add_mesh(surface, scalars=TITLE, cmap=COLOUR_MAP, lighting=False, **settings)
