"""The equilibrium area: the area around an equilibrium in which the horizontal force is negligible.

Below a wide pole piece there is an area, not a point, in which only drag stops a magnet. Here it is the part of the
horizontal plane through the equilibrium in which the horizontal force stays below a share f of the weight, as far as
straight lines from the equilibrium stay inside. If the force is proportional to the displacement, with stiffnesses k_x
and k_y along the axes, it is an ellipse,

    A = pi (f m g)^2 / (k_x k_y)                                                          docs/studies.md (1)
"""

import numpy as np

from fieldmap.device.model import Payload
from fieldmap.errors import FieldmapError
from fieldmap.field import Field, require_bounds
from fieldmap.levitation import GRAVITY, Equilibrium
from fieldmap.typing import Array

DIRECTIONS = 64
STEPS = 12
BISECTIONS = 14
# Largest radius of the steps, over the radius at which a proportional force reaches the limit.
FARTHER = 3.0


def equilibrium_area(field: Field, found: Equilibrium, payload: Payload, share: float) -> float:
    """Area in which the horizontal force stays below a share of the weight.

    The area is pi times the mean of r^2 over 64 directions, with r the first crossing of the limit. For a smooth
    outline its error falls faster than any power of the number of directions.

    Parameters
    ----------
    field
        Any field with a box.
    found
        The equilibrium.
    payload
        The levitated body.
    share
        Share of the weight.

    Returns
    -------
    float
        Area, m^2.

    Raises
    ------
    FieldmapError
        If the equilibrium is not stable in the plane, or the workspace ends first.
    """
    radii, _ = area_outline(field, found, payload, share)
    return float(np.pi * np.mean(radii**2))


def area_outline(field: Field, found: Equilibrium, payload: Payload, share: float) -> tuple[Array, Array]:
    """Radii (64,), m, at which the horizontal force first reaches the limit, and their directions (64, 2)."""
    plane = 0.5 * (found.stiffness + found.stiffness.T)[:2, :2]
    if np.linalg.eigvalsh(plane)[0] <= 0.0:
        stiffness = ", ".join(f"{value:.3g}" for value in np.linalg.eigvalsh(plane))
        must_hold = "the equilibrium must be stable in the horizontal plane"
        remedy = "choose a place farther from the iron, or other currents"
        raise FieldmapError.of("equilibrium_area", must_hold, f"stiffnesses {stiffness} N/m", remedy)
    limit = share * payload.mass * GRAVITY
    angle = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    rays = np.column_stack([np.cos(angle), np.sin(angle)])
    edge = _distance_to_edge(field, found.position[:2], rays)
    expected = limit / np.linalg.norm(rays @ plane, axis=1)
    radii = np.linspace(0.0, 1.0, STEPS + 1)[1:] * np.minimum(edge, FARTHER * expected)[:, None]

    def excess(lengths: Array) -> Array:
        """Horizontal force minus the limit at lengths (64, k), N."""
        points = np.empty((*lengths.shape, 3))
        points[..., :2] = found.position[:2] + lengths[..., None] * rays[:, None]
        points[..., 2] = found.position[2]
        force = field.wrench(points.reshape(-1, 3), found.moment, found.currents)
        return np.linalg.norm(force[:, :2], axis=1).reshape(lengths.shape) - limit

    beyond = excess(radii) > 0.0
    if not beyond.any(axis=1).all():
        must_hold = (
            f"the horizontal force must reach {share:g} of the weight inside the workspace, on every side"
        )
        received = "the workspace, or three times the distance predicted by the stiffness, ends before"
        remedy = "make the workspace wider, or record.force_share smaller"
        raise FieldmapError.of("equilibrium_area", must_hold, received, remedy)
    first = beyond.argmax(axis=1)
    rows = np.arange(DIRECTIONS)
    high = radii[rows, first]
    low = np.where(first > 0, radii[rows, first - 1], 0.0)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        out = excess(middle[:, None])[:, 0] > 0.0
        low, high = np.where(out, low, middle), np.where(out, middle, high)
    return 0.5 * (low + high), rays


def _distance_to_edge(field: Field, start: Array, rays: Array) -> Array:
    """Distances from a point in the plane to the edge of the box along the rays."""
    lower, upper = require_bounds(field)
    with np.errstate(divide="ignore"):
        to_lower = (lower[:2] - start) / rays
        to_upper = (upper[:2] - start) / rays
    return np.where(rays > 0.0, to_upper, np.where(rays < 0.0, to_lower, np.inf)).min(axis=1)
