"""Soft iron in a field: ellipsoids that respond to the field at their centre, or also to its gradient,
docs/theory/wrench.md (5)..(9) and (12); and a sphere of constant permeability in closed form, (4)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.constants import MU0
from fieldmap.core.body import Soft
from fieldmap.errors import InputError
from fieldmap.extras import require
from fieldmap.field import AnyField, as_field
from fieldmap.records import Record
from fieldmap.typing import Array

if TYPE_CHECKING:
    from fieldmap.device.materials import SaturatingMaterial
    from fieldmap.device.payload import SoftBody
    from fieldmap.device.placement import Placement

_NO_LAW = (np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0))
ASSUMPTION = "soft iron of the payload: its pieces do not magnetise each other"


@dataclass(frozen=True, eq=False, repr=False)
class SoftPiece(Record):
    """An ellipsoid of soft iron in a body: centre (3,), m; axes (3, 3), columns its own axes in the body; demagnetising
    factors (3,); volume, m^3; law: h, J, dJ/dh, T, and the integral of J dh, T^2, at knots, or empty arrays for a
    constant permeability mu_r."""

    centre: Array
    axes: Array
    factors: Array
    volume: float
    mu_r: float
    law: tuple[Array, Array, Array, Array] = _NO_LAW


def demagnetising_factors(axes: ArrayLike) -> Array:
    """Demagnetising factors of an ellipsoid.

    N_i = a_1 a_2 a_3 / 3 R_D(a_j^2, a_k^2, a_i^2) with Carlson's integral, DLMF 19.16.5: J. A. Osborn, Phys.
    Rev. 67 (1945) 351.

    Parameters
    ----------
    axes
        Axes (3,), of any unit.

    Returns
    -------
    Array
        Factors (3,), whose sum is 1.

    Raises
    ------
    InputError
        Unless the axes are positive.

    Examples
    --------
    >>> demagnetising_factors([1.0, 1.0, 4.0]).round(4).tolist()
    [0.4623, 0.4623, 0.0754]
    """
    size = np.asarray(axes, dtype=np.float64)
    if size.shape != (3,) or not np.isfinite(size).all() or (size <= 0).any():
        must_hold = "must be three positive lengths"
        raise InputError.of("demagnetising_factors(axes)", must_hold, f"{size.tolist()}", "give the axes")
    if (size == size[0]).all():
        return np.full(3, 1.0 / 3.0)
    rd = require("scipy.special", "levitation", "soft ellipsoids").elliprd
    a = size / np.cbrt(size.prod())  # their product is 1
    x, y, z = a * a
    return np.array([rd(y, z, x), rd(x, z, y), rd(x, y, z)]) / 3.0


def soft_rule(shape: SoftBody, level: int = 1, placement: Placement | None = None) -> tuple[SoftPiece, ...]:
    """The pieces of a soft sphere or ellipsoid: one at its centre, or six that also respond to the gradient.

    Each of the six has a sixth of the volume, and lies on an axis, docs/theory/wrench.md (12). For a sphere of constant
    permeability they have the moment and the quadrupole of the closed form. The response to the second gradient,
    (size / distance of the nearest source)^4 of the force, is left out. For ellipsoids, and for iron that saturates in
    the gradient, the quadrupole is an approximation.

    Parameters
    ----------
    shape
        The sphere or ellipsoid.
    level
        1 for one piece, more for six.
    placement
        Its position and rotation in the body; the body's centre unless given.

    Returns
    -------
    tuple[SoftPiece, ...]
        The pieces.

    Raises
    ------
    InputError
        For a material that is no soft iron, or only the name of one.

    Examples
    --------
    >>> from fieldmap.device.payload import SoftSphere
    >>> [len(soft_rule(SoftSphere(4e-3, mu_r=1e3), level)) for level in (1, 2)]
    [1, 6]
    """
    # Imported here, as in _law_of: maps are opened faster without the package of devices.
    from fieldmap.device.placement import Placement

    place = Placement() if placement is None else placement
    centre, axes = (np.array(part, dtype=np.float64) for part in (place.position, place.rotation))
    mu_r, law = _law_of(shape)
    middle = SoftPiece(centre, axes, demagnetising_factors(shape.axes), shape.volume, mu_r, law)
    if level == 1:
        return (middle,)
    share = 1.0 / mu_r
    arms = np.sqrt((1.0 + 2.0 * share) / (2.0 + 3.0 * share)) * axes * np.divide(shape.axes, 2.0)
    places = centre + np.concatenate([arms.T, -arms.T])
    return tuple(replace(middle, centre=place, volume=middle.volume / 6.0) for place in places)


def _law_of(shape: SoftBody) -> tuple[float, tuple[Array, Array, Array, Array]]:
    """Permeability without a law; or infinity and the knots of the law."""
    from fieldmap.device.materials import Material, SaturatingMaterial
    from fieldmap.device.payload import shape_text

    where, material, mu_r = f"payload, {shape_text(shape)}", shape.material, shape.mu_r
    if (material is None) == (mu_r is None):
        received = "neither" if mu_r is None else "both"
        raise InputError.of(where, "must have a material or a mu_r", received, "give one of them")
    if isinstance(material, SaturatingMaterial):
        material.require_physical()
        return np.inf, knots_of(material)
    if isinstance(material, Material):
        if material.role != "iron":
            raise InputError.of(where, "must be of soft iron", f"a {material.role}", "name another material")
        mu_r = material.initial_mu_r
    elif mu_r is None:
        must_hold = "must have its material at hand"
        remedy = "take the payload of the device file, or give fieldmap.material(...) or mu_r"
        raise InputError.of(where, must_hold, f"the name {material!r}", remedy)
    if not mu_r > 1.0:
        raise InputError.of(where, "must have a mu_r above 1", f"{mu_r}", "correct it")
    return float(mu_r), _NO_LAW


def knots_of(material: SaturatingMaterial) -> tuple[Array, Array, Array, Array]:
    """h, J, dJ/dh, T, and the integral of J dh, T^2, at the knots of a law, exact for the cubics between them."""
    points = material.points()
    h, j, slope = (
        np.array(part, dtype=np.float64) for part in (points.field, points.polarisation, points.slope)
    )
    width = np.diff(h)
    pieces = width * (j[1:] + j[:-1]) / 2.0 + width**2 * (slope[:-1] - slope[1:]) / 12.0
    return h, j, slope, np.concatenate([[0.0], np.cumsum(pieces)])


def core_piece(piece: SoftPiece) -> Soft:
    """The piece for the C core."""
    centre, axes, factors, law = (
        np.array(part, dtype=np.float64, order="C")
        for part in (piece.centre, piece.axes, piece.factors, piece.law)
    )
    # The core ignores the permeability of a piece with a law.
    reluctance = 0.0 if law.size else 1.0 / (piece.mu_r - 1.0)
    return Soft(centre, axes, factors, float(piece.volume / MU0), reluctance, law)


def soft_sphere_force(
    field: AnyField, positions: ArrayLike, currents: Any, diameter: float, mu_r: float = np.inf
) -> Array:
    """Force on a sphere of constant permeability; there is no torque.

    docs/theory/wrench.md (4): the response to the field and its gradient is exact. The response to the second gradient
    is left out; it is of the order (radius / R)^4 of the force with R the distance of the nearest source. `field` is
    the field without the sphere, so the sphere's influence on the coils' iron is left out too.

    Parameters
    ----------
    field
        Any field: see `fieldmap.field.as_field`.
    positions
        Centres (n, 3) in the frame of the field, m.
    currents
        Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by name.
    diameter
        Diameter of the sphere, m.
    mu_r
        Its relative permeability.

    Returns
    -------
    Array
        Force (n, 3), N.

    Raises
    ------
    InputError
        Unless the diameter is positive and finite, and mu_r at least 1.
    """
    if not (diameter > 0 and np.isfinite(diameter) and mu_r >= 1):
        received = f"diameter {diameter!r}, mu_r {mu_r!r}"
        raise InputError.of("soft_sphere_force", "diameter > 0 in m, mu_r >= 1", received, "correct it")
    a, share = diameter / 2, 1 / mu_r
    answer = [l * (1 - share) / (l + (l + 1) * share) for l in (1, 2)]
    source = as_field(field)
    flux, slope = source.field_and_gradient(positions, currents)
    bend = source.second_gradient(positions, currents)
    dipole = 4 * np.pi * a**3 * answer[0] / MU0 * np.einsum("...i,...ij->...j", flux, slope)
    quadrupole = 2 * np.pi * a**5 * answer[1] / (3 * MU0) * np.einsum("...ij,...ijk->...k", slope, bend)
    return np.asarray(dipole + quadrupole)
