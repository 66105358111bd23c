"""Scenes of a levitated payload: force in the box, equilibrium, rest positions over the signals, and reachable forces
at a point. Lengths in mm."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pyvista as pv

from fieldmap.constants import GRAVITY
from fieldmap.device.model import Payload
from fieldmap.errors import InputError
from fieldmap.field import AnyField, Bounds
from fieldmap.levitation import EquilibriumSurface, ReachableSet, SearchedSet
from fieldmap.levitation.balance import upright_force
from fieldmap.plot.device_drawing import MAGNET, add_payload, arrows_at
from fieldmap.plot.places import MM, plane_of
from fieldmap.plot.scales import add_coloured, add_labels, colour_bar
from fieldmap.plot.shown import Shown
from fieldmap.plot.solids import sharp_edges
from fieldmap.plot.style import COLOURS, INK
from fieldmap.plot.words import fitting_prefix
from fieldmap.typing import Array

_ALONG, _LAYERS = 7, 3
"""Numbers of points along x and z, and of layers of constant y."""


def add_forces(scene: pv.Plotter, shown: Shown, _: str) -> None:
    """Arrows of the magnetic force on the payload, at a fixed orientation, on a grid of positions."""
    _add_arrows(scene, shown, "force", upright_force)


def add_equilibrium(scene: pv.Plotter, shown: Shown, _: str) -> None:
    """The magnet in equilibrium, and the sum of magnetic force and weight around it."""
    assert shown.payload is not None
    _add_arrows(scene, shown, "net force", net_force)
    add_payload(scene, shown.payload, MM * np.asarray(shown.equilibrium))


def places_in_box(box: Bounds) -> Array:
    """Points (n, 3), m, in layers of constant y."""
    low, high = box[0][1], box[1][1]
    layers = low + (np.arange(_LAYERS) + 0.5) / _LAYERS * (high - low)
    return np.vstack([plane_of(box, "y", float(y), (_ALONG, _ALONG))[0] for y in layers])


def net_force(field: AnyField, currents: Any, payload: Payload, places: Array) -> Array:
    """Sum of magnetic force and weight (n, 3), N."""
    weight = np.array([0.0, 0.0, -payload.mass * GRAVITY])
    return upright_force(field, currents, payload, places) + weight


def _add_arrows(scene: pv.Plotter, shown: Shown, name: str, force_at: Callable[..., Array]) -> None:
    places = places_in_box(shown.box)
    force = force_at(shown.state, shown.currents, shown.payload, places)
    size = np.linalg.norm(force, axis=1)
    prefix, factor = fitting_prefix(float(size.max()))
    title = f"{name}, {prefix}N"
    # The longest arrow is about as long as the distance of two points.
    room = MM * float(np.min((shown.box[1] - shown.box[0]) / [_ALONG, _LAYERS, _ALONG]))
    arrows = arrows_at(places, force, 1.3 * room)
    arrows[title] = factor * arrows["size"]
    add_coloured(scene, arrows, title, colour_bar(title, factor * size), ambient=0.4)


LEVEL = "current, A"
PERCENT = 100.0
COORDINATES = {"x": 0, "y": 1}


def shift_titles(quantity: str) -> tuple[str, str, str]:
    """Titles of the three axes of the scene."""
    return "x signal, %", "y signal, %", f"{quantity}, mm"


def add_shift(scene: pv.Plotter, shown: Shown, quantity: str) -> None:
    """The surface of one coordinate, its grid of signals, and the mean current as colour."""
    assert shown.surface is not None
    surface = shift_surface(shown.surface, quantity)
    # A constant current needs no colour bar.
    level = surface[LEVEL]
    if np.ptp(level) > 1e-6 * np.abs(level).max():
        add_coloured(scene, surface, LEVEL, lighting=False)
    else:
        scene.add_mesh(surface, color="#9db7c9", lighting=False)
    scene.add_mesh(surface.extract_all_edges(), color=INK, line_width=1.5, lighting=False)


def shift_surface(surface: EquilibriumSurface, quantity: str) -> pv.PolyData:
    """Signals in % and a coordinate in mm as points, the mean current in A as point data; holes without equilibrium."""
    x, y = np.meshgrid(PERCENT * surface.x_signals, PERCENT * surface.y_signals, indexing="ij")
    height = MM * surface.positions[..., COORDINATES[quantity]]
    grid = pv.StructuredGrid(x, y, np.nan_to_num(height))
    grid[LEVEL] = np.nan_to_num(surface.levels).ravel(order="F")
    known = grid.extract_points(np.isfinite(height).ravel(order="F"), adjacent_cells=False)
    return known.extract_surface(algorithm=None)


KINDS = ("force", "B")
_SET = "#56B4E9"
# Arrows of coils; black would not be seen on a dark page, where the ink becomes light.
_ARROWS = tuple(INK if colour == "#000000" else colour for colour in COLOURS)
_STRETCHES = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0)


def reachable_axes(found: ReachableSet | SearchedSet) -> tuple[tuple[str, str, str], tuple[float, ...]]:
    """Titles of the three axes of the scene, and the factor by which each axis is stretched."""
    prefix, factor = _unit(found)
    name, unit = "F" if found.quantity == "force" else "B", f"{prefix}{found.unit}"
    stretch = tuple(round(float(one)) for one in factor / factor.min())
    return (f"{name}x, {unit}", f"{name}y, {unit}", f"{name}z, {unit}"), stretch


def add_reachable(scene: pv.Plotter, shown: Shown, _: str) -> None:
    """The set as a translucent solid, an arrow for each coil at its limit if the coils' forces add up, and the force
    that carries the payload."""
    found = shown.reachable
    assert found is not None
    if not len(found.triangles):
        remedy = "add a coil, or choose a point off the plane of symmetry"
        raise InputError.of(shown.title, "the set must have a volume", "a flat one", remedy)
    _, factor = _unit(found)
    solid = pv.PolyData.from_regular_faces(factor * found.vertices, found.triangles)  # type: ignore[arg-type]
    scene.add_mesh(solid, color=_SET, opacity=0.35, lighting=False)
    edges = sharp_edges(solid, 0.5 if found.exact else 8.0)
    scene.add_mesh(edges, color=INK, line_width=1.5, lighting=False)
    size = float(np.ptp(solid.points, axis=0).max())
    if isinstance(found, ReachableSet):
        _add_coils(scene, found, factor, size)
    if found.quantity == "force" and shown.payload is not None:
        weight = factor * [0.0, 0.0, shown.payload.mass * GRAVITY]
        scene.add_mesh(pv.Sphere(radius=0.014 * size, center=weight), color=MAGNET, ambient=0.4)
        add_labels(scene, [weight + [0.0, 0.0, 0.05 * size]], ["carries it"], 20)


def _unit(found: ReachableSet | SearchedSet) -> tuple[str, Array]:
    """Prefix, and factors (3,) from the plain unit. Thin sets are stretched by round numbers, which the titles of the
    axes state."""
    prefix, factor = fitting_prefix(float(np.abs(found.vertices).max()))
    extents = np.ptp(found.vertices, axis=0)
    room = extents.max() / np.maximum(extents, 1e-3 * extents.max())
    return prefix, factor * np.array([max(one for one in _STRETCHES if one <= share) for share in room])


def _add_coils(scene: pv.Plotter, found: ReachableSet, factor: Array, size: float) -> None:
    """Arrows from the value without currents to the value of each coil alone at its upper limit."""
    start = factor * found.constant
    for k, (name, vector) in enumerate(zip(found.coil_names, found.per_ampere, strict=True)):
        along = factor * (found.upper[k] or found.lower[k]) * vector
        length = float(np.linalg.norm(along))
        if length < 1e-6 * size:
            continue
        # All arrows have the same thickness.
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
