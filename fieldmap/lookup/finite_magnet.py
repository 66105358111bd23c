"""Force and torque on magnets that are too large to be a point: a volume rule over the magnet.

    F = integral (grad B)^T M dV      T = integral M x B + r x (grad B)^T M dV          docs/theory/wrench.md (1), (2)

about the magnet's centre. A uniformly magnetised sphere is exactly a point dipole, because the mean of a harmonic
function over a ball is its value at the centre. Cylinders and blocks take products of Gauss rules.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import checked_vectors
from fieldmap.constants import MU0
from fieldmap.errors import InputError, NotConverged
from fieldmap.field import AnyField, Field, StateField, as_field
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


def finite_magnet(
    shape: Magnet,
    field: AnyField,
    tolerance: float = 1e-6,
    places: ArrayLike | None = None,
    arm: ArrayLike = (0.0, 0.0, 0.0),
) -> FiniteMagnet:
    """The coarsest volume rule for a magnet that is accurate to a tolerance in a field.

    Each rule, exact for fields of degree 1, 3, 5, ..., is compared with a finer one at many places and random
    orientations, one coil at a time (or a state at its currents), until they agree. The result states the difference.

    Parameters
    ----------
    shape
        The magnet.
    field
        Any field: see `fieldmap.field.as_field`.
    tolerance
        Largest difference of two rules, as a share of the largest force and torque found.
    places
        Where rules are compared: centres (n, 3) of the body that holds the magnet, m. Unless given, random places
        all over the part of the field's box where the magnet fits; a field without a box needs them.
    arm
        Vector (3,) from the centre of the body to the centre of the magnet, m; it turns with the body.

    Returns
    -------
    FiniteMagnet
        The rule, with its error.

    Raises
    ------
    InputError
        If the magnet does not fit into the box, or there is neither a box nor a place.
    OutsideMapError
        For places at which a part of the magnet is outside the field.
    NotConverged
        If the finest rules (7 and 8) do not agree.
    """
    # Imported here, as in `volume_rule`: maps are opened faster without the package of devices.
    from fieldmap.device.payload import MagnetCylinder, MagnetSphere

    if isinstance(shape, MagnetSphere):
        magnet = volume_rule(shape, 1)
        return FiniteMagnet(magnet.points, magnet.moments, 0.0)
    # The rules of successive levels may have the same radii for a cylinder, so every second level is compared.
    step = 2 if isinstance(shape, MagnetCylinder) else 1
    rules = [volume_rule(shape, level) for level in range(1, FINEST + step)]
    ask = cache(_trial(shape, field, places, np.asarray(arm, dtype=float)))
    for magnet, finer in zip(rules, rules[step:], strict=False):
        here, there = ask(magnet), ask(finer)
        scale = [np.linalg.norm(part, axis=1).max() or 1.0 for part in (there[:, :3], there[:, 3:])]
        off = [np.linalg.norm(part, axis=1).max() for part in np.hsplit(here - there, 2)]
        error = max(off[0] / scale[0], off[1] / scale[1])
        if error <= tolerance:
            return FiniteMagnet(magnet.points, magnet.moments, float(error))
    received = f"{error:.1e} with {len(magnet.points)} points"
    remedy = "ask for less, or use a finer map: the field changes too much over the magnet"
    raise NotConverged.of("finite_magnet", f"two rules must agree to {tolerance:g}", received, remedy)


def volume_rule(shape: Magnet, level: int) -> FiniteMagnet:
    """The rule that is exact for polynomials B of degree 2 level - 1; the rule of a sphere is always exact.

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


def _trial(
    shape: Magnet, field: AnyField, places: ArrayLike | None, arm: Array
) -> Callable[[FiniteMagnet], Array]:
    """Function that gives force and torque by a rule, at the same places, random orientations and coils for all."""
    source, rng = as_field(field), np.random.default_rng(20250101)
    if places is None:
        centres = _places_in_box(source, shape.bounding_radius, rng)
        turns = _turns(rng, len(centres))
    else:
        bodies, _ = checked_vectors("finite_magnet, places", places)
        bodies = np.repeat(bodies, -(-_PLACES // len(bodies)), axis=0)
        turns = _turns(rng, len(bodies))
        centres = bodies + turns @ arm
    if isinstance(source, StateField):
        return lambda magnet: magnet.wrench(source, centres, source.currents, turns)
    count = len(source.coil_names)
    # A field of magnets alone has no coil.
    each = max(count, 1)
    currents = np.tile(np.eye(count) if count else np.zeros((1, 0)), (len(centres), 1))
    where, turned = np.repeat(centres, each, axis=0), np.repeat(turns, each, axis=0)
    return lambda magnet: magnet.wrench(source, where, currents, turned)


def _places_in_box(source: Field, radius: float, rng: np.random.Generator) -> Array:
    """Random centres (n, 3) of a magnet that lies in the box however it is turned. Raises InputError."""
    if source.bounds is None:
        must_hold, remedy = "must be given for a field without a box", "give centres of the magnet (n, 3), m"
        raise InputError.of("finite_magnet, places", must_hold, "None", remedy)
    lower, upper = source.bounds
    low, high = lower + radius, upper - radius
    if np.any(low > high):
        size = ", ".join(f"{1e3 * x:g}" for x in upper - lower)
        must_hold = f"a magnet that fits into the map's box, {size} mm, however it is turned"
        received = f"one that extends {1e3 * radius:g} mm from its centre"
        raise InputError.of("finite_magnet, shape", must_hold, received, "make a larger map")
    return low + rng.random((_PLACES, 3)) * (high - low)


def _turns(rng: np.random.Generator, count: int) -> Array:
    return np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]


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
