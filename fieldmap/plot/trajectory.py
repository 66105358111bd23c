"""A recorded run: the path of the levitated body, and the body itself where it was. Lengths in mm."""

from typing import Any

import numpy as np
import pyvista as pv

from fieldmap.device.placement import AXES
from fieldmap.plot.colours import colour_bar
from fieldmap.plot.device_drawing import COLOUR_MAP, MAGNET
from fieldmap.plot.places import MM
from fieldmap.plot.shown import Shown, ShownRun
from fieldmap.plot.solids import payload_surface, sharp_edges, upright_cylinder
from fieldmap.plot.style import INK
from fieldmap.typing import Index

TIME = "time, s"
_POINTS = 2000
"""Of the path that is drawn."""


def body_parts(run: ShownRun) -> list[tuple[pv.PolyData, dict[str, Any]]]:
    """What the body looks like, about the origin, upright, mm, and how it is drawn."""
    parts: list[tuple[pv.PolyData, dict[str, Any]]] = []
    payload = run.device.payload
    surface = None if payload is None else payload_surface(payload)
    if surface is not None:
        parts.append(
            (surface, {"color": MAGNET, "ambient": 0.3, "smooth_shading": True, "split_sharp_edges": True})
        )
    if run.body is not None:
        look = {"color": "#8fa3b5", "opacity": 0.3 if parts else 1.0, "ambient": 0.4}
        parts.append((upright_cylinder(*run.body), look))
    return parts or [(pv.Sphere(radius=1.0), {"color": MAGNET})]


def path_samples(run: ShownRun) -> Index:
    """Samples of which the drawn path consists."""
    return np.unique(np.linspace(0, len(run.time) - 1, min(_POINTS, len(run.time))).astype(np.int64))


def add_path(scene: pv.Plotter, shown: Shown) -> None:
    """The path, coloured by time, the path that was asked for, and the magnet at the end as an outline."""
    run = shown.run
    assert run is not None
    samples = path_samples(run)
    path = pv.lines_from_points(MM * run.position[samples])
    path[TIME] = run.time[samples]
    look: dict[str, Any] = colour_bar(TIME, run.time[samples]) | {
        "line_width": 5,
        "render_lines_as_tubes": True,
    }
    scene.add_mesh(path, scalars=TIME, cmap=COLOUR_MAP, lighting=False, **look)
    scene.add_mesh(pv.lines_from_points(MM * run.wanted[samples]), color=INK, line_width=2, lighting=False)
    magnet = outline(body_parts(run)[0][0]).transform(run.pose(-1), inplace=False)
    scene.add_mesh(magnet, color=MAGNET, line_width=2, lighting=False)


def outline(surface: pv.PolyData) -> pv.PolyData:
    """Its edges: what stands in the way of nothing. Of a sphere three circles."""
    edges = sharp_edges(surface)
    if edges.n_points:
        return edges
    return pv.merge([surface.slice(normal=normal, origin=surface.center) for normal in AXES])
