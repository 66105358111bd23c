"""The force on the payload's magnet in the box, and where it balances the weight. Lengths in mm."""

from typing import Any

import numpy as np
import pyvista as pv

from fieldmap.constants import GRAVITY
from fieldmap.device.model import Payload
from fieldmap.field import AnyField
from fieldmap.levitation.balance import upright_force
from fieldmap.plot.colours import colour_bar, fitting_prefix
from fieldmap.plot.device_drawing import COLOUR_MAP, MM, add_payload
from fieldmap.plot.shown import Shown
from fieldmap.typing import Array

TITLE, NET = "force", "net force"
_PLACES = (7, 3, 7)


def add_forces(scene: pv.Plotter, shown: Shown) -> None:
    """Arrows of the magnetic force on the payload's magnet, moment upwards, on a grid of its places."""
    shown.need("field", "lower", "payload")
    assert shown.payload is not None
    places = places_in_box(shown)
    _add_arrows(
        scene, places, magnetic_force(shown.state, shown.currents, shown.payload, places), TITLE, shown
    )


def add_equilibrium(scene: pv.Plotter, shown: Shown) -> None:
    """The magnet where it is in balance, and around it magnetic force and weight together."""
    shown.need("field", "lower", "payload", "equilibrium")
    assert shown.payload is not None
    places = places_in_box(shown)
    _add_arrows(scene, places, net_force(shown.state, shown.currents, shown.payload, places), NET, shown)
    add_payload(scene, shown.payload, MM * np.asarray(shown.equilibrium))


def places_in_box(shown: Shown) -> Array:
    """Points (n, 3), m, in layers of constant y."""
    lower, upper = np.asarray(shown.lower, dtype=float), np.asarray(shown.upper, dtype=float)
    axes = [
        low + (np.arange(n) + 0.5) / n * (high - low)
        for low, high, n in zip(lower, upper, _PLACES, strict=True)
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def magnetic_force(field: AnyField, currents: Any, payload: Payload, places: Array) -> Array:
    """Force (n, 3), N, on an upright payload: its pieces, or a dipole, upwards or downwards so that it is lifted."""
    force = upright_force(field, currents, payload, places)
    return force if payload.pieces or force[:, 2].sum() >= 0 else -force


def net_force(field: AnyField, currents: Any, payload: Payload, places: Array) -> Array:
    """Magnetic force and weight together (n, 3), N."""
    weight = np.array([0.0, 0.0, -payload.mass * GRAVITY])
    return magnetic_force(field, currents, payload, places) + weight


def _add_arrows(scene: pv.Plotter, places: Array, force: Array, title: str, shown: Shown) -> None:
    size = np.linalg.norm(force, axis=1)
    prefix, factor = fitting_prefix(float(size.max()))
    title = f"{title}, {prefix}N"
    cloud = pv.PolyData(MM * places)
    cloud["direction"] = force
    cloud[title] = factor * size
    # The longest arrow spans the distance of two places.
    size_of_box = np.asarray(shown.upper, dtype=float) - np.asarray(shown.lower, dtype=float)
    room = MM * float(np.min(size_of_box / np.array(_PLACES)))
    arrows = cloud.glyph(
        orient="direction", scale=title, factor=1.3 * room / (factor * size.max()), geom=pv.Arrow()
    )
    scene.add_mesh(arrows, scalars=title, cmap=COLOUR_MAP, ambient=0.4, **colour_bar(title, factor * size))
