"""The force on the payload's magnet in the box, and where it balances the weight. Lengths in mm."""

from typing import Any

import numpy as np
import pyvista as pv

from fieldmap.constants import GRAVITY
from fieldmap.device.model import Payload
from fieldmap.field import AnyField, Bounds
from fieldmap.levitation.balance import upright_force
from fieldmap.plot.device_drawing import add_payload, arrows_at
from fieldmap.plot.places import MM, plane_of
from fieldmap.plot.scales import add_coloured, colour_bar
from fieldmap.plot.shown import Shown
from fieldmap.plot.words import fitting_prefix
from fieldmap.typing import Array

_ALONG, _LAYERS = 7, 3
"""Places along x and z, and layers of constant y."""


def add_forces(scene: pv.Plotter, shown: Shown) -> None:
    """Arrows of the magnetic force on the payload's magnet, moment upwards, on a grid of its places."""
    assert shown.payload is not None
    places = places_in_box(shown.box)
    force = magnetic_force(shown.state, shown.currents, shown.payload, places)
    _add_arrows(scene, shown, places, force, "force")


def add_equilibrium(scene: pv.Plotter, shown: Shown) -> None:
    """The magnet where it is in balance, and around it magnetic force and weight together."""
    assert shown.payload is not None
    places = places_in_box(shown.box)
    force = net_force(shown.state, shown.currents, shown.payload, places)
    _add_arrows(scene, shown, places, force, "net force")
    add_payload(scene, shown.payload, MM * np.asarray(shown.equilibrium))


def places_in_box(box: Bounds) -> Array:
    """Points (n, 3), m, in layers of constant y."""
    low, high = box[0][1], box[1][1]
    layers = low + (np.arange(_LAYERS) + 0.5) / _LAYERS * (high - low)
    return np.vstack([plane_of(box, "y", float(y), (_ALONG, _ALONG))[0] for y in layers])


def magnetic_force(field: AnyField, currents: Any, payload: Payload, places: Array) -> Array:
    """Force (n, 3), N, on an upright payload: its pieces, or a dipole, upwards or downwards so that it is lifted."""
    force = upright_force(field, currents, payload, places)
    return force if payload.pieces or force[:, 2].sum() >= 0 else -force


def net_force(field: AnyField, currents: Any, payload: Payload, places: Array) -> Array:
    """Magnetic force and weight together (n, 3), N."""
    weight = np.array([0.0, 0.0, -payload.mass * GRAVITY])
    return magnetic_force(field, currents, payload, places) + weight


def _add_arrows(scene: pv.Plotter, shown: Shown, places: Array, force: Array, name: str) -> None:
    size = np.linalg.norm(force, axis=1)
    prefix, factor = fitting_prefix(float(size.max()))
    title = f"{name}, {prefix}N"
    # The longest arrow spans the distance of two places.
    room = MM * float(np.min((shown.box[1] - shown.box[0]) / [_ALONG, _LAYERS, _ALONG]))
    arrows = arrows_at(places, force, 1.3 * room)
    arrows[title] = factor * arrows["size"]
    add_coloured(scene, arrows, title, colour_bar(title, factor * size), ambient=0.4)
