"""Force and torque on magnets that are too large to be a point: a volume rule over the magnet.

    F = integral (grad B)^T M dV      T = integral M x B + r x (grad B)^T M dV          docs/theory/wrench.md (1), (2)

about the magnet's centre. A uniformly magnetised sphere is a point dipole exactly, since means of harmonic functions
over balls are their values at the centre; cylinders and blocks take products of Gauss rules, as fine as the field asks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fieldmap.constants import MU0
from fieldmap.errors import InputError, NotConverged
from fieldmap.field import AnyField, StateField, as_field, require_bounds
from fieldmap.lookup.magnetic_body import MagneticBody
from fieldmap.typing import Array

if TYPE_CHECKING:
    from fieldmap.device.payload import Magnet, MagnetBlock, MagnetCylinder

FINEST = 8
_PLACES = 40


@dataclass(frozen=True, eq=False, repr=False)
class FiniteMagnet(MagneticBody):
    """A rigid magnet as dipoles: points (q, 3), m, and moments (q, 3), A m^2, in its own frame, magnetised along its
    z."""


def finite_magnet(shape: Magnet, field: AnyField, tolerance: float = 1e-6) -> FiniteMagnet:
    """The coarsest rule that holds a magnet in a field to a tolerance.

    Each rule, exact for fields of degree 1, 3, 5, ..., is set against the next at random places and
    orientations all over the part of the box where the magnet fits, one coil at a time (or a state at its
    currents), until they agree. The size of the magnet is judged against the scale of the field by the field
    itself. The result states the difference.

    Parameters
    ----------
    shape
        The magnet.
    field
        Any field with a box: see `fieldmap.field.as_field`.
    tolerance
        Largest difference of two rules, as a share of the largest force and torque found.

    Returns
    -------
    FiniteMagnet
        The rule, and how far it is off.

    Raises
    ------
    InputError
        If the magnet does not fit into the box.
    NotConverged
        If the finest rule (8) is not enough.
    """
    # Here, as in `volume_rule`: maps are opened faster without the package of devices.
    from fieldmap.device.payload import MagnetSphere

    rules = (volume_rule(shape, level) for level in range(1, FINEST + 1))
    magnet = next(rules)
    if isinstance(shape, MagnetSphere):
        return FiniteMagnet(magnet.points, magnet.moments, 0.0)
    ask = _trial(shape, field)
    here, error = ask(magnet), np.inf
    for finer in rules:
        there = ask(finer)
        scale = [np.linalg.norm(part, axis=1).max() or 1.0 for part in (there[:, :3], there[:, 3:])]
        off = [np.linalg.norm(part, axis=1).max() for part in np.hsplit(here - there, 2)]
        error = max(off[0] / scale[0], off[1] / scale[1])
        if error <= tolerance:
            return FiniteMagnet(magnet.points, magnet.moments, float(error))
        magnet, here = finer, there
    received = f"{error:.1e} with {len(magnet.points)} points"
    remedy = "ask for less, or use a finer map: the field changes too much over the magnet"
    raise NotConverged.of("finite_magnet", f"two rules must agree to {tolerance:g}", received, remedy)


def volume_rule(shape: Magnet, level: int) -> FiniteMagnet:
    """The rule that is exact where B is a polynomial of degree 2 level - 1; a sphere's is exact always.

    Parameters
    ----------
    shape
        The magnet.
    level
        Order of the rule, 1 or more.

    Returns
    -------
    FiniteMagnet
        The rule.

    Examples
    --------
    >>> from fieldmap.device.payload import MagnetCylinder
    >>> volume_rule(MagnetCylinder(diameter=0.01, height=0.01, remanence=1.3), 3).points.shape
    (36, 3)
    """
    from fieldmap.device.payload import MagnetCylinder, MagnetSphere

    if isinstance(shape, MagnetSphere) or level == 1:
        points, shares = np.zeros((1, 3)), np.ones(1)
    elif isinstance(shape, MagnetCylinder):
        points, shares = _cylinder(shape, level)
    else:
        points, shares = _block(shape, level)
    moment = shape.remanence / MU0 * shape.volume
    return FiniteMagnet(points, np.outer(shares, [0.0, 0.0, moment]))


def _trial(shape: Magnet, field: AnyField) -> Callable[[FiniteMagnet], Array]:
    """What a rule gives at the same random places, orientations and coils as every other."""
    source, radius = as_field(field), shape.bounding_radius
    lower, upper = require_bounds(source)
    low, high = lower + radius, upper - radius
    if np.any(low > high):
        size = ", ".join(f"{1e3 * x:g}" for x in upper - lower)
        must_hold = f"a magnet that fits into the map's box, {size} mm, however it is turned"
        received = f"one that extends {1e3 * radius:g} mm from its centre"
        raise InputError.of("finite_magnet, shape", must_hold, received, "make a larger map")
    rng = np.random.default_rng(20250101)
    places = low + rng.random((_PLACES, 3)) * (high - low)
    turns = np.linalg.qr(rng.normal(size=(_PLACES, 3, 3)))[0]
    if isinstance(source, StateField):
        return lambda magnet: magnet.wrench(source, places, source.currents, turns)
    count = len(source.coil_names)
    currents = np.eye(count)[np.arange(_PLACES * count) % count]
    where, turned = np.repeat(places, count, axis=0), np.repeat(turns, count, axis=0)
    return lambda magnet: magnet.wrench(source, where, currents, turned)


def _gauss(level: int, length: float) -> tuple[Array, Array]:
    nodes, weights = np.polynomial.legendre.leggauss(level)
    return length / 2 * nodes, weights / 2


def _cylinder(shape: MagnetCylinder, level: int) -> tuple[Array, Array]:
    """Gauss along the axis, Gauss in the square of the radius, evenly spaced angles."""
    z, of_z = _gauss(level, shape.height)
    square, of_r = _gauss((level + 1) // 2, 1.0)
    r = shape.diameter / 2 * np.sqrt(square + 0.5)
    angle = 2 * np.pi * np.arange(2 * level) / (2 * level)
    z, r, angle = (part.ravel() for part in np.meshgrid(z, r, angle, indexing="ij"))
    shares = np.einsum("i,j,k->ijk", of_z, of_r, np.full(2 * level, 0.5 / level)).ravel()
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1), shares


def _block(shape: MagnetBlock, level: int) -> tuple[Array, Array]:
    axes = [_gauss(level, side) for side in shape.size]
    points = np.stack(np.meshgrid(*[axis[0] for axis in axes], indexing="ij"), axis=-1).reshape(-1, 3)
    return points, np.einsum("i,j,k->ijk", *[axis[1] for axis in axes]).ravel()
