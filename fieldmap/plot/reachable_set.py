"""What the coils can make at a point, as a solid: along the axes stand the components of force or flux density."""

import numpy as np
import pyvista as pv

from fieldmap.constants import GRAVITY
from fieldmap.errors import InputError, Problem
from fieldmap.levitation import ReachableSet, SearchedSet
from fieldmap.plot.device_drawing import MAGNET
from fieldmap.plot.scales import add_labels
from fieldmap.plot.shown import Shown
from fieldmap.plot.solids import sharp_edges
from fieldmap.plot.style import COLOURS, INK
from fieldmap.plot.words import fitting_prefix
from fieldmap.typing import Array

KINDS = ("force", "B")
# Arrows of coils; black would not be seen on a dark page, where the ink becomes light.
_ARROWS = tuple(INK if colour == "#000000" else colour for colour in COLOURS)
_STRETCHES = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)


def reachable_titles(found: ReachableSet | SearchedSet) -> tuple[str, str, str]:
    """Of the three axes of the scene."""
    prefix, factor = _unit(found)
    times = ["" if one < 1.5 else f"{one:.0f} " for one in factor / factor.min()]
    name, unit = "F" if found.quantity == "force" else "B", f"{prefix}{found.unit}"
    return f"{times[0]}{name}x, {unit}", f"{times[1]}{name}y, {unit}", f"{times[2]}{name}z, {unit}"


def add_reachable(scene: pv.Plotter, shown: Shown) -> None:
    """The set as a translucent solid, an arrow for each coil at its limit where these add up, and the force that
    carries the payload."""
    found = shown.reachable
    assert found is not None
    if not len(found.triangles):
        remedy = "add a coil, or choose a point off the plane of symmetry"
        raise InputError(Problem(shown.title, "the set must have a volume", "a flat one", remedy))
    solid = reachable_solid(found)
    scene.add_mesh(solid, color=COLOURS[4], opacity=0.35, lighting=False)
    edges = sharp_edges(solid, 0.5 if found.exact else 8.0)
    scene.add_mesh(edges, color=INK, line_width=1.5, lighting=False)
    size = float(np.ptp(solid.points, axis=0).max())
    if isinstance(found, ReachableSet):
        _add_coils(scene, found, size)
    if found.quantity == "force" and shown.payload is not None:
        _, factor = _unit(found)
        weight = factor * [0.0, 0.0, shown.payload.mass * GRAVITY]
        scene.add_mesh(pv.Sphere(radius=0.014 * size, center=weight), color=MAGNET, ambient=0.4)
        add_labels(scene, [weight + [0.0, 0.0, 0.05 * size]], ["carries it"], 20)


def reachable_solid(found: ReachableSet | SearchedSet) -> pv.PolyData:
    """The surface, in the unit of the scene."""
    _, factor = _unit(found)
    return pv.PolyData.from_regular_faces(factor * found.vertices, found.triangles)  # type: ignore[arg-type]


def _unit(found: ReachableSet | SearchedSet) -> tuple[str, Array]:
    """Prefix, and the factors (3,) from the plain unit: thin sets are drawn wider, by round numbers, which the titles
    of the axes tell."""
    prefix, factor = fitting_prefix(float(np.abs(found.vertices).max()))
    extents = np.ptp(found.vertices, axis=0)
    room = extents.max() / np.maximum(extents, 1e-3 * extents.max())
    return prefix, factor * np.array([max(one for one in _STRETCHES if one <= share) for share in room])


def _add_coils(scene: pv.Plotter, found: ReachableSet, size: float) -> None:
    """From what no current makes to what each coil makes at its upper limit, alone."""
    _, factor = _unit(found)
    start = factor * found.constant
    for k, (name, vector) in enumerate(zip(found.coil_names, found.per_ampere, strict=True)):
        along = factor * (found.upper[k] or found.lower[k]) * vector
        length = float(np.linalg.norm(along))
        if length < 1e-6 * size:
            continue
        # One thickness for all, whatever their length.
        arrow = pv.Arrow(
            start=start,
            direction=along,
            scale=length,
            tip_length=min(0.04 * size / length, 0.5),
            tip_radius=0.014 * size / length,
            shaft_radius=0.005 * size / length,
        )
        scene.add_mesh(arrow, color=_ARROWS[k % len(_ARROWS)], ambient=0.5)
        add_labels(scene, [start + 1.12 * along], [name], 20)
