"""Flux density and gradient of a device's coils, per ampere: checked input, placement, turns, polarity."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check
from fieldmap.device.coils import Coil
from fieldmap.errors import InputError
from fieldmap.typing import Array

FEWEST_DIGITS, MOST_DIGITS = 4, 14


def unit_flux_density(coil: Coil, points: ArrayLike, digits: float = 10.0) -> Array:
    """Flux density of a coil that carries 1 A, turns and polarity included.

    The current density is uniform over the winding section: docs/theory/coils.md, eqs. (15)-(26). Finite and
    continuous everywhere, inside the winding too.

    Parameters
    ----------
    coil
        The coil.
    points
        Positions (n, 3) or (3,) in the frame of the device, m.
    digits
        Decimal digits wanted, 4 to 14, at any distance of a micrometre or more from the winding's surface;
        nine are reached on the surface.

    Returns
    -------
    Array
        B (n, 3) or (3,), T/A.

    Raises
    ------
    InputError
        For points of another shape or not finite, and for a path whose roundings do not fit.

    Examples
    --------
    >>> from fieldmap.device.model import CircularCoil
    >>> coil = CircularCoil("one", inner_radius=0.011, outer_radius=0.021, height=0.039, turns=840)
    >>> print(unit_flux_density(coil, [0.0, 0.0, 0.0]).round(6))
    [[0.      0.      0.02095]]
    """
    local = _local_points(coil, points)
    field = coil.unit_flux_density(local, _checked_digits(digits))
    field *= coil.turns * coil.polarity
    return field if _is_upright(coil) else field @ coil.placement.rotation.T


def unit_flux_densities(coils: Sequence[Coil], points: Array) -> Array:
    """Flux density of every coil that carries 1 A: see `unit_flux_density`.

    Parameters
    ----------
    coils
        The coils.
    points
        Positions (n, 3) in the frame of the device, m.

    Returns
    -------
    Array
        B (c, n, 3), T/A; (0, n, 3) without coils.

    Raises
    ------
    InputError
        As for `unit_flux_density`.

    Examples
    --------
    >>> unit_flux_densities((), np.zeros((5, 3))).shape
    (0, 5, 3)
    """
    field = np.zeros((len(coils), len(points), 3))
    for k, coil in enumerate(coils):
        field[k] = unit_flux_density(coil, points)
    return field


def unit_flux_density_and_gradient(
    coil: Coil, points: ArrayLike, digits: float = 10.0
) -> tuple[Array, Array]:
    """Flux density and gradient of a coil that carries 1 A: see `unit_flux_density`.

    The gradient is analytic, docs/theory/coils.md eq. (19): symmetric and trace-free outside the winding,
    with curl B = mu0 J inside. It jumps at the winding's surface and is logarithmically infinite on the edges
    of its section, where a large finite number is returned.

    Parameters
    ----------
    coil
        The coil.
    points
        Positions (n, 3) or (3,) in the frame of the device, m.
    digits
        Decimal digits wanted, 4 to 14.

    Returns
    -------
    tuple[Array, Array]
        B (n, 3), T/A, and G (n, 3, 3), G[:, i, j] = dB_i/dx_j, T/(m A).

    Raises
    ------
    InputError
        As for `unit_flux_density`.
    """
    local = _local_points(coil, points)
    field, gradient = coil.unit_flux_density_and_gradient(local, _checked_digits(digits))
    field *= coil.turns * coil.polarity
    gradient *= coil.turns * coil.polarity
    if _is_upright(coil):
        return field, gradient
    rotation = coil.placement.rotation
    return field @ rotation.T, rotation @ gradient @ rotation.T


def _is_upright(coil: Coil) -> bool:
    """Whether the coil is not rotated: the usual case, in which a rotation would cost as much as the field."""
    return bool(np.array_equal(coil.placement.rotation, np.eye(3)))


def _checked_digits(digits: float) -> float:
    must_hold = f"must lie between {FEWEST_DIGITS} and {MOST_DIGITS}"
    check(FEWEST_DIGITS <= digits <= MOST_DIGITS, "digits", must_hold, digits, "leave it at 10")
    return float(digits)


def checked_points(points: ArrayLike, where: str) -> Array:
    """Points as an array (n, 3) of finite float64, C order. Raises InputError otherwise."""
    array = np.asarray(points, dtype=np.float64)
    fits = array.ndim in (1, 2) and array.shape[-1] == 3
    must_hold, remedy = "must have the shape (n, 3) or (3,)", "give x, y, z in metres"
    check(fits, where, must_hold, f"shape {array.shape}", remedy)
    rows = np.ascontiguousarray(array.reshape(-1, 3))
    bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
    if len(bad):
        received = f"{rows[bad[0]]} at index {bad[0]} ({len(bad)} in all)"
        raise InputError.of(where, "must be finite", received, "remove or correct these points")
    return rows


def _local_points(coil: Coil, points: ArrayLike) -> Array:
    checked = checked_points(points, "points")
    local = checked - coil.placement.position
    return local if _is_upright(coil) else np.ascontiguousarray(local @ coil.placement.rotation)
